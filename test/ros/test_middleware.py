# SPDX-License-Identifier: Apache-2.0
"""The DDS profile for large images: which one, when it is set, and what is said where it cannot be."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import pytest

from imgu_ros.errors import FileError, ImguError
from imgu_ros.ros import middleware

_TAG = "{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}"
MB = 1_000_000
VARIABLE, VARIABLE_3 = "FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"
LARGE, SMALL = "fastdds_large_images.xml", "fastdds_large_images_small.xml"


class Machine:
    """The environment, the working directory and the shared memory of the process."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
        self._patch = monkeypatch
        monkeypatch.chdir(folder)
        for name in (VARIABLE, VARIABLE_3, "RMW_IMPLEMENTATION", "FASTDDS_BUILTIN_TRANSPORTS", "SKIP_DEFAULT_XML_FILE"):
            # Set and deleted, so that what the code sets is taken back at the end.
            monkeypatch.setenv(name, "x")
            monkeypatch.delenv(name)
        self.has(1000, 1000)

    def has(self, total_mib: float, free_mib: float) -> None:
        figures = SimpleNamespace(f_blocks=int(total_mib * 16), f_bavail=int(free_mib * 16), f_frsize=2**16)
        self._patch.setattr(os, "statvfs", lambda path: figures)

    def is_told(self, name: str, value: str) -> None:
        self._patch.setenv(name, value)

    def lacks_shared_memory(self) -> None:
        def missing(path: Path) -> None:
            raise FileNotFoundError(path)

        self._patch.setattr(os, "statvfs", missing)


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Machine:
    return Machine(monkeypatch, tmp_path)


@pytest.mark.parametrize("profile", middleware.PROFILES, ids=lambda profile: profile.name)
def test_the_files_have_the_segment_that_we_speak_of(profile):
    tree = ElementTree.parse(middleware.config_file(profile.name))
    assert [int(e.text or 0) for e in tree.iter(f"{_TAG}segment_size")] == [profile.segment_bytes]
    assert [e.text for e in tree.iter(f"{_TAG}useBuiltinTransports")] == ["false"]
    assert {e.text for e in tree.iter(f"{_TAG}type")} == {"SHM", "UDPv4"}
    assert [e.get("is_default_profile") for e in tree.iter(f"{_TAG}participant")] == ["true"]
    with pytest.raises(FileError, match=r"nothing\.xml"):
        middleware.config_file("nothing.xml")


@pytest.mark.parametrize(
    ("total_mib", "free_mib", "name"),
    [
        (16_000, 15_000, LARGE), (512, 500, LARGE), (512, 71, LARGE), (512, 60, SMALL), (64, 64, SMALL),
        (64, 14, SMALL), (64, 13, None), (16, 16, None), (512, 1, None),
    ],
)  # fmt: skip
def test_it_fits_the_shared_memory(machine, total_mib, free_mib, name):
    """Fast DDS takes the whole segment when a process starts; where it cannot, it does without shared memory."""
    machine.has(total_mib, free_mib)
    middleware.set_profile()
    if name is None:
        assert VARIABLE not in os.environ and VARIABLE_3 not in os.environ
        assert "--shm-size" in middleware.profile_line()
        assert f"/dev/shm has {total_mib * 1.048576:.0f} MB" in middleware.profile_line()
        assert middleware.profile_path().name == SMALL
    else:
        assert os.environ[VARIABLE] == os.environ[VARIABLE_3] == str(middleware.config_file(name))
        assert middleware.profile_line().startswith(f"DDS profile: {name}, ")
        assert middleware.profile_path().name == name


def test_without_shared_memory_there_is_none(machine):
    machine.lacks_shared_memory()
    middleware.set_profile()
    assert VARIABLE not in os.environ
    assert "/dev/shm does not exist" in middleware.profile_line()


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        (VARIABLE, "my.xml", "my.xml, by FASTRTPS_DEFAULT_PROFILES_FILE"),
        (VARIABLE_3, "my.xml", "my.xml, by FASTDDS_DEFAULT_PROFILES_FILE"),
        ("FASTDDS_BUILTIN_TRANSPORTS", "LARGE_DATA", "none, FASTDDS_BUILTIN_TRANSPORTS is LARGE_DATA"),
        ("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp", "none, RMW_IMPLEMENTATION is rmw_cyclonedds_cpp"),
        ("DEFAULT_FASTRTPS_PROFILES.xml", "", "DEFAULT_FASTRTPS_PROFILES.xml in the working directory"),
        ("DEFAULT_FASTDDS_PROFILES.xml", "", "DEFAULT_FASTDDS_PROFILES.xml in the working directory"),
    ],
)
def test_what_the_user_chooses_stays(machine, name, value, said):
    if name.endswith(".xml"):
        Path(name).touch()
    else:
        machine.is_told(name, value)
    before = dict(os.environ)
    middleware.set_profile()
    assert dict(os.environ) == before
    assert middleware.profile_line() == f"DDS profile: {said}"
    assert middleware.large_message_warnings(2 * MB) == []


