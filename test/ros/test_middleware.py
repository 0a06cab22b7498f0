from __future__ import annotations

import os
from types import SimpleNamespace
from xml.etree import ElementTree

import pytest

from imgu_ros.errors import FileError
from imgu_ros.ros import middleware

_TAG = "{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}"
MB = 1_000_000


def test_the_profile_is_found_and_has_the_segment_that_we_speak_of():
    tree = ElementTree.parse(middleware.profile_path())
    sizes = [int(e.text or 0) for e in tree.iter(f"{_TAG}segment_size")]
    assert sizes == [middleware.SEGMENT_BYTES]
    assert [e.text for e in tree.iter(f"{_TAG}useBuiltinTransports")] == ["false"]
    assert {e.text for e in tree.iter(f"{_TAG}type")} == {"SHM", "UDPv4"}
    with pytest.raises(FileError, match=r"nothing\.xml"):
        middleware.config_file("nothing.xml")


@pytest.mark.parametrize(
    ("size", "variable", "shm_mb", "rmw", "said"),
    [
        (100_000, "", 64, "", ""),
        (2 * MB, "", 1000, "", "FASTRTPS_DEFAULT_PROFILES_FILE="),
        (2 * MB, "FASTRTPS_DEFAULT_PROFILES_FILE", 1000, "", ""),
        (2 * MB, "FASTDDS_DEFAULT_PROFILES_FILE", 1000, "", ""),
        (2 * MB, "FASTRTPS_DEFAULT_PROFILES_FILE", 64, "", "--shm-size"),
        (2 * MB, "", 1000, "rmw_cyclonedds_cpp", ""),
    ],
)
def test_warnings(monkeypatch, size, variable, shm_mb, rmw, said):
    for name in ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE", "RMW_IMPLEMENTATION"):
        monkeypatch.delenv(name, raising=False)
    if variable:
        monkeypatch.setenv(variable, "profile.xml")
    if rmw:
        monkeypatch.setenv("RMW_IMPLEMENTATION", rmw)
    figures = SimpleNamespace(f_blocks=shm_mb, f_bavail=shm_mb, f_frsize=2**20)
    monkeypatch.setattr(os, "statvfs", lambda path: figures)
    lines = middleware.large_message_warnings(size)
    assert len(lines) == bool(said)
    assert all(said in line and "\n" not in line for line in lines)
    # Where messages get lost all the same, it says what to do in any case.
    need = said if size > 100_000 and said else "larger buffers" if rmw else "camera's process" if variable else "set "
    assert need in middleware.against_loss()
