# SPDX-License-Identifier: Apache-2.0
"""camera_info YAML: the format of camera_calibration_parsers, written by hand and round trips."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import FileError
from imgu_ros.files.camera_info_file import camera_info_text, read_camera_info, read_camera_name, write_camera_info
from imgu_ros.vision.camera.intrinsics import COEFFICIENTS, DistortionModel, make_camera

BY_HAND = """\
image_width: 640
image_height: 480
camera_name: narrow_stereo/left
camera_matrix:
  rows: 3
  cols: 3
  data: [438.783367, 0.000000, 305.593336, 0.000000, 437.302876, 243.738352, 0.000000, 0.000000, 1.000000]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.361976, 0.110510, 0.001014, 0.000505, 0.000000]
rectification_matrix:
  rows: 3
  cols: 3
  data: [0.999978, 0.002789, -0.006046, -0.002816, 0.999986, -0.004401, 0.006034, 0.004417, 0.999972]
projection_matrix:
  rows: 3
  cols: 4
  data: [393.653800, 0.0, 322.797939, 0.0, 0.0, 393.653800, 241.090902, 0.0, 0.0, 0.0, 1.0, 0.0]
"""


def test_a_file_of_ros(tmp_path):
    (tmp_path / "a.yaml").write_text(BY_HAND)
    camera = read_camera_info(tmp_path / "a.yaml")
    assert camera.K.tolist() == [[438.783367, 0, 305.593336], [0, 437.302876, 243.738352], [0, 0, 1]]
    assert camera.distortion.tolist() == [-0.361976, 0.110510, 0.001014, 0.000505, 0]
    assert (camera.model, camera.width, camera.height) == (DistortionModel.PLUMB_BOB, 640, 480)
    assert read_camera_name(tmp_path / "a.yaml") == "narrow_stereo/left"


@given(
    st.floats(200, 6e3), st.floats(270, 370), st.sampled_from(list(DistortionModel)),
    st.lists(st.floats(1e-7, 1e-3), min_size=14, max_size=14),
)  # fmt: skip
def test_every_number_survives(tmp_path_factory, focal, center, model, coefficients):
    path = tmp_path_factory.getbasetemp() / "camera.yaml"
    K = [[focal, 0.1, center], [0, focal / 1.3, center * 0.75], [0, 0, 1]]
    camera = make_camera(K, coefficients[: COEFFICIENTS[model]], model, 641, 479)
    write_camera_info(path, camera, "cam: #1")
    again = read_camera_info(path)
    assert np.array_equal(again.K, camera.K)
    assert np.array_equal(again.distortion, camera.distortion)
    assert (again.model, again.width, again.height) == (model, 641, 479)
    assert read_camera_name(path) == "cam: #1"


def test_the_text_has_everything_that_ros_reads():
    camera = make_camera([[500, 0, 320], [0, 501, 240], [0, 0, 1]], [0.1], "plumb_bob", 640, 480)
    content = yaml.safe_load(camera_info_text(camera))
    assert list(content) == list(yaml.safe_load(BY_HAND))
    assert content["projection_matrix"] == {
        "rows": 3, "cols": 4, "data": [500, 0, 320, 0, 0, 501, 240, 0, 0, 0, 1, 0],
    }  # fmt: skip
    assert content["distortion_coefficients"] == {"rows": 1, "cols": 5, "data": [0.1, 0, 0, 0, 0]}


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("image_width: 640", "image_width: wide", "image_width: 'wide'; need a whole number"),
        ("image_width: 640\n", "", "width and height are 0 x 480; need the size"),
        ("plumb_bob", "magic", "distortion_model 'magic' is unknown"),
        ("438.783367", "-1", "K:"),
        ("438.783367", ".nan", "finite"),
        ("438.783367, ", "", "K has 8 values; need 9"),
        ("438.783367", "a", "need numbers"),
        ("  data: [438.783367, 0.000000, 305.593336, 0.000000, 437.302876, 243.738352, 0.000000, 0.000000, 1.000000]",
         "  data: [0,0,0,0,0,0,0,0,0]", "not calibrated"),
        ("camera_matrix:", "camera:", "no camera_matrix"),
        ("image_width: 640", "image_width: [", "need a camera_info YAML"),
    ],
)  # fmt: skip
def test_bad_files_are_refused_in_one_line(tmp_path, old, new, text):
    assert old in BY_HAND
    (tmp_path / "a.yaml").write_text(BY_HAND.replace(old, new))
    with pytest.raises(FileError, match=text) as error:
        read_camera_info(tmp_path / "a.yaml")
    assert "\n" not in str(error.value)


def test_other_things_are_refused(tmp_path):
    (tmp_path / "list.yaml").write_text("[1, 2]")
    (tmp_path / "opencv.yaml").write_text("%YAML:1.0\n---\nK: !!opencv-matrix\n   rows: 3\n")  # cut off
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    for name in ("list.yaml", "opencv.yaml", "binary.yaml", "none.yaml", "."):
        with pytest.raises(FileError, match="need") as error:
            read_camera_info(tmp_path / name)
        assert "\n" not in str(error.value)
    camera = make_camera([[500, 0, 320], [0, 501, 240], [0, 0, 1]], [], "equidistant", 640, 480)
    with pytest.raises(FileError, match="can be written"):
        write_camera_info(tmp_path / "none" / "a.yaml", camera)
