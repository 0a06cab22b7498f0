# SPDX-License-Identifier: Apache-2.0
"""The covariance of a calibration in its file: written, read, and brought into the image's pixels."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from imgu_ros.bags.messages import make_message
from imgu_ros.config.components import ReadingParameters
from imgu_ros.config.files import read_parameter_file
from imgu_ros.config.parameters import CameraParameters, Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import FileError, ParameterError
from imgu_ros.files.camera_info_file import camera_info_text, read_camera_info, read_description, write_camera_info
from imgu_ros.files.frame_reading import frame_reading
from imgu_ros.messages.camera_info import camera_info_message
from imgu_ros.messages.camera_reading import read_camera
from imgu_ros.messages.header import Header
from imgu_ros.reference.templates import TargetImage
from imgu_ros.replay.recording import record_simulation
from imgu_ros.replay.replay import replay
from imgu_ros.simulate.sequence import Simulation
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.vision.camera.camera_covariance import with_covariance
from imgu_ros.vision.camera.intrinsics import Camera, make_camera

SIGMAS = np.array([2.0, 2.1, 0.7, 0.9, 0.01, 0.05, 3e-4, 2e-4, 0.06])


def camera() -> Camera:
    lens = make_camera(
        [[500, 0, 320.5], [0, 501, 240], [0, 0, 1]], (-0.2, 0.1, 1e-3, 2e-3, 0.01), "plumb_bob", 640, 480
    )
    correlation = np.eye(9)
    correlation[0, 1] = correlation[1, 0] = 0.97
    correlation[4, 5] = correlation[5, 4] = -0.9
    return with_covariance(lens, correlation * np.outer(SIGMAS, SIGMAS))


def test_it_round_trips(tmp_path: Path) -> None:
    write_camera_info(tmp_path / "a.yaml", camera())
    again = read_camera_info(tmp_path / "a.yaml")
    assert again.covariance is not None and camera().covariance is not None
    assert np.array_equal(again.covariance, camera().covariance)
    write_camera_info(tmp_path / "b.yaml", replace(camera(), covariance=None))
    assert read_camera_info(tmp_path / "b.yaml").covariance is None


def test_the_other_keys_are_as_ros_reads_them() -> None:
    """camera_calibration_parsers looks up the names that it knows (parse_yml.cpp) and passes over others."""
    with_it, without = (yaml.safe_load(camera_info_text(one)) for one in (camera(), replace(camera(), covariance=None)))
    assert {key: value for key, value in with_it.items() if key != "calibration_covariance"} == without
    added = with_it["calibration_covariance"]
    assert (added["rows"], added["cols"], len(added["data"])) == (9, 9, 81)
    assert list(with_it)[-1] == "calibration_covariance"


def test_binning_and_window_go_into_it(tmp_path: Path) -> None:
    write_camera_info(tmp_path / "a.yaml", camera())
    described = replace(read_description(tmp_path / "a.yaml"), binning=(2, 4), roi=(64, 40, 320, 240))
    read = read_camera(described, rectified=False, image_size=(160, 60)).camera
    assert read is not None and read.covariance is not None
    scale = np.array([0.5, 0.25, 0.5, 0.25, 1, 1, 1, 1, 1])
    assert np.sqrt(np.diag(read.covariance)) == pytest.approx(SIGMAS * scale)
    # As the K of draws from it: K_image = diag(1/2, 1/4) K + what does not depend on K.
    assert read.covariance[0, 1] == pytest.approx(0.97 * 2.0 * 2.1 / 8)


def test_of_rectified_images_it_is_that_of_p(tmp_path: Path) -> None:
    text = camera_info_text(camera()).replace(
        "data: [500.0, 0.0, 320.5, 0.0, 0.0,", "data: [400.0, 0.0, 310.5, 0.0, 0.0,"
    )
    (tmp_path / "a.yaml").write_text(text)
    read = read_camera_info(tmp_path / "a.yaml", rectified=True)
    assert read.K[0, 0] == 400
    assert read.covariance is not None
    assert np.sqrt(np.diag(read.covariance)) == pytest.approx([1.6, 2.1, 0.56, 0.9, 0, 0, 0, 0, 0])


@pytest.mark.parametrize(
    ("covariance", "words"),
    [
        ({"rows": 3, "cols": 3, "data": [1.0] * 9}, "covariance: 9 numbers; need a square"),
        ({"rows": 12, "cols": 12, "data": np.eye(12).ravel().tolist()}, "of 12 numbers; need 9 x 9"),
        ({"rows": 4, "cols": 4, "data": [1.0, 2.0, *[0.0] * 14]}, "not symmetric"),
        ({"rows": 4, "cols": 4, "data": np.diag([1.0, -1, 1, 1]).ravel().tolist()}, "a variance of -1"),
        ({"rows": 4, "cols": 4, "data": ["a"] * 16}, "calibration_covariance: .*; need numbers"),
        ({"rows": 4, "cols": 4}, "calibration_covariance: None; need a list of numbers"),
    ],
)
def test_what_is_none_is_refused_in_one_line(tmp_path: Path, covariance: object, words: str) -> None:
    content = yaml.safe_load(camera_info_text(camera()))
    (tmp_path / "a.yaml").write_text(yaml.safe_dump({**content, "calibration_covariance": covariance}))
    with pytest.raises(FileError, match=words) as error:
        read_camera_info(tmp_path / "a.yaml")
    assert "\n" not in str(error.value)


def test_it_may_be_of_k_alone_or_written_by_hand(tmp_path: Path) -> None:
    content = yaml.safe_load(camera_info_text(replace(camera(), covariance=None)))
    rows = [[4.0, 0, 0, 0], [0, 4.0, 0, 0], [0, 0, 1.0, 0], [0, 0, 0, 1.0]]
    (tmp_path / "a.yaml").write_text(yaml.safe_dump({**content, "calibration_covariance": rows}))
    read = read_camera_info(tmp_path / "a.yaml")
    assert read.covariance is not None
    assert np.diag(read.covariance).tolist() == [4, 4, 1, 1, 0, 0, 0, 0, 0]


def info_message(binning: int = 1) -> Any:
    message = camera_info_message(make_message, Header(1, "camera"), replace(camera(), covariance=None))
    message.binning_x = message.binning_y = binning
    return message


def test_the_parameter_is_of_camera_infos_numbers_and_wins_over_the_file(tmp_path: Path) -> None:
    other = tuple(np.diag([9.0, 16, 1, 4]).ravel().tolist())
    by_parameter = Parameters(camera=CameraParameters(covariance=other))
    read = frame_reading(ReadingParameters.of(by_parameter)).camera(info_message(binning=2), (320, 240)).camera
    assert read is not None and read.covariance is not None
    assert np.sqrt(np.diag(read.covariance)).tolist() == [1.5, 2, 0.5, 1, 0, 0, 0, 0, 0]
    assert (
        frame_reading(ReadingParameters.of(Parameters())).camera(info_message(), (640, 480)).camera.covariance is None
    )  # type: ignore[union-attr]

    write_camera_info(tmp_path / "a.yaml", camera())
    of_file = Parameters(camera=CameraParameters(info_file=str(tmp_path / "a.yaml")))
    reading = frame_reading(ReadingParameters.of(of_file))
    read = reading.camera(info_message(), (640, 480)).camera
    assert read is not None and np.array_equal(read.covariance, camera().covariance)  # type: ignore[arg-type]
    changed = replace(of_file, camera=replace(of_file.camera, covariance=other))
    again = frame_reading(ReadingParameters.of(changed), reading)
    assert again is not reading
    read = again.camera(None, (640, 480)).camera
    assert read is not None and read.covariance is not None
    assert read.covariance[1, 1] == 16


def test_one_that_is_not_the_cameras_costs_the_pose_and_says_why(tmp_path: Path) -> None:
    wrong = Parameters(camera=CameraParameters(covariance=tuple(np.eye(12).ravel().tolist())))
    read = frame_reading(ReadingParameters.of(wrong)).camera(info_message(), (640, 480))
    assert read.camera is None
    assert "covariance: of 12 numbers; need 9 x 9: fx, fy, cx, cy and the 5 coefficients of plumb_bob" in read.reason
    write_camera_info(tmp_path / "a.yaml", camera())
    with pytest.raises(FileError, match="camera.info_file: .* of 12 numbers"):
        frame_reading(
            ReadingParameters.of(replace(wrong, camera=replace(wrong.camera, info_file=str(tmp_path / "a.yaml"))))
        )


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ([1.0] * 9, "9 values; need 16"),
        ([1.0] * 17, "17 values; need 16"),
        (np.diag([1.0, 1, 1, -2]).ravel().tolist(), "a variance of -2"),
        ((np.eye(4) + np.triu(np.full((4, 4), 0.1), 1)).ravel().tolist(), "in row 2, column 1, .* need equal values"),
        ((3 * np.ones((4, 4)) - 2 * np.eye(4)).ravel().tolist(), "at most 1 by the variances"),
    ],
)
def test_parameters_that_are_no_covariance_are_refused(values: list[float], words: str) -> None:
    with pytest.raises(ParameterError, match=f"camera.covariance: .*{words}"):
        parameters_from({"camera.covariance": values})


def test_poses_of_a_replay_have_it(tmp_path: Path) -> None:
    """A bag, its own camera_info, and a covariance: the same poses, and larger covariances."""
    target = TargetImage("poster", procedural_texture(640, 480), 0.5)
    record_simulation(tmp_path / "bag", Simulation(width=480, height=360, frames=3), targets=[target])
    plain = parameters_from(read_parameter_file(tmp_path / "bag" / "params.yaml"))
    known = parameters_from({"camera.covariance": np.diag([16.0, 16, 4, 4]).ravel().tolist()}, plain)
    rows = []
    for name, parameters in (("plain", plain), ("known", known)):
        replay([tmp_path / "bag"], tmp_path / name, parameters)
        with (tmp_path / name / "frames.csv").open(newline="") as file:
            rows.append(list(csv.DictReader(file)))
        summary = json.loads((tmp_path / name / "summary.json").read_text())
        assert summary["calibration"]["warning"] == ""
        assert 0 < summary["calibration"]["views"] <= 3
        assert "fits what is seen" in (tmp_path / name / "report.html").read_text()
    for a, b in zip(*rows, strict=True):
        assert a["tz"] == b["tz"]
        # A focal length that is known to 4 of some 400 px: the distance to about 1 %.
        assert float(b["c33"]) > 100 * float(a["c33"])
        assert float(b["c33"]) ** 0.5 == pytest.approx(0.01 * float(a["tz"]), rel=0.3)
