# SPDX-License-Identifier: Apache-2.0
"""Whatever keeps poses from coming out is named, in the log and in /diagnostics, within three seconds."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")

from std_srvs.srv import SetBool

from imgu_ros.messages.camera_info import camera_info_message
from imgu_ros.messages.header import Header
from imgu_ros.messages.image import image_message
from imgu_ros.ros.messages import make_message
from imgu_ros.ros.qos import image_qos, latched_qos

pytestmark = pytest.mark.soak

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
INFO = "sensor_msgs/msg/CameraInfo"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"

#: On a machine that has time for it: what is promised. Else: what a busy one may take.
_NAMED_S = 3.0 if os.environ.get("IMGU_QUIET") else 40.0


class Ear:
    """Hears of a cause in both places."""

    def __init__(self, node: Any, peer: Any) -> None:
        self._node, self._peer = node, peer
        self.took_s: dict[str, float] = {}
        peer.hear("/diagnostics", DIAGNOSTICS)

    def hears(self, *parts: str, again: Callable[[], object] = lambda: None, logged: bool = True) -> None:
        """Wait until one message of /diagnostics and one line of the log have all parts."""
        said = self._peer.heard["/diagnostics"]
        said.clear()
        started, last = time.monotonic(), 0.0

        def told() -> bool:
            nonlocal last
            if time.monotonic() - last > 0.1:
                again()
                last = time.monotonic()
            in_log = not logged or any(all(p in line for p in parts) for line in self._node.lines)
            return in_log and any(
                all(p in s.message for p in parts) for m in said for s in m.status if s.name.startswith("/perception")
            )

        try:
            self._peer.wait(told, f"{parts}", _NAMED_S)
        except AssertionError as error:
            raise AssertionError(
                f"{error}; heard {[s.message for m in said for s in m.status]}; {self._node.text}"
            ) from None
        self.took_s[parts[0]] = time.monotonic() - started


def stamped(frame: Any) -> Any:
    """Return a frame as if it came just now."""
    return replace(frame, stamp_ns=time.time_ns())


def test_every_cause_is_named(imgu, world, peer, make_camera):
    node = imgu("node", "perception", *world.arguments, "-r", "image_raw:=/cam/image_raw")
    ear = Ear(node, peer)
    elsewhere = peer.publisher("/camera/image_raw", IMAGE, image_qos())
    node.wait_for_line("targets: poster")
    peer.wait(lambda: peer.heard["/diagnostics"], "diagnostics")
    assert "idle" not in node.text
    # The domain is said before anybody listens.
    assert f"(ROS domain {peer.context.get_domain_id()}" in node.text
    assert any(f"idle: no subscribers in ROS domain {peer.context.get_domain_id()}" in s.message
               for m in peer.heard["/diagnostics"] for s in m.status)  # fmt: skip
    late = peer.publisher("/late", IMAGE, image_qos())
    peer.hear("/pose", POSE)
    peer.wait(peer.has_publishers, "discovery")
    ear.hears("no publisher on /cam/image_raw", "/camera/image_raw", "remap with -r image_raw:=/camera/image_raw")
    peer.node.destroy_publisher(elsewhere)
    peer.node.destroy_publisher(late)

    wrong = peer.publisher("/cam/image_raw", COMPRESSED, image_qos())
    ear.hears(f"only {COMPRESSED} on /cam/image_raw; need {IMAGE}", "set image_transport to compressed")
    peer.node.destroy_publisher(wrong)

    camera = make_camera(peer)
    # A publisher that brings nothing: idle, or another user's, whose shared memory this process cannot use.
    ear.hears("no images on /cam/image_raw for", "although it has a publisher: does the camera run?", "as another user",
              "run both as the same user, or set FASTDDS_BUILTIN_TRANSPORTS=UDPv4 in both")  # fmt: skip
    # Only now somebody has subscribed to be served.
    frame = world.frames[0]
    ear.hears("uncalibrated: no camera_info on /cam/camera_info", "nothing comes", "no poses",
              again=lambda: camera.send_image(stamped(frame)))  # fmt: skip

    def zero_K() -> None:
        camera.send(stamped(frame), K_zero=True)

    ear.hears("uncalibrated: camera_info: K is all zero: the camera is not calibrated", again=zero_K)

    def unpaired() -> None:
        now = stamped(frame)
        camera.send_info(now, now.stamp_ns - 7_000_001)
        camera.send_image(now)

    ear.hears("stamps of /cam/camera_info and /cam/image_raw do not pair", "need equal stamps", again=unpaired)
    assert peer.heard["/pose"], "the nearest camera_info serves"

    ear.hears("frame rejected: encoding: 'bayer_rgbg8' is unknown", "bayer_rggb8",
              again=lambda: camera.send(stamped(frame), encoding="bayer_rgbg8"))  # fmt: skip

    nan = np.array(frame.camera.K, np.float64).ravel()
    nan[0] = np.nan

    def nan_K() -> None:
        now = stamped(frame)
        camera.send_info(now, now.stamp_ns, k=nan)
        camera.send_image(now)

    # Another reason for the same cause is news.
    ear.hears("uncalibrated: camera_info: K [nan", "need finite numbers", "homographies, no poses", again=nan_K)

    noise = np.random.default_rng(0).integers(0, 255, frame.image.pixels.shape, dtype=np.uint8)
    blank = replace(frame, image=replace(frame.image, pixels=noise))
    ear.hears("target not seen: poster: best so far", "inliers, need 8", again=lambda: camera.send(stamped(blank)))

    assert peer.call(SetBool, "/perception/pause", SetBool.Request(data=True)).success
    ear.hears("paused: call ~/pause with false")
    assert peer.call(SetBool, "/perception/pause", SetBool.Request(data=False)).success

    camera.close()
    if "IMGU_QUIET" in os.environ:
        print(ear.took_s)
    # Each cause once.
    uncalibrated = [
        f"uncalibrated: {why}" for why in ("no camera_info", "camera_info: K is all", "camera_info: K [nan")
    ]
    for part in ("no publisher on", *uncalibrated, "do not pair", "target not seen", "paused: "):
        assert node.text.count(part) == 1, node.text
    assert "Traceback" not in node.text


def test_oddities_beside_which_poses_come_out(imgu, world, peer):
    """Headers, a width in centimetres, camera_info that is sent once: each is said once, and poses come out."""
    node = imgu("node", "perception", "-p", f"targets.images:=[{world.target}]", "-p", "targets.widths_m:=[50.0]",
                "-r", "image_raw:=/cam/image_raw")  # fmt: skip
    ear = Ear(node, peer)
    images = peer.publisher("/cam/image_raw", IMAGE, image_qos())
    once = peer.publisher("/cam/camera_info", INFO, latched_qos())
    node.wait_for_line("targets: poster")
    peer.hear("/pose", POSE)
    frame = world.frames[0]
    once.publish(camera_info_message(make_message, Header(1, "eye"), frame.camera))

    def send(stamp_ns: int, frame_id: str) -> None:
        images.publish(image_message(make_message, Header(stamp_ns, frame_id), frame.image.pixels, "bayer_rggb8"))

    ear.hears("no camera_info on /cam/camera_info", "sent once and kept (transient_local)",
              "set qos_overrides./cam/camera_info.subscription.reliability to reliable",
              again=lambda: send(time.time_ns(), "eye"))  # fmt: skip
    peer.node.destroy_publisher(once)
    infos = peer.publisher("/cam/camera_info", INFO, image_qos())

    def both(stamp_ns: int, frame_id: str, info_frame: str) -> None:
        infos.publish(camera_info_message(make_message, Header(stamp_ns, info_frame), frame.camera))
        send(stamp_ns, frame_id)

    ear.hears("frame_id of /cam/camera_info: 'base', of /cam/image_raw: 'eye'; the images' goes out",
              again=lambda: both(time.time_ns(), "eye", "base"))  # fmt: skip
    ear.hears("targets.widths_m 50: poster would be 50 m wide", "did you mean 0.5 (50 cm)")
    ear.hears("frame_id of /cam/image_raw: '/eye'; tf2 refuses a leading slash: 'eye' goes out",
              again=lambda: both(time.time_ns(), "/eye", "/eye"))  # fmt: skip
    peer.heard["/pose"].clear()
    ear.hears("stamps of /cam/image_raw are 0 in", "have the driver stamp its images",
              again=lambda: both(0, "/eye", "/eye"))  # fmt: skip
    peer.wait(lambda: peer.heard["/pose"], "poses of images without stamps")
    assert {m.header.frame_id for m in peer.heard["/pose"]} == {"eye"}
    ear.hears("frame_id of /cam/image_raw is empty", "set frames.camera", again=lambda: both(time.time_ns(), "", ""))
    for part in ("widths_m 50", "'base'", "'/eye'", "are 0 in", "is empty", "sent once and kept"):
        assert node.text.count(part) == 1, node.text
    assert "Traceback" not in node.text


def test_quality_of_service_clock_and_lifecycle(imgu, world, peer, make_camera, tmp_path):
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState
    from rosgraph_msgs.msg import Clock

    file = tmp_path / "p.yaml"
    override = "{/cam/image_raw: {subscription: {reliability: reliable}}}"
    file.write_text(f"/**: {{ros__parameters: {{use_sim_time: true, qos_overrides: {override}}}}}\n")
    node = imgu("node", "perception", *world.arguments, "--params-file", str(file), "-r", "image_raw:=/cam/image_raw")
    ear = Ear(node, peer)
    node.wait_for_line("targets: poster")

    # A listener that nobody can serve.
    from imgu_ros.ros.messages import message_class

    latched = peer.node.create_subscription(message_class(POSE), "/pose", lambda _: None, latched_qos())
    # By name, once discovery has told it.
    ear.hears("of /pose cannot be served", "volatile durability, not transient_local",
              "set qos_overrides./pose.publisher.durability to transient_local")  # fmt: skip
    peer.node.destroy_subscription(latched)

    camera = make_camera(peer)
    peer.hear("/pose", POSE)
    ear.hears("only publishers with incompatible QoS on /cam/image_raw", "best_effort reliability, not reliable",
              "set qos_overrides./cam/image_raw.subscription.reliability to best_effort")  # fmt: skip
    ear.hears("clock stopped: use_sim_time is true and /clock has no publisher")
    clock = peer.node.create_publisher(Clock, "/clock", image_qos())
    message = Clock()
    message.clock.sec = 77
    ear.hears("clock stopped: /clock stands at 77.000 s", again=lambda: clock.publish(message), logged=False)

    request = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_DEACTIVATE))
    assert peer.call(ChangeState, "/perception/change_state", request).success
    ear.hears("lifecycle state: inactive; need active")
    camera.close()
    if "IMGU_QUIET" in os.environ:
        print(ear.took_s)
    assert "Traceback" not in node.text


def test_a_target_that_will_hardly_be_found_is_said(imgu, peer, tmp_path):
    rng = np.random.default_rng(2)
    half = np.kron(rng.integers(0, 256, (9, 18), np.uint8), np.ones((16, 16), np.uint8))
    cv2.imwrite(str(tmp_path / "card.png"), np.vstack((half, half[::-1, ::-1])))
    node = imgu("node", "perception", "-p", f"targets.images:={tmp_path / 'card.png'}")
    ear = Ear(node, peer)
    node.wait_for_line("targets: card")
    ear.hears("target card: looks the same turned by 180 degrees", "imgu check")
    assert node.text.count("target card: looks the same") == 1
    assert "Traceback" not in node.text


def test_images_that_get_lost_on_the_way(imgu, world, peer, make_camera):
    """Six megabytes at once through the default shared memory of half a megabyte."""
    if os.environ.get("FASTRTPS_DEFAULT_PROFILES_FILE") or os.environ.get("FASTDDS_DEFAULT_PROFILES_FILE"):
        pytest.skip("a DDS profile is on: nothing gets lost")
    node = imgu("node", "perception", *world.arguments, "-r", "image_raw:=/cam/image_raw")
    ear = Ear(node, peer)
    node.wait_for_line("targets: poster")
    publisher = peer.publisher("/cam/image_raw", IMAGE, image_qos())
    large = image_message(make_message, Header(1, "cam"), np.zeros((1080, 1920, 3), np.uint8), "rgb8")
    peer.hear("/pose", POSE)
    peer.wait(publisher.get_subscription_count, "the node's subscription")
    ear.hears("got lost on the way", "in every process, the camera's too, set FASTRTPS_DEFAULT_PROFILES_FILE=",
              again=lambda: publisher.publish(large))  # fmt: skip
    if "IMGU_QUIET" in os.environ:
        print(ear.took_s)
