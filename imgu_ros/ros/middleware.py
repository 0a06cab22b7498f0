# SPDX-License-Identifier: Apache-2.0
"""The DDS profile for large images: which one fits this machine, setting it for this process, and what is said of it.

Fast DDS gives a process that sends 512 KB of shared memory, less than one frame. The profile must be in force in every
process that sends large images; the commands of this package set it for themselves. Fast DDS 2 (ROS 2 Jazzy) reads
`FASTRTPS_DEFAULT_PROFILES_FILE` and `DEFAULT_FASTRTPS_PROFILES.xml` in the working directory, Fast DDS 3 the same with
`FASTDDS`; `FASTDDS_BUILTIN_TRANSPORTS` chooses other transports.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import imgu_ros
from imgu_ros.errors import FileError, ImguError

#: The environment variable with which Fast DDS loads a profile; and what it is called in Fast DDS 3.
PROFILE_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
_VARIABLES = (PROFILE_VARIABLE, "FASTDDS_DEFAULT_PROFILES_FILE")
_FILES = ("DEFAULT_FASTRTPS_PROFILES.xml", "DEFAULT_FASTDDS_PROFILES.xml")
#: rmw_fastrtps takes the memory policy of queues from the profile when this is "1".
_QOS_FROM_PROFILE = "RMW_FASTRTPS_USE_QOS_FROM_XML"
_PUBLICATION_MODE = "RMW_FASTRTPS_PUBLICATION_MODE"
_TRANSPORTS_VARIABLE = "FASTDDS_BUILTIN_TRANSPORTS"
#: Fast DDS does not read the file of the working directory when this is "1".
_SKIP_VARIABLE = "SKIP_DEFAULT_XML_FILE"
#: Messages above this overflow Fast DDS's default segment of 512 KB.
LARGE_BYTES = 500_000

#: Messages that may be under way at once: one that is written, one that is read, and one behind.
_FRAMES_IN_FLIGHT = 3
#: Fast DDS takes the whole segment at once, and some more to manage it.
_OVERHEAD = 1.1
_SHARED_MEMORY = Path("/dev/shm")
_ROOM = "Docker: --shm-size=512m"
#: With less no process gets any shared memory for what it sends.
_FULL_BYTES = 1_000_000
#: The tracing of ROS 2 (LTTng) writes a page when it is loaded, unless another process did; without room for it SIGBUS.
_TRACING, _TRACING_BYTES = "lttng-ust-wait-*", 16_384


@dataclass(frozen=True, slots=True)
class Profile:
    """A file of `config/`, the shared memory that a process takes with it, and how much the machine must have."""

    name: str
    segment_bytes: int
    least_total_bytes: int


#: From large to small. The small one leaves room for four processes in Docker's default of 64 MB.
PROFILES = (
    Profile("fastdds_large_images.xml", 64 * 2**20, 500_000_000),
    Profile("fastdds_large_images_small.xml", 12 * 2**20, 48 * 2**20),
)


@dataclass(frozen=True, slots=True)
class SharedMemory:
    """Size of the machine's shared memory, and what is left of it, in bytes."""

    total: int
    free: int


def set_profile() -> None:
    """Set the profile for large images in this process's environment, unless the user has chosen otherwise.

    To be called before the first node is made. It changes nothing when a profile is set by either variable or lies in
    the working directory, transports are chosen by `FASTDDS_BUILTIN_TRANSPORTS` (`DEFAULT` switches the profile off),
    the middleware is not Fast DDS, or the shared memory is too small.
    """
    profile = None if _choice_of_the_user() else _fitting()
    if profile is not None:
        for name in _VARIABLES:
            os.environ[name] = str(config_file(profile.name))
    # Also where the user has set this package's profile; not where the user chose what it would override.
    if _ours() is not None and not os.environ.get(_PUBLICATION_MODE):
        os.environ.setdefault(_QOS_FROM_PROFILE, "1")


def require_room_to_start() -> None:
    """Refuse to load ROS where that ends with a bus error; to be called before rclpy is imported.

    Raises
    ------
    ImguError
        If the shared memory is full.
    """
    memory = shared_memory()
    if memory is None or memory.free >= _TRACING_BYTES:
        return
    if not any(path.stat().st_blocks for path in _SHARED_MEMORY.glob(_TRACING)):
        raise ImguError(f"{_full(memory)}: ROS would end with a bus error; {_FREE_IT}")


def full_memory() -> str:
    """Return that the shared memory is full, and what to do; empty when it is not, or nothing depends on it."""
    memory = shared_memory() if is_fast_dds() else None
    if memory is None or memory.free >= _FULL_BYTES:
        return ""
    return (
        f"{_full(memory)}: processes that start now end with a bus error, or send large messages without shared memory "
        f"and lose them; {_FREE_IT}"
    )


def lacks_memory() -> bool:
    """Return whether no profile is in force because the shared memory is too small."""
    return _ours() is None and not _choice_of_the_user() and _fitting() is None


def profile_line() -> str:
    """Return which profile is in force in this process, and why, for the log."""
    ours = _ours()
    if ours is not None:
        return (
            f"DDS profile: {ours.name}, {ours.segment_bytes / 1e6:.0f} MB of shared memory for what this process sends"
        )
    reason = _choice_of_the_user() or ("none" if _fitting() else f"none, {_too_little_memory()}")
    return f"DDS profile: {reason}"


def profile_path() -> Path:
    """Return the installed profile that fits this machine's shared memory, the smallest if none does."""
    return config_file((_fitting() or PROFILES[-1]).name)


