# SPDX-License-Identifier: Apache-2.0
"""Calibration files as their tools write them, byte for byte, and messages that say the same: one camera."""

from __future__ import annotations

import re

import cv2
import numpy as np
import pytest
import yaml

from imgu_ros.bags.messages import make_message
from imgu_ros.errors import FileError
from imgu_ros.files.camera_info_file import (
    read_calibration,
    read_camera_info,
    read_camera_name,
    read_description,
)
from imgu_ros.messages.camera_info import camera_description, decode_camera_info
from imgu_ros.messages.camera_reading import read_camera

K = [438.783367, 0.0, 305.593336, 0.0, 437.302876, 243.738352, 0.0, 0.0, 1.0]
D = [-0.361976, 0.110510, 0.001014, 0.000505, 0.0]

#: ros2 topic echo --once /camera_info
ECHO_2 = """\
header:
  stamp:
    sec: 1700000000
    nanosec: 12345
  frame_id: camera_optical_frame
height: 480
width: 640
distortion_model: plumb_bob
d:
- -0.361976
- 0.11051
- 0.001014
- 0.000505
- 0.0
k:
- 438.783367
- 0.0
- 305.593336
- 0.0
- 437.302876
- 243.738352
- 0.0
- 0.0
- 1.0
r:
- 1.0
- 0.0
- 0.0
- 0.0
- 1.0
- 0.0
- 0.0
- 0.0
- 1.0
p:
- 393.6538
- 0.0
- 322.797939
- 0.0
- 0.0
- 393.6538
- 241.090902
- 0.0
- 0.0
- 0.0
- 1.0
- 0.0
binning_x: 0
binning_y: 0
roi:
  x_offset: 0
  y_offset: 0
  height: 0
  width: 0
  do_rectify: false
---
"""
#: rostopic echo -n 1
ECHO_1 = """\
header:
  seq: 4470
  stamp:
    secs: 536577153
    nsecs: 375714660
  frame_id: "camera_fisheye1_optical_frame"
height: 480
width: 640
distortion_model: "plumb_bob"
D: [-0.361976, 0.11051, 0.001014, 0.000505, 0.0]
K: [438.783367, 0.0, 305.593336, 0.0, 437.302876, 243.738352, 0.0, 0.0, 1.0]
R: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
P: [393.6538, 0.0, 322.797939, 0.0, 0.0, 393.6538, 241.090902, 0.0, 0.0, 0.0, 1.0, 0.0]
binning_x: 0
binning_y: 0
roi:
  x_offset: 0
  y_offset: 0
  height: 0
  width: 0
  do_rectify: False
---
"""
#: camera_calibration_parsers, by yaml-cpp: numbers without a point are numbers.
ROS = """\
image_width: 640
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [438.783367, 0, 305.593336, 0, 437.302876, 243.738352, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.361976, 0.11051, 0.001014, 0.000505, 0]
"""
INI = """\
# Camera intrinsics

[image]

width
640

height
480

[narrow_stereo/left]

camera matrix
438.783367 0.000000 305.593336
0.000000 437.302876 243.738352
0.000000 0.000000 1.000000

distortion
-0.361976 0.110510 0.001014 0.000505 0.000000

rectification
1.000000 0.000000 0.000000
0.000000 1.000000 0.000000
0.000000 0.000000 1.000000

projection
393.653800 0.000000 322.797939 0.000000
0.000000 393.653800 241.090902 0.000000
0.000000 0.000000 1.000000 0.000000

"""
OPENCV_2 = """\
%YAML:1.0
calibration_Time: "Thu 27 Mar 2014 10:26:40"
image_Width: 640
image_Height: 480
Camera_Matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 4.3878336700000001e+02, 0., 3.0559333600000002e+02, 0.,
       4.3730287600000003e+02, 2.4373835199999999e+02, 0., 0., 1. ]
Distortion_Coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -3.6197600000000002e-01, 1.1051000000000000e-01,
       1.0139999999999999e-03, 5.0500000000000002e-04, 0. ]
"""
KALIBR = """\
cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.361976, 0.11051, 0.001014, 0.000505]
  distortion_model: radtan
  intrinsics: [438.783367, 437.302876, 305.593336, 243.738352]
  resolution: [640, 480]
  rostopic: /cam0/image_raw
cam1:
  camera_model: omni
  distortion_coeffs: []
  distortion_model: none
  intrinsics: [1.0, 438.783367, 437.302876, 305.593336, 243.738352]
  resolution: [640, 480]
  rostopic: /cam1/image_raw
"""


