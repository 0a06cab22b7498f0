"""The covariance of a calibration in its file: written, read, and brought into the image's pixels."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from imgu_ros.codec.camera_reading import read_camera
from imgu_ros.errors import FileError
from imgu_ros.files.camera_info_file import camera_info_text, read_camera_info, read_description, write_camera_info
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