def config_file(name: str) -> Path:
    """Return a file of `config/`, from `share/imgu_ros/` of the installation or from the source tree.

    Raises
    ------
    FileError
        If the installation lacks it.
    """
    package = Path(imgu_ros.__file__).resolve().parent
    # pip, colcon and Debian differ in how deep the modules lie below the prefix that holds `share`.
    folders = [folder / "share" / "imgu_ros" / "config" for folder in list(package.parents)[:5]]
    for folder in (package.parent / "config", *folders):
        if (folder / name).is_file():
            return folder / name
    raise FileError(f"{name}: not found beside {package}; need a complete installation of imgu_ros")


def large_message_warnings(message_bytes: int) -> list[str]:
    """Return what stands in the way of messages of this size without loss, one line each.

    Parameters
    ----------
    message_bytes : size of one image message
    """
    ours = _ours()
    if message_bytes <= LARGE_BYTES or (ours is None and _choice_of_the_user()):
        return []
    size = f"{message_bytes / 1e6:.1f} MB"
    if ours is None and _fitting() is None:
        return [f"images of {size} and no DDS profile: {_too_little_memory()}"]
    if ours is None:
        return [f"images of {size} and no DDS profile: the default shared memory of 512 KB loses frames; {_turn_on()}"]
    if message_bytes * _FRAMES_IN_FLIGHT > ours.segment_bytes:
        said = f"images of {size} and shared memory of {ours.segment_bytes / 1e6:.0f} MB: frames get lost"
        return [f"{said}; {_more() if ours is not PROFILES[0] else _larger_segment(message_bytes)}"]
    return []


def against_loss() -> str:
    """Return what to do when messages are lost on the way to this process."""
    if not is_fast_dds():
        return "give the middleware larger buffers, or send smaller images"
    if _ours() is None and not _choice_of_the_user():
        if _fitting() is None:
            return _too_little_memory()
        return f"images larger than the shared memory of 512 KB get lost; {_turn_on()}"
    memory = shared_memory()
    room = f"it is for images of at most {PROFILES[0].segment_bytes / _FRAMES_IN_FLIGHT / 1e6:.0f} MB"
    if memory is not None and memory.total < PROFILES[0].least_total_bytes:
        room = _more()
    return f"this process has a DDS profile; {_turn_on()}; {room}"


def shared_memory() -> SharedMemory | None:
    """Return the size of the shared memory; None when the machine has none."""
    try:
        figures = os.statvfs(_SHARED_MEMORY)
    except OSError:
        return None
    return SharedMemory(figures.f_blocks * figures.f_frsize, figures.f_bavail * figures.f_frsize)


def is_fast_dds() -> bool:
    """Return whether the middleware is Fast DDS, ROS 2's default."""
    return (os.environ.get("RMW_IMPLEMENTATION") or "rmw_fastrtps_cpp").startswith("rmw_fastrtps")


def _fitting() -> Profile | None:
    memory = shared_memory()
    if memory is None:
        return None
    for profile in PROFILES:
        if memory.total >= profile.least_total_bytes and memory.free >= profile.segment_bytes * _OVERHEAD:
            return profile
    return None


def _ours() -> Profile | None:
    """Return the profile of this package that is set."""
    files = {os.path.basename(os.environ.get(name, "")) for name in _VARIABLES}
    return next((profile for profile in PROFILES if profile.name in files), None) if is_fast_dds() else None


def _choice_of_the_user() -> str:
    """Return what the user has chosen instead; "" for nothing."""
    if not is_fast_dds():
        return f"none, RMW_IMPLEMENTATION is {os.environ['RMW_IMPLEMENTATION']}"
    for name in _VARIABLES:
        if os.environ.get(name):
            return f"{os.environ[name]}, by {name}"
    if os.environ.get(_TRANSPORTS_VARIABLE):
        return f"none, {_TRANSPORTS_VARIABLE} is {os.environ[_TRANSPORTS_VARIABLE]}"
    if os.environ.get(_SKIP_VARIABLE) != "1":
        for name in _FILES:
            if Path(name).is_file():
                return f"{name} in the working directory"
    return ""


def _turn_on() -> str:
    return f"in every process, the camera's too, set {PROFILE_VARIABLE}={profile_path()}"


def _more() -> str:
    memory = shared_memory()
    return f"{_SHARED_MEMORY} has {memory.total / 1e6 if memory else 0:.0f} MB; give it more ({_ROOM})"


def _larger_segment(message_bytes: int) -> str:
    need = f"segment_size of {message_bytes * _FRAMES_IN_FLIGHT} in a copy of {profile_path()}"
    return f"need a {need}, and {PROFILE_VARIABLE} set to it in every process, the camera's too"


def _full(memory: SharedMemory) -> str:
    return f"{_SHARED_MEMORY} is full: {memory.total / 1e6:.0f} MB, {memory.free / 1e6:.1f} MB free"


_FREE_IT = f"remove what fills it (ls -lS {_SHARED_MEMORY}; fastdds shm clean), or give it more ({_ROOM})"


def _too_little_memory() -> str:
    memory = shared_memory()
    if memory is None:
        return f"{_SHARED_MEMORY} does not exist; need shared memory for large images ({_ROOM})"
    least = PROFILES[-1]
    need = f"need {least.least_total_bytes / 1e6:.0f} MB, {least.segment_bytes * _OVERHEAD / 1e6:.0f} MB free ({_ROOM})"
    return f"{_SHARED_MEMORY} has {memory.total / 1e6:.0f} MB, {memory.free / 1e6:.0f} MB free; {need}"