ORB_SLAM_2 = """\
%YAML:1.0

#--------------------------------------------------------------------------------------------
# Camera Parameters. Adjust them!
#--------------------------------------------------------------------------------------------

Camera.fx: 438.783367
Camera.fy: 437.302876
Camera.cx: 305.593336
Camera.cy: 243.738352

Camera.k1: -0.361976
Camera.k2: 0.110510
Camera.p1: 0.001014
Camera.p2: 0.000505

Camera.width: 640
Camera.height: 480

# Camera frames per second
Camera.fps: 20.0
"""
ORB_SLAM_3 = """\
%YAML:1.0
File.version: "1.0"
Camera.type: "PinHole"
Camera1.fx: 438.783367
Camera1.fy: 437.302876
Camera1.cx: 305.593336
Camera1.cy: 243.738352
Camera1.k1: -0.361976
Camera1.k2: 0.110510
Camera1.p1: 0.001014
Camera1.p2: 0.000505
Camera.width: 640
Camera.height: 480
"""
OPENVSLAM = """\
Camera.name: "EuRoC monocular"
Camera.setup: "monocular"
Camera.model: "perspective"
Camera.fx: 438.783367
Camera.fy: 437.302876
Camera.cx: 305.593336
Camera.cy: 243.738352
Camera.k1: -0.361976
Camera.k2: 0.110510
Camera.p1: 0.001014
Camera.p2: 0.000505
Camera.k3: 0.0
Camera.cols: 640
Camera.rows: 480
"""


@pytest.mark.parametrize(
    ("text", "name"),
    [
        (ECHO_2, ""),
        (ECHO_2 + ECHO_2, ""),
        (ECHO_1, ""),
        (ROS, "narrow_stereo"),
        (INI, "narrow_stereo/left"),
        (INI.replace("\n", "\r\n"), "narrow_stereo/left"),
        (INI + INI.replace("left", "right").replace("438.78", "999.99"), "narrow_stereo/left"),
        (OPENCV_2, ""),
        (KALIBR, "/cam0/image_raw"),
        (ORB_SLAM_2, ""),
        (ORB_SLAM_3, ""),
        (OPENVSLAM, "EuRoC monocular"),
        (
            '{"K": ' + str(K) + ', "D": ' + str(D) + ', "width": 640, "height": 480, "distortion_model": "plumb_bob"}',
            "",
        ),
        ("\ufeff" + ROS, "narrow_stereo"),
        (ROS.replace("0.001014", "1.014e-3").replace("0.000505", "505e-06"), "narrow_stereo"),
        (ROS.replace("distortion_model: plumb_bob\n", ""), "narrow_stereo"),
    ],
)
def test_every_format_gives_the_camera(tmp_path, text, name):
    (tmp_path / "camera.txt").write_text(text, encoding="utf-8", newline="")
    read = read_calibration(tmp_path / "camera.txt", image_size=(640, 480))
    assert (read.reason, read.remarks) == ("", ())
    assert read.camera.K.ravel().tolist() == K
    assert read.camera.distortion.tolist() == D
    assert str(read.camera.model) == "plumb_bob"
    assert (read.camera.width, read.camera.height) == (640, 480)
    assert read_camera_name(tmp_path / "camera.txt") == name


@pytest.mark.parametrize("suffix", ["yml", "yaml"])
@pytest.mark.parametrize("count", [4, 5, 8, 12, 14])
def test_what_opencv_itself_writes(tmp_path, suffix, count):
    path = tmp_path / f"camera.{suffix}"
    rng = np.random.default_rng(count)
    D = rng.uniform(-1e-3, 1e-3, count)
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("calibration_time", "Sun Nov 29 2026")
    storage.write("nframes", 20)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("flags", 0)
    storage.write("camera_matrix", np.reshape(K, (3, 3)))
    storage.write("distortion_coefficients", D[None])
    storage.write("avg_reprojection_error", 0.25)
    storage.release()
    camera = read_camera_info(path)
    assert camera.K.ravel().tolist() == K
    assert camera.distortion[:count].tolist() == D.tolist()
    xy = rng.uniform(-0.3, 0.3, (20, 2))
    expected, _ = cv2.projectPoints(np.column_stack((xy, np.ones(20))), np.zeros(3), np.zeros(3), camera.K, D)
    np.testing.assert_allclose(camera.distort(xy), expected[:, 0], atol=1e-9)


