# SPDX-License-Identifier: Apache-2.0
"""camera_info of reduced pictures: it says of which frame they are, in ROS's own terms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.bags import messages
from imgu_ros.config.parameters import Parameters, PyramidParameters
from imgu_ros.detect.features import reduction_of
from imgu_ros.errors import EncodingError
from imgu_ros.messages.camera_info import decode_camera_info
from imgu_ros.messages.header import Header, decode_header
from imgu_ros.messages.reduced_info import (
    Covered,
    camera_info_size,
    decode_covered,
    image_size,
    reduced_info_from,
    reduced_info_message,
)
from imgu_ros.vision.camera.intrinsics import DistortionModel, make_camera

HEADER, LATER = Header(5, "camera"), Header(6, "camera")


@given(st.integers(64, 3000), st.integers(64, 3000), st.integers(64, 1000), st.booleans())
def test_every_reduction_of_the_chain_is_told(width, height, most, calibrated):
    reduction = reduction_of((height, width), Parameters(pyramid=PyramidParameters(max_side_px=most)))
    covered = Covered(reduction.full_width, reduction.full_height)
    size = Covered(reduction.width, reduction.height)
    camera = make_camera(np.diag([500.0, 500, 1]), [], DistortionModel.PLUMB_BOB, width, height) if calibrated else None
    message = reduced_info_message(messages.make_message, HEADER, camera, Covered(width, height), covered, size)
    assert decode_covered(message, size) == covered
    assert (message.width, message.height) == (width, height)


def test_ros_reads_the_camera_of_the_picture_in_it(make):
    camera = make_camera(np.array([[800.0, 0, 320], [0, 800, 240], [0, 0, 1]]), [], DistortionModel.PLUMB_BOB, 640, 480)
    message = reduced_info_message(make, HEADER, camera, Covered(640, 480), Covered(640, 480), Covered(320, 240))
    seen = decode_camera_info(message, rectified=False, image_size=(320, 240)).camera
    # Half as many pixels in the focal length; pixel centres at integers.
    np.testing.assert_allclose(seen.K, [[400, 0, 159.75], [0, 400, 119.75], [0, 0, 1]])


def test_a_further_reduction_leaves_the_message_that_it_is_made_of(make):
    first = reduced_info_message(make, HEADER, None, Covered(640, 480), Covered(640, 480), Covered(640, 480))
    second = reduced_info_from(make, LATER, first, Covered(640, 480), Covered(160, 120))
    assert (first.binning_x, second.binning_x, second.binning_y) == (1, 4, 4)
    assert (decode_header(first), decode_header(second)) == (HEADER, LATER)
    assert decode_covered(second, Covered(160, 120)) == Covered(640, 480)
    read = decode_camera_info(second, rectified=False, image_size=(160, 120))
    assert (read.camera, read.reason) == (None, "camera_info: K is all zero: the camera is not calibrated")


def test_what_a_driver_says_without_any_reduction(make):
    message = make("sensor_msgs/msg/CameraInfo", width=640, height=480)
    assert camera_info_size(message) == image_size(message) == decode_covered(message, Covered(640, 480))
    message.binning_x, message.binning_y = 2, 2
    assert image_size(message) == Covered(320, 240)
    message.roi.width, message.roi.height = 200, 100
    assert image_size(message) == Covered(100, 50)


def test_sizes_that_do_not_fit_are_refused(make):
    message = make("sensor_msgs/msg/CameraInfo", width=640, height=480)
    with pytest.raises(EncodingError, match="need the same size"):
        decode_covered(message, Covered(320, 240))
    with pytest.raises(EncodingError, match="need the same size"):
        decode_covered(message, Covered(641, 480))
    with pytest.raises(EncodingError, match="need the image's size"):
        image_size(make("sensor_msgs/msg/CameraInfo"))
