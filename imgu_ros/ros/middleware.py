"""The DDS profile for large images: where it is, whether it is on, and whether the machine has room for it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import imgu_ros
from imgu_ros.errors import FileError

#: The environment variable with which Fast DDS loads a profile.
PROFILE_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
_VARIABLES = (PROFILE_VARIABLE, "FASTDDS_DEFAULT_PROFILES_FILE")
#: Shared memory that each process takes with the profile.
SEGMENT_BYTES = 64 * 1024 * 1024
#: Messages above this overflow Fast DDS's default segment of 512 KB.
LARGE_BYTES = 500_000

_SHARED_MEMORY = Path("/dev/shm")


@dataclass(frozen=True, slots=True)
class SharedMemory:
    """Size of the machine's shared memory, and what is left of it, in bytes."""

    total: int
    free: int


def profile_path() -> Path:
    """Return the installed profile for large images."""
    return config_file("fastdds_large_images.xml")


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
    if message_bytes <= LARGE_BYTES or not _is_fast_dds():
        return []
    size = f"{message_bytes / 1e6:.1f} MB"
    if not _has_profile():
        return [f"images of {size} and no DDS profile: the default shared memory of 512 KB loses frames; {_turn_on()}"]
    small = _too_little_memory()
    return [small] if small else []


def against_loss() -> str:
    """Return what to do when messages are lost on the way to this process."""
    if not _is_fast_dds():
        return "give the middleware larger buffers, or send smaller images"
    if not _has_profile():
        return f"images larger than the shared memory of 512 KB get lost; {_turn_on()}"
    return _too_little_memory() or "this process has a DDS profile; set the same one in the camera's process too"


def shared_memory() -> SharedMemory | None:
    """Return the size of the shared memory; None when the machine has none."""
    try:
        figures = os.statvfs(_SHARED_MEMORY)
    except OSError:
        return None
    return SharedMemory(figures.f_blocks * figures.f_frsize, figures.f_bavail * figures.f_frsize)


def _has_profile() -> bool:
    return any(os.environ.get(name) for name in _VARIABLES)


def _turn_on() -> str:
    return f"in every process, the camera's too, set {PROFILE_VARIABLE}={profile_path()}"


def _too_little_memory() -> str:
    memory = shared_memory()
    if memory is None or memory.total >= 2 * SEGMENT_BYTES:
        return ""
    need = f"the DDS profile takes {SEGMENT_BYTES / 1e6:.0f} MB for each process (Docker: --shm-size=512m)"
    return f"{_SHARED_MEMORY} has {memory.total / 1e6:.0f} MB; {need}"


def _is_fast_dds() -> bool:
    return os.environ.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp").startswith("rmw_fastrtps")