def test_a_fisheye_of_opencv(tmp_path):
    text = OPENCV_2.replace("calibration_Time", "fisheye_model: 1\ncalibration_Time").replace("505", "51")
    (tmp_path / "f.yml").write_text(text.replace(", 0. ]", " ]", 1).replace(", 0. ]\n", " ]\n"))
    assert str(read_camera_info(tmp_path / "f.yml").model) == "equidistant"


@pytest.mark.parametrize(
    ("text", "model", "says"),
    [
        (KALIBR.replace("radtan", "equidistant").replace("-0.361976", "0.01"), "equidistant", ""),
        (KALIBR.replace("distortion_model: radtan", "distortion_model: fov"), "", "'fov' is not computed"),
        (
            KALIBR.replace("camera_model: pinhole", "camera_model: ds").replace("[438.7", "[-0.2, 0.6, 438.7"),
            "",
            "'ds'",
        ),
        (KALIBR.replace("camera_model: pinhole", "camera_model: omni").replace("[438.7", "[1.2, 438.7"), "", "'omni'"),
        (
            ORB_SLAM_3.replace("PinHole", "KannalaBrandt8").replace(".p1", ".k3").replace(".p2", ".k4"),
            "equidistant",
            "",
        ),
        (OPENVSLAM.replace("perspective", "equirectangular"), "", "no perspective"),
        (ORB_SLAM_2.replace("Camera.width: 640\n", ""), "", "width and height are 0 x 480"),
    ],
)
def test_other_models(tmp_path, text, model, says):
    (tmp_path / "a.yaml").write_text(text)
    read = read_calibration(tmp_path / "a.yaml", image_size=(640, 480))
    assert says in read.reason
    assert ("" if read.camera is None else str(read.camera.model)) == model


@pytest.mark.parametrize(
    ("changes", "outcome"),
    [
        ({}, ""),
        ({"distortion_model": ""}, ""),
        ({"distortion_model": "Brown Conrady"}, ""),
        ({"distortion_model": "fisheye", "d": [0.01, 0.0, 0.0, 0.0]}, ""),
        ({"distortion_model": "ds", "d": [0.1, 0.5]}, "not computed"),
        ({"d": []}, ""),
        ({"d": [1e-4] * 8}, ""),
        ({"d": [1e-4] * 6}, "need 4, 5"),
        ({"width": 0, "height": 0}, "width and height"),
        ({"width": 1280, "height": 960, "binning_x": 2, "binning_y": 2}, "binned image"),
        (
            {"width": 1280, "height": 960, "roi": {"x_offset": 320, "y_offset": 240, "width": 640, "height": 480}},
            "window",
        ),
        ({"roi": {"x_offset": 0, "y_offset": 0, "width": 639, "height": 480}}, "same size"),
        ({"k": [1.0, 0, 0, 0, 1, 0, 0, 0, 1]}, "identity"),
        ({"k": [float("nan")] * 9}, "finite"),
        ({"k": [0.0] * 9}, "all zero"),
    ],
)
@pytest.mark.parametrize("rectified", [False, True])
def test_a_file_and_a_message_agree(tmp_path, changes, outcome, rectified):
    """The message is echoed into a file; both are read."""
    fields = yaml.safe_load(ECHO_2.rstrip("-\n")) | changes
    roi = make_message("sensor_msgs/msg/RegionOfInterest", **fields["roi"])
    arrays = {name: np.array(fields[name], np.float64) for name in "dkrp"}
    header = make_message("std_msgs/msg/Header", frame_id="camera")
    message = make_message("sensor_msgs/msg/CameraInfo", **(fields | arrays | {"roi": roi, "header": header}))
    (tmp_path / "echo.yaml").write_text(yaml.safe_dump(fields) + "---\n")
    by_message = decode_camera_info(message, rectified=rectified, image_size=(640, 480))
    by_file = read_calibration(tmp_path / "echo.yaml", rectified=rectified, image_size=(640, 480))
    source = f"{tmp_path / 'echo.yaml'}: "
    assert by_file.reason.replace(source, "camera_info: ") == by_message.reason
    assert tuple(line.replace(source, "camera_info: ") for line in by_file.remarks) == by_message.remarks
    assert (by_file.camera is None) == (by_message.camera is None)
    if by_file.camera is not None:
        assert by_file.camera.K.tolist() == by_message.camera.K.tolist()
        assert by_file.camera.distortion.tolist() == by_message.camera.distortion.tolist()
    described = read_description(tmp_path / "echo.yaml")
    if "nan" not in str(described):
        assert camera_description(message, described.source) == described
    if not rectified:
        assert outcome in by_message.reason
        assert bool(by_message.reason) == bool(outcome)


