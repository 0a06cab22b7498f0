# SPDX-License-Identifier: Apache-2.0
"""`imgu doctor`: what it says of parts that are there, missing and broken."""

from __future__ import annotations

import json
import sys

import pytest

from imgu_ros.cli import doctor
from imgu_ros.cli.main import main


def told(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, dict[str, str]]:
    main(["doctor", "--json", *arguments])
    return {one["part"]: one for one in json.loads(capsys.readouterr().out)}


@pytest.fixture
def no_ros(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.split(".")[0] == "rclpy" or name.startswith("imgu_ros.ros.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "rclpy", None)
    monkeypatch.delenv("ROS_DISTRO", raising=False)


def test_a_machine_without_ros_works_offline(capsys, no_ros):
    assert main(["doctor"]) == 0
    text = capsys.readouterr().out
    assert "ROS 2" in text and "no live nodes" in text and '-> pip install ".[ros]"' in text
    assert main(["doctor", "--ros"]) == 1
    capsys.readouterr()
    found = told(capsys)
    assert [found[part]["health"] for part in ("Python", "libraries")] == ["ok"] * 2


@pytest.mark.parametrize(
    ("module", "health", "code"), [("scipy", "broken", 1), ("rosbags", "missing", 0), ("av", "missing", 0)]
)
def test_a_missing_library_is_named_with_what_installs_it(capsys, monkeypatch, no_ros, module, health, code):
    monkeypatch.setitem(sys.modules, module, None)
    assert main(["doctor"]) == code
    capsys.readouterr()
    libraries = told(capsys)["libraries"]
    assert libraries["health"] == health
    assert module in libraries["text"]
    assert libraries["remedy"] == f"pip install {module}"


def test_an_opencv_without_markers_is_said(capsys, monkeypatch, no_ros):
    import cv2

    monkeypatch.delattr(cv2, "aruco", raising=False)
    found = told(capsys)["OpenCV"]
    assert found["health"] == "missing"
    assert "contrib" in found["remedy"]


def test_an_old_python_is_refused(capsys, monkeypatch, no_ros):
    monkeypatch.setattr(doctor, "_OLDEST_PYTHON", (9, 0))
    assert main(["doctor"]) == 1
    assert "broken" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("devices", "usable", "said"),
    [
        ([], False, "none"),
        (["/dev/video0"], False, "usermod -aG video"),
        (["/dev/video0"], True, "/dev/video0 for imgu camera"),
    ],
)
def test_webcams(capsys, monkeypatch, no_ros, devices, usable, said):
    monkeypatch.setattr(doctor.glob, "glob", lambda pattern: list(devices))
    monkeypatch.setattr(doctor.os, "access", lambda path, mode: usable)
    found = told(capsys)["webcams"]
    assert said in found["text"] + found["remedy"]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of what rclpy imports
def test_images_go_from_process_to_process(capsys, ros_domain):
    pytest.importorskip("rclpy", reason="needs the ros extra")
    found = told(capsys)["images by DDS"]
    assert (found["health"], found["remedy"]) == ("ok", "")
    assert "30 of 30 images of 2.8 MB" in found["text"]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_images_that_get_lost_are_said(capsys, monkeypatch, ros_domain):
    pytest.importorskip("rclpy", reason="needs the ros extra")
    from imgu_ros.ros import transport_probe

    monkeypatch.setattr(transport_probe, "probe_transport", lambda: transport_probe.Transport(3, 30, 2.8))
    found = told(capsys)["images by DDS"]
    assert found["health"] == "broken"
    assert found["remedy"]
    assert main(["doctor", "--ros"]) == 1