@pytest.mark.parametrize(
    ("name", "value"),
    [
        (VARIABLE, ""), ("RMW_IMPLEMENTATION", ""), ("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp"),
        ("RMW_IMPLEMENTATION", "rmw_fastrtps_dynamic_cpp"), ("FASTDDS_BUILTIN_TRANSPORTS", ""),
    ],
)  # fmt: skip
def test_what_chooses_nothing_changes_nothing(machine, name, value):
    machine.is_told(name, value)
    middleware.set_profile()
    assert Path(os.environ[VARIABLE]).name == LARGE


def test_a_file_that_fast_dds_is_told_to_skip_is_none(machine):
    Path("DEFAULT_FASTRTPS_PROFILES.xml").touch()
    machine.is_told("SKIP_DEFAULT_XML_FILE", "1")
    middleware.set_profile()
    assert Path(os.environ[VARIABLE]).name == LARGE


@pytest.mark.parametrize(
    ("size", "shm_mib", "is_set", "said"),
    [
        (100_000, 16, True, ""),
        (2 * MB, 1000, True, ""),
        (100 * MB, 1000, True, "images of 100.0 MB and shared memory of 67 MB: frames get lost; need a segment"),
        (2 * MB, 64, True, ""),
        (6 * MB, 64, True, "images of 6.0 MB and shared memory of 13 MB: frames get lost; /dev/shm has 67 MB; "),
        (2 * MB, 16, True, "images of 2.0 MB and no DDS profile: /dev/shm has 17 MB"),
        (2 * MB, 1000, False, "images of 2.0 MB and no DDS profile: the default shared memory of 512 KB "),
    ],
)  # fmt: skip
def test_large_messages(machine, size, shm_mib, is_set, said):
    machine.has(shm_mib, shm_mib)
    if is_set:
        middleware.set_profile()
    lines = middleware.large_message_warnings(size)
    assert len(lines) == bool(said)
    assert all(line.startswith(said) and "\n" not in line for line in lines)


def test_what_helps_against_loss(machine):
    turn_on = f"in every process, the camera's too, set {VARIABLE}={middleware.config_file(LARGE)}"
    assert middleware.against_loss() == f"images larger than the shared memory of 512 KB get lost; {turn_on}"
    middleware.set_profile()
    holds = "it is for images of at most 22 MB"
    assert middleware.against_loss() == f"this process has a DDS profile; {turn_on}; {holds}"
    machine.has(64, 40)
    assert middleware.against_loss().endswith("; /dev/shm has 67 MB; give it more (Docker: --shm-size=512m)")
    machine.is_told("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")
    assert "larger buffers" in middleware.against_loss()


def test_a_full_shared_memory_is_told(machine, monkeypatch, tmp_path):
    monkeypatch.setattr(middleware, "_SHARED_MEMORY", tmp_path)
    machine.has(64, 1)
    middleware.require_room_to_start()
    assert middleware.full_memory() == ""
    machine.has(64, 0.5)
    middleware.require_room_to_start()
    assert middleware.full_memory().startswith(f"{tmp_path} is full: 67 MB, 0.5 MB free: processes that start now")
    machine.has(64, 0)
    (tmp_path / "lttng-ust-wait-6").touch()
    with pytest.raises(ImguError, match=r"is full: 67 MB, 0.0 MB free: ROS would end with a bus error; remove what"):
        middleware.require_room_to_start()
    # Another process has the page already: ROS starts, without shared memory.
    (tmp_path / "lttng-ust-wait-6").write_bytes(bytes(4096))
    middleware.require_room_to_start()
    machine.is_told("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")
    assert middleware.full_memory() == ""
    machine.lacks_shared_memory()
    middleware.require_room_to_start()


def test_queues_allocate_each_message_with_our_profile_unless_the_user_chose(machine, monkeypatch):
    """Also with our profile set by hand; a publication mode of the user's would be overridden."""
    qos = "RMW_FASTRTPS_USE_QOS_FROM_XML"
    machine.has(16_000, 15_000)
    monkeypatch.delenv(qos, raising=False)
    monkeypatch.setenv("RMW_FASTRTPS_PUBLICATION_MODE", "ASYNCHRONOUS")
    middleware.set_profile()
    assert qos not in os.environ
    monkeypatch.delenv("RMW_FASTRTPS_PUBLICATION_MODE")
    middleware.set_profile()
    assert os.environ.pop(qos) == "1"
    monkeypatch.setenv(VARIABLE, str(middleware.config_file(SMALL)))
    middleware.set_profile()
    assert os.environ.pop(qos) == "1"
