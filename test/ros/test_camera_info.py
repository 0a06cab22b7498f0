# SPDX-License-Identifier: Apache-2.0
"""camera_info messages of rclpy, live: what cannot be used costs the pose alone, and is said once."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")

from imgu_ros.config.values import parameters_from
from imgu_ros.messages.camera_info import camera_info_message
from imgu_ros.messages.features import decode_homographies, homographies_message, matches_message
from imgu_ros.messages.header import Header, decode_header
from imgu_ros.messages.image import image_message
from imgu_ros.reference.templates import TargetImage
from imgu_ros.result import PoseStatus, ReferenceMatches, Status
from imgu_ros.ros.frame_worker import FrameMessages
from imgu_ros.ros.messages import make_message
from imgu_ros.ros.stages.homography import INLIERS, HomographyStage
from imgu_ros.ros.stages.pose import PoseStage
from imgu_ros.vision.matching.matches import Matches

NAN = math.nan
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"


def roi(**fields: int) -> Any:
    return make_message("sensor_msgs/msg/RegionOfInterest", **fields)


#: Fields that differ from a good message of 480 x 360 px, and what is said; empty: there is a pose.
MESSAGES: tuple[tuple[dict[str, Any], str], ...] = (
    ({}, ""),
    ({"distortion_model": ""}, ""),
    ({"distortion_model": "none", "d": []}, ""),
    ({"distortion_model": "Inverse Brown Conrady", "d": [0.0] * 5}, ""),
    ({"distortion_model": "rational_polynomial", "d": [0.0] * 14}, ""),
    ({"distortion_model": "something_else", "d": [0.0] * 5}, ""),
    ({"distortion_model": "Brown Conrady", "d": [1e-7] * 5}, ""),
    ({"distortion_model": "rational_polynomial", "d": [1e-7] * 14}, ""),
    ({"r": np.zeros(9), "p": np.zeros(12)}, ""),
    ({"p": np.full(12, NAN)}, ""),  # P is not used
    ({"binning_x": 1, "binning_y": 1}, ""),
    ({"roi": roi(width=480, height=360)}, ""),
    ({"width": 0, "height": 0}, "width and height are 0 x 0"),
    ({"width": 960, "height": 720}, "size 960 x 720 px, image"),
    ({"binning_x": 2, "binning_y": 2}, "binned 2 x 2"),
    ({"roi": roi(width=479, height=360)}, "size 479 x 360 px"),
    ({"roi": roi(x_offset=100, y_offset=100, width=480, height=360)}, "need a window inside"),
    ({"roi": roi(x_offset=4_000_000_000)}, "need a window inside"),
    ({"k": np.zeros(9)}, "K is all zero"),
    ({"k": np.eye(3).ravel()}, "K is the identity"),
    ({"k": np.full(9, NAN)}, "need finite numbers"),
    ({"k": np.array([0.004, 0, 240, 0, 0.004, 180, 0, 0, 1])}, "in metres?"),
    ({"k": np.array([408.0, 0, 0, 0, 408, 0, 0, 0, 1])}, "principal point at (0, 0)"),
    ({"k": np.array([816.0, 0, 480, 0, 816, 360, 0, 0, 1])}, "as of an image of about 960 x 720"),
    ({"distortion_model": "ds", "d": [-0.2, 0.6]}, "'ds' is not computed"),
    ({"distortion_model": "omni", "d": [0.9, 0.1]}, "'omni' is not computed"),
    ({"distortion_model": "something_else", "d": [0.1, 0.2]}, "'something_else' is unknown"),
    ({"distortion_model": "equidistant", "d": [1e-4] * 5}, "need at most 4"),
    ({"d": [NAN]}, "D [nan]"),
    ({"d": [1e-4] * 7}, "need 4, 5, 8, 12 or 14"),
)


def test_thirty_messages_to_the_node(imgu, world, peer, make_camera, prompt_s):
    node = imgu("node", "perception", *world.arguments, "-r", "image_raw:=/cam/image_raw")
    node.wait_for_line("targets: poster")
    peer.hear("/status", DIAGNOSTICS)
    peer.hear("/pose", POSE)
    camera = make_camera(peer)
    camera.wait_for_node()
    frame = world.frames[0]
    for number, (changes, says) in enumerate(MESSAGES, 1):
        # Far apart: what is known of a frame is no help for the next.
        sent = replace(frame, stamp_ns=frame.stamp_ns + number * 2_000_000_000)

        def send(sent=sent, changes=changes) -> None:
            camera.send_info(sent, sent.stamp_ns, **changes)
            camera.send_image(sent)

        def heard(stamp_ns=sent.stamp_ns) -> Any:
            return next((m for m in peer.heard["/status"] if decode_header(m).stamp_ns == stamp_ns), None)

        send()
        peer.wait(heard, f"status of {changes}", again=send)
        (entry,) = heard().status
        values = {value.key: value.value for value in entry.values}
        assert values["status"] in ("detected", "tracked"), (changes, entry.message)
        assert values["pose_status"] == ("uncalibrated" if says else "metric"), (changes, entry.message)
        assert says in entry.message
        told = [decode_header(m).stamp_ns for m in peer.heard["/pose"]]
        if says:
            assert sent.stamp_ns not in told
    node.wait_for_line(MESSAGES[-1][1])
    # Each kind once, however often it is sent; what differs in its numbers alone is one kind.
    for _, says in MESSAGES:
        if says not in ("", "need finite numbers", "need a window inside", "size 479 x 360 px"):
            assert node.text.count(says) == 1, (says, node.text)
    assert node.stop() < prompt_s
    assert "Traceback" not in node.text
    assert "rejected" not in node.text


class Heard:
    """Stands for the outputs of a stage: keeps the last result and what was offered."""

    def __init__(self) -> None:
        self.result: Any = None
        self.offered: dict[str, Any] = {}

    def publish(self, result: Any) -> None:
        self.result = result

    def offer(self, topic: str, make: Any) -> None:
        self.offered[topic] = make()


@pytest.mark.parametrize(("changes", "says"), MESSAGES)
def test_stages(world, changes, says):
    """The homography goes out of its stage in any case; the pose stage says why there is no pose."""
    frame, expected = world.frames[0], world.results[0].first
    header = Header(frame.stamp_ns, frame.frame_id)
    info = camera_info_message(make_message, header, frame.camera)
    for name, value in changes.items():
        setattr(info, name, value)
    matches = expected.matches
    count = len(matches.template_xy)
    none = np.full(count, -1, np.intp)
    seen = replace(
        expected,
        matches=ReferenceMatches(Matches(none, none, np.zeros(count)), matches.template_xy, matches.image_xy, none < 0),
    )
    parameters = parameters_from(
        {"matching.guided": False, "targets.images": [str(world.target)], "targets.widths_m": [0.5]}
    )
    images = [TargetImage("poster", _pixels(world), 0.5)]
    homography, pose = HomographyStage(), PoseStage()
    homography.use(parameters, images)
    pose.use(parameters, images)
    grey = world.results[0].developed.grey
    picture = image_message(make_message, header, grey, "mono16" if grey.dtype == np.uint16 else "mono8")
    first, second = Heard(), Heard()
    tentative = matches_message(make_message, header, [seen])
    homography.work(FrameMessages({"matches": tentative, "image_mono": picture}, info, 0.0), first)
    (found,) = first.result
    assert found.status is Status.DETECTED, found.reason
    calibrated = first.result.frame.camera is not None
    assert calibrated == (says == "")
    sent = homographies_message(make_message, header, first.result, calibrated=calibrated)
    assert decode_homographies(sent)["calibrated"].tolist() == [calibrated]
    pose.work(FrameMessages({"homography": sent, INLIERS: first.offered[INLIERS]}, info, 0.0), second)
    (found,) = second.result
    assert found.pose_status is (PoseStatus.UNCALIBRATED if says else PoseStatus.METRIC)
    if says:
        # The size of the image is known to the other stage alone.
        known = (says, "principal point", "camera_info is not that of the image")
        assert any(words in found.reason for words in known), found.reason
        assert pose.remarks == (f"uncalibrated: {found.reason}; homographies, no poses",)


def _pixels(world: Any) -> np.ndarray:
    from imgu_ros.image_files.images import read_image

    return read_image(world.target)