def test_the_size_of_the_image_is_that_of_window_and_binning(tmp_path):
    fields = yaml.safe_load(ECHO_2.rstrip("-\n"))
    fields |= {"binning_x": 2, "binning_y": 2, "roi": {"x_offset": 80, "y_offset": 60, "width": 480, "height": 360}}
    (tmp_path / "echo.yaml").write_text(yaml.safe_dump(fields))
    camera = read_camera_info(tmp_path / "echo.yaml")
    assert (camera.width, camera.height) == (240, 180)
    np.testing.assert_allclose(camera.K[:2, 2], [(305.593336 - 80.5) / 2, (243.738352 - 60.5) / 2])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (KALIBR.replace("[438.783367, 437.302876, 305.593336, 243.738352]", "[1, 2, 3]"), "need fu fv pu pv"),
        (KALIBR.replace("resolution: [640, 480]", "resolution: 640"), "need width and height"),
        (INI.replace("438.783367", "4x8"), "need numbers"),
        (ROS.replace("image_width: 640", "image_width: -3"), "need a whole number"),
        (ROS.replace("image_width: 640", "image_width: 1e999"), "need a whole number"),
        (ROS.replace("data: [438.783367, 0", "data: [true, 0"), "need numbers"),
        (ROS.replace("data: [438.783367, 0", "data: [{}, 0"), "need numbers"),
        ("K: 7", "need a list of numbers"),
        ("K: [" + "1, " * 5000 + "1]", "need those of one camera"),
        ("- 1\n- 2\n", "holds list"),
        ("", "holds nothing"),
        ('<?xml version="1.0"?>\n<opencv_storage>\n<image_width>640</image_width>\n</opencv_storage>\n', "text or XML"),
        ("a: *b", "no YAML in line 1"),
        ("a: !!python/object/apply:os.system [ls]", "no camera_matrix"),
    ],
)
def test_what_is_no_calibration_is_refused_in_one_line(tmp_path, text, says):
    (tmp_path / "a.yaml").write_text(text)
    with pytest.raises(FileError) as error:
        read_calibration(tmp_path / "a.yaml")
    assert says in str(error.value)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 600


@pytest.mark.parametrize(
    "name",
    ["plumb_bob", "plumb_bob_8", "plumb_bob_8zeros", "rational_14zeros", "none", "radtan", "empty_name", "opencv.yml",
     "kalibr", "ini.ini"],
)  # fmt: skip
def test_shared_files(data_dir, name):
    folder = data_dir.parent / "cases" / "camera_yaml"
    if not folder.is_dir():
        pytest.skip("no shared cases")
    camera = read_camera_info(folder / (name if "." in name else f"{name}.yaml"))
    np.testing.assert_allclose(camera.K, [[544, 0, 322.8], [0, 544, 237.4], [0, 0, 1]])
    assert np.abs(camera.distortion).max() < 2e-4


def test_shared_messages(data_dir):
    """Every row of the shared table has its third entry's outcome."""
    path = data_dir.parent / "cases" / "distortion_messages.yaml"
    if not path.is_file():
        pytest.skip("no shared cases")
    said = read_description(data_dir.parent / "cases" / "camera_yaml" / "plumb_bob.yaml")
    rows = yaml.safe_load(path.read_text())
    assert len(rows) >= 20
    for model, D, outcome in rows:
        changed = type(said)("camera_info", said.K, tuple(float(k) for k in D), model, 640, 480)
        read = read_camera(changed, rectified=False, image_size=(640, 480))
        bent = read.camera is not None and read.camera.is_distorted
        assert (read.camera is None, bent) == (outcome == "homography", outcome == "computed"), (model, D, read.reason)


@pytest.mark.parametrize(
    "value",
    ['!!int ""', "!!bool x", "!!timestamp x", "1" * 310, "[1, 2]", "{a: 1}"],
)
def test_values_that_are_no_numbers_are_a_file_error(tmp_path, value):
    """Also where PyYAML, or float(), raises what is no YAML error."""
    path = tmp_path / "camera.yaml"
    for key in ("image_width: 640", "image_height: 480"):
        assert key in ROS
        path.write_text(ROS.replace(key, f"{key.partition(':')[0]}: {value}"))
        with pytest.raises(FileError, match=re.escape(str(path))):
            read_camera_info(path)
    path.write_text(re.sub(r"data: \[[^\]]*\]", f"data: [{value}, 1, 1, 1, 1, 1, 1, 1, 1]", ROS))
    with pytest.raises(FileError, match=re.escape(str(path))):
        read_camera_info(path)
