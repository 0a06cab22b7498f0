# SPDX-License-Identifier: Apache-2.0
"""Pictures by image_transport's convention: compressed in and out, JPEG and PNG, camera_info beside the image topic."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")

from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

from imgu_ros.messages.camera_info import camera_info_message
from imgu_ros.messages.compressed_image import compressed_image_message, decode_compressed_image
from imgu_ros.messages.features import decode_homographies
from imgu_ros.messages.header import Header, decode_header
from imgu_ros.ros.messages import make_message
from imgu_ros.ros.qos import image_qos

COMPRESSED = "sensor_msgs/msg/CompressedImage"
CLOUD = "sensor_msgs/msg/PointCloud2"


def test_compressed_in_and_out(imgu, world, peer, prompt_s):
    node = imgu(
        "node", "perception", *world.arguments, "-p", "image_transport:=compressed", "-r", "image_raw:=/cam/image_raw"
    )
    node.wait_for_line("targets: poster")
    images = peer.publisher("/cam/image_raw/compressed", COMPRESSED, image_qos())
    infos = peer.publisher("/cam/camera_info", "sensor_msgs/msg/CameraInfo", image_qos())
    peer.hear("/homography", CLOUD)
    peer.hear("/pose", "geometry_msgs/msg/PoseWithCovarianceStamped")
    peer.hear("/image_color/compressed", COMPRESSED)
    peer.wait(lambda: images.get_subscription_count() and infos.get_subscription_count(), "the node's subscriptions")
    peer.wait(peer.has_publishers, "the node's outputs")
    peer.spin(0.5)

    def send(frame, kind: str) -> None:
        header = Header(frame.stamp_ns, frame.frame_id)
        infos.publish(camera_info_message(make_message, header, frame.camera))
        images.publish(
            compressed_image_message(make_message, header, frame.image.pixels, "bayer_rggb8", file_format=kind)
        )

    def picture_of(frame, kind: str):
        def arrived():
            return [m for m in peer.heard["/image_color/compressed"] if decode_header(m).stamp_ns == frame.stamp_ns]

        send(frame, kind)
        peer.wait(arrived, f"the picture of {kind}", again=lambda: send(frame, kind))
        return arrived()[0]

    # A mosaic as PNG loses nothing: what comes out is what the raw frame gives, to the last digit.
    first = world.frames[0]
    picture = picture_of(first, "png")
    assert picture.format == "rgb8; jpeg compressed bgr8"
    pixels = decode_compressed_image(picture).pixels[:, :, ::-1].astype(float)
    assert np.abs(pixels - world.results[0].developed.color()).mean() < 4
    peer.wait(lambda: peer.heard["/homography"] and peer.heard["/pose"], "homography and pose")
    row = decode_homographies(peer.heard["/homography"][0])[0]
    np.testing.assert_array_equal(row["h"].reshape(3, 3), world.results[0].first.homography.H)
    assert decode_header(peer.heard["/pose"][0]) == Header(first.stamp_ns, first.frame_id)

    # The output's format at run time, without losing the listener; JPEG in is not the mosaic any more, but a picture.
    request = SetParameters.Request(parameters=[Parameter("compressed.format", value="png").to_parameter_msg()])
    assert peer.call(SetParameters, "/perception/set_parameters", request).results[0].successful
    second = replace(first, stamp_ns=first.stamp_ns + 10_000_000)

    def is_png() -> bool:
        return peer.heard["/image_color/compressed"][-1].format == "rgb8; png compressed bgr8"

    send(second, "png")
    peer.wait(is_png, "a PNG", again=lambda: send(second, "png"))
    pixels = decode_compressed_image(peer.heard["/image_color/compressed"][-1]).pixels[:, :, ::-1]
    np.testing.assert_array_equal(pixels, world.results[0].developed.color())
    third = replace(first, stamp_ns=first.stamp_ns + 20_000_000)
    assert picture_of(third, "jpeg").format == "rgb8; png compressed bgr8"
    assert node.stop() < prompt_s
    assert "Traceback" not in node.text
