# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from imgu_ros.errors import EncodingError
from imgu_ros.messages.camera_info import camera_info_message, decode_camera_info
from imgu_ros.messages.frame import decode_frame
from imgu_ros.messages.header import Header
from imgu_ros.messages.image import image_message
from imgu_ros.vision.camera.intrinsics import Camera, DistortionModel, make_camera

K = np.array([[500.0, 0.0, 319.5], [0.0, 510.0, 239.5], [0.0, 0.0, 1.0]])
P = np.array([[480.0, 0.0, 315.0, -48.0], [0.0, 480.0, 236.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
SIZE = (640, 480)


def info(make, *, roi: dict[str, object] | None = None, **changes):
    fields = {
        "width": 640,
        "height": 480,
        "distortion_model": "plumb_bob",
        "d": np.array([0.1, -0.2, 0.001, 0.002, 0.05]),
        "k": K.reshape(9),
        "r": np.eye(3).reshape(9),
        "p": P.reshape(12),
        "binning_x": 0,
        "binning_y": 0,
        "roi": make("sensor_msgs/msg/RegionOfInterest", **(roi or {})),
    }
    return make("sensor_msgs/msg/CameraInfo", **(fields | changes))


def decode(message, size=SIZE, rectified=False) -> Camera:
    read = decode_camera_info(message, rectified=rectified, image_size=size)
    assert read.camera is not None, read.reason
    assert read.reason == ""
    return read.camera


def reason(message, size=SIZE, rectified=False) -> str:
    read = decode_camera_info(message, rectified=rectified, image_size=size)
    assert (read.camera, read.remarks) == (None, ())
    assert read.reason.startswith("camera_info: ")
    assert "\n" not in read.reason
    return read.reason


def test_plain(make):
    camera = decode(info(make))
    np.testing.assert_array_equal(camera.K, K)
    np.testing.assert_array_equal(camera.distortion, [0.1, -0.2, 0.001, 0.002, 0.05])
    assert (camera.model, camera.width, camera.height) == (DistortionModel.PLUMB_BOB, 640, 480)


def test_rectified_uses_p_and_no_distortion(make):
    camera = decode(info(make), rectified=True)
    np.testing.assert_array_equal(camera.K, P[:, :3])
    assert not camera.is_distorted


def test_rectified_ignores_a_fisheye_model(make):
    camera = decode(info(make, distortion_model="equidistant", d=np.full(4, 0.1)), rectified=True)
    assert not camera.is_distorted


EIGHT = [0.35, 0.08, 0.0006, -0.0004, 0.01, 0.62, 0.16, 0.01]


@pytest.mark.parametrize(
    ("model", "d", "expected_model", "expected"),
    [
        ("plumb_bob", [], "plumb_bob", [0] * 5),
        ("plumb_bob", [0.1, 0.2, 0.03, 0.04], "plumb_bob", [0.1, 0.2, 0.03, 0.04, 0]),
        ("plumb_bob", [0.1, 0.2, 0.03, 0.04, 0.5, 0, 0, 0], "plumb_bob", [0.1, 0.2, 0.03, 0.04, 0.5]),
        ("plumb_bob", EIGHT, "rational_polynomial", EIGHT),
        ("rational_polynomial", EIGHT, "rational_polynomial", EIGHT),
        ("rational_polynomial", EIGHT[:5], "rational_polynomial", [*EIGHT[:5], 0, 0, 0]),
        ("rational_polynomial", [*EIGHT, 0, 0, 0, 0], "rational_polynomial", EIGHT),
        ("rational_polynomial", [*EIGHT, 0, 0, 0, 0, 0, 0], "rational_polynomial", EIGHT),
        ("rational_polynomial", [*EIGHT, 1e-3, 0, 0, 0], "thin_prism", [*EIGHT, 1e-3, 0, 0, 0]),
        ("rational_polynomial", [*EIGHT, 1e-3, 0, 0, 0, 0, 1e-2], "tilted", [*EIGHT, 1e-3, 0, 0, 0, 0, 1e-2]),
        ("equidistant", [0.1, 0.2, 0.3, 0.4], "equidistant", [0.1, 0.2, 0.3, 0.4]),
        ("equidistant", [], "equidistant", [0] * 4),
        ("", [], "plumb_bob", [0] * 5),
        ("", [0, 0, 0, 0, 0], "plumb_bob", [0] * 5),
        ("none", [], "plumb_bob", [0] * 5),
    ],
)
def test_distortion_models(make, model, d, expected_model, expected):
    camera = decode(info(make, distortion_model=model, d=np.array(d, np.float64)))
    assert camera.model == expected_model
    np.testing.assert_array_equal(camera.distortion, expected)


def test_uncalibrated_is_none(make):
    for rectified, changes in ((False, {"k": np.zeros(9)}), (True, {"p": np.zeros(12)})):
        message = info(make, **changes)
        assert "all zero: the camera is not calibrated" in reason(message, rectified=rectified)
    # What counts is the matrix that is used.
    decode(info(make, k=np.zeros(9)), rectified=True)


@pytest.mark.parametrize("binning", [(1, 1), (2, 2), (4, 2), (3, 1)])
@pytest.mark.parametrize("offset", [(0, 0), (120, 48)])
def test_roi_and_binning(make, binning, offset):
    """A binned pixel's centre is the mean of the centres of the sensor pixels that it combines."""
    bx, by = binning
    x0, y0 = offset
    roi = {"x_offset": x0, "y_offset": y0, "width": 360, "height": 240}
    camera = decode(info(make, binning_x=bx, binning_y=by, roi=roi), (360 // bx, 240 // by))
    full = decode(info(make))
    points = np.random.default_rng(0).uniform((-0.3, -0.3, 2.0), (0.3, 0.3, 4.0), (20, 3))
    columns = np.arange(360).reshape(-1, bx).mean(axis=1) + x0
    rows = np.arange(240).reshape(-1, by).mean(axis=1) + y0
    on_sensor = full.project(points)
    # The image's coordinates of a sensor point, by interpolating the table of pixel centres (linear, extrapolated).
    expected_x = np.polyval(np.polyfit(columns, np.arange(360 // bx), 1), on_sensor[:, 0])
    expected_y = np.polyval(np.polyfit(rows, np.arange(240 // by), 1), on_sensor[:, 1])
    np.testing.assert_allclose(camera.project(points), np.column_stack((expected_x, expected_y)), atol=1e-8)


def test_binning_zero_means_one_and_sizes_may_round(make):
    assert decode(info(make, binning_x=0, binning_y=1)).width == 640
    assert decode(info(make, binning_x=3, binning_y=1), (213, 480)).width == 213
    assert decode(info(make, binning_x=3, binning_y=1), (214, 480)).width == 214


def test_a_roi_without_a_size_reaches_to_the_edge(make):
    camera = decode(info(make, roi={"x_offset": 40, "y_offset": 80}), (600, 400))
    assert (camera.K[0, 2], camera.K[1, 2]) == (319.5 - 40, 239.5 - 80)


def test_do_rectify_changes_nothing(make):
    roi = {"x_offset": 40, "y_offset": 80, "width": 200, "height": 100}
    one = decode(info(make, roi=roi | {"do_rectify": True}), (200, 100), rectified=True)
    other = decode(info(make, roi=roi), (200, 100), rectified=True)
    np.testing.assert_array_equal(one.K, other.K)


NAN = math.nan


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"k": np.where(np.arange(9) == 4, NAN, K.reshape(9))}, "camera_info: K [500, 0, 319.5, 0, nan"),
        ({"k": np.where(np.arange(9) == 0, math.inf, K.reshape(9))}, "need finite numbers"),
        ({"d": np.array([NAN])}, "camera_info: D [nan]; need finite numbers"),
        ({"k": np.diag([-500.0, 500, 1]).reshape(9)}, "camera_info: K: [[-500.0"),
        ({"k": np.diag([0.0, 500, 1]).reshape(9)}, "fx > 0"),
        ({"k": np.diag([500.0, 500, 2]).reshape(9)}, "fx > 0"),
        ({"k": K.T.reshape(9)}, "fx > 0"),
        ({"width": 1280}, "camera_info: size 1280 x 480 px, image 640 x 480 px; need the same size"),
        ({"width": 0, "height": 0}, "camera_info: width and height are 0 x 0: which resolution K is for is not said"),
        ({"binning_x": 2}, "camera_info: size 640 x 480 px binned 2 x 1, image 640 x 480 px"),
        ({"roi": {"x_offset": 600, "width": 100, "height": 480}}, "roi 100 x 480 px at (600, 0); need a window inside"),
        ({"roi": {"x_offset": 4_000_000_000}}, "need a window inside 640 x 480"),
        ({"distortion_model": "plumbob"}, "distortion_model 'plumbob' is unknown (did you mean 'plumb_bob'?)"),
        ({"distortion_model": "equidistant"}, "D has 5 coefficients for 'equidistant'; need at most 4"),
        ({"distortion_model": "rational_polynomial", "d": np.ones(13)}, "need 4, 5, 8, 12 or 14"),
        ({"d": np.full(5, -50.0)}, "folds the image"),
    ],
)
def test_bad_camera_info(make, changes, says):
    assert says in reason(info(make, **changes))


def test_bad_p_is_named(make):
    assert "camera_info: P[:3, :3]: [[-1.0" in reason(info(make, p=-np.eye(3, 4).reshape(12)), rectified=True)


def test_ros_1_names(make):
    """ROS 1 writes D, K, R and P in capitals."""
    new = info(make)
    old = SimpleNamespace(
        **{
            name: getattr(new, name)
            for name in ("width", "height", "distortion_model", "binning_x", "binning_y", "roi")
        },
        **{name.upper(): getattr(new, name) for name in "dkrp"},
    )
    np.testing.assert_array_equal(decode(old).K, K)
    np.testing.assert_array_equal(decode(old, rectified=True).K, P[:, :3])


@pytest.mark.parametrize(
    ("model", "d"),
    [
        ("plumb_bob", [0.1, -0.2, 0, 0, 1]),
        ("rational_polynomial", EIGHT),
        ("thin_prism", [*EIGHT, 0, 0, 0, 1e-3]),
        ("tilted", [*EIGHT, 0, 0, 0, 0, 0.01, 0.02]),
        ("equidistant", [0.01]),
    ],
)
def test_round_trip(make, model, d):
    camera = make_camera(K, list(d), model, 640, 480)
    message = camera_info_message(make, Header(7, "camera"), camera)
    # ROS has no name for OpenCV's longer models: readers take the coefficients by their number.
    assert message.distortion_model == ("rational_polynomial" if model in ("thin_prism", "tilted") else model)
    again = decode(message)
    np.testing.assert_array_equal(again.K, camera.K)
    np.testing.assert_array_equal(again.distortion, camera.distortion)
    assert again.model is camera.model
    np.testing.assert_array_equal(decode(message, rectified=True).K, camera.K)
    assert message.header.frame_id == "camera"
    np.testing.assert_array_equal(message.p, np.column_stack((K, np.zeros(3))).reshape(12))
    np.testing.assert_array_equal(message.r, np.eye(3).reshape(9))


def test_frame(make):
    pixels = np.arange(640 * 480, dtype=np.uint16).reshape(480, 640)
    image = image_message(make, Header(123, "camera"), pixels, "bayer_rggb16")
    frame = decode_frame(image, info(make), rectified=False)
    assert (frame.stamp_ns, frame.frame_id) == (123, "camera")
    assert frame.camera is not None
    assert decode_frame(image, None, rectified=False).camera is None
    assert frame.camera_reason == ""
    # An unusable camera_info costs the pose alone.
    without = decode_frame(image, info(make, width=320), rectified=False)
    assert without.camera is None
    assert "size 320 x 480" in without.camera_reason
    assert without.image.pixels.shape == (480, 640)
    with pytest.raises(EncodingError, match="need sensor_msgs/Image or CompressedImage"):
        decode_frame(info(make), None, rectified=False)


def test_compressed_frame(make):
    from imgu_ros.messages.compressed_image import compressed_image_message

    image = compressed_image_message(make, Header(123, "camera"), np.zeros((480, 640), np.uint8), "bayer_rggb8")
    frame = decode_frame(image, info(make), rectified=False)
    assert frame.image.layout.pattern == "rggb"
    assert frame.camera is not None


def test_equal_messages_give_one_camera_whatever_is_not_used(make):
    first, second = (decode(info(make, p=np.full(12, NAN), d=np.zeros(5))) for _ in range(2))
    assert first is second
