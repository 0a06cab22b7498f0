# SPDX-License-Identifier: Apache-2.0
"""The pipeline as six processes: what it tells is what the pipeline in one process tells."""

from __future__ import annotations

import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

pytest.importorskip("rclpy", reason="needs the ros extra")

import cv2
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from std_srvs.srv import SetBool, Trigger

from imgu_ros.config.values import parameters_from
from imgu_ros.frame import Frame
from imgu_ros.localizer import Localizer
from imgu_ros.messages.camera_info import camera_info_message
from imgu_ros.messages.features import decode_estimates
from imgu_ros.messages.geometry import odometry_message, pose_message
from imgu_ros.messages.header import Header, decode_header
from imgu_ros.messages.image import image_message
from imgu_ros.messages.results import result_header
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.result import Result, Status
from imgu_ros.ros.messages import make_message
from imgu_ros.ros.qos import image_qos
from imgu_ros.simulate.sequence import Simulation, default_targets, simulate_sequence

IMAGE = "sensor_msgs/msg/Image"
INFO = "sensor_msgs/msg/CameraInfo"
CLOUD = "sensor_msgs/msg/PointCloud2"
POLYGON = "geometry_msgs/msg/PolygonStamped"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
ODOMETRY = "nav_msgs/msg/Odometry"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
CONFIGURE, ACTIVATE = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE
DEACTIVATE, CLEANUP = Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP

STAGES = ("demosaic", "pyramid", "features", "matcher", "homography", "pose")
OFF = {"tracking.enabled": False, "refinement.enabled": False, "search.thorough": False}
FRAMES = 100
SIZE = 360, 270


@dataclass(frozen=True)
class World:
    """Frames, their target on disk, and what the pipeline makes of them in one process."""

    target: Path
    frames: tuple[Frame, ...]
    results: tuple[Result, ...]

    @property
    def arguments(self) -> list[str]:
        given = [f"targets.images:=[{self.target}]", "targets.widths_m:=[0.3]"]
        given += [f"{name}:={str(value).lower()}" for name, value in OFF.items()]
        return [part for value in given for part in ("-p", value)]


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> World:
    folder = tmp_path_factory.mktemp("world")
    image = default_targets(1, seed=5, width_m=0.3)[0]
    path = folder / "poster.png"
    cv2.imwrite(str(path), image.pixels[:, :, ::-1])
    parameters = parameters_from({**OFF, "targets.images": [str(path)], "targets.widths_m": [0.3]})
    chain = Localizer(parameters, prepare_references([TargetImage("poster", image.pixels, 0.3)], parameters))
    simulation = Simulation(width=SIZE[0], height=SIZE[1], frames=FRAMES, seed=5)
    frames = tuple(simulated.frame for simulated in simulate_sequence(simulation, [image]))
    results = tuple(chain.process(frame) for frame in frames)
    seen = [target.status for result in results for target in result]
    assert seen.count(Status.DETECTED) > FRAMES // 2, "the comparison needs something to compare"
    return World(path, frames, results)


class Camera:
    """Publishes frames as a driver does."""

    def __init__(self, peer: Any) -> None:
        self._peer = peer
        self._image = peer.publisher("/cam/image_raw", IMAGE, image_qos())
        self._info = peer.publisher("/cam/camera_info", INFO, image_qos())

    @property
    def is_heard(self) -> bool:
        return bool(self._image.get_subscription_count())

    def send(self, frame: Frame, encoding: str = "bayer_rggb8") -> None:
        header = Header(frame.stamp_ns, frame.frame_id)
        image = image_message(make_message, header, frame.image.pixels, "bayer_rggb8")
        image.encoding = encoding
        assert frame.camera is not None
        self._info.publish(camera_info_message(make_message, header, frame.camera))
        self._image.publish(image)


def entries(message: Any) -> dict[str, str]:
    return {status.name: status.message.partition(":")[0] for status in message.status}


def by_stamp(messages: list[Any]) -> dict[int, Any]:
    return {decode_header(message).stamp_ns: message for message in messages}


@pytest.fixture
def stages(imgu, world, prompt_s):
    """The six nodes in the camera's namespace; at the end each ends promptly and in order."""
    started = {name: imgu("node", name, *world.arguments, "-r", "__ns:=/cam") for name in STAGES}
    for name, command in started.items():
        command.wait_for_line(f"{name}: subscribes to /cam/")
    yield started
    for command in started.values():
        if command.process.poll() is None:
            assert command.stop(signal.SIGTERM) < prompt_s
            assert command.process.returncode == 0, command.text
        assert "Traceback" not in command.text


def test_six_processes_tell_what_one_tells(stages, world, peer):
    camera = Camera(peer)
    peer.spin(1.0)
    assert not camera.is_heard, "nobody listens to the last stage: the first takes nothing"
    for topic, kind in {
        "status": DIAGNOSTICS,
        "homography": CLOUD,
        "outline": POLYGON,
        "pose": POSE,
        "targets/poster/odom": ODOMETRY,
        "pose/status": DIAGNOSTICS,
    }.items():
        peer.hear(f"/cam/{topic}", kind)
    # The pipeline is subscribed from its end: each stage as soon as the next one listens.
    peer.wait(lambda: camera.is_heard, "the first stage")
    peer.spin(0.5)
    heard = peer.heard
    for result in world.results:
        camera.send(result.frame)
        topics = ["status", "homography", "pose/status"]
        if result.first.homography is not None:
            topics.append("outline")
        if result.first.pose is not None:
            topics += ["pose", "targets/poster/odom"]
        peer.wait(
            lambda ns=result.frame.stamp_ns, topics=tuple(topics): all(
                ns in by_stamp(heard[f"/cam/{topic}"][-3:]) for topic in topics
            ),
            f"frame at {result.frame.stamp_ns}",
            again=lambda frame=result.frame: camera.send(frame),
        )
    told = {topic: by_stamp(messages) for topic, messages in heard.items()}
    largest = 0.0
    for result in world.results:
        stamp_ns, expected = result.frame.stamp_ns, result.first
        assert entries(told["/cam/status"][stamp_ns]) == {"poster": expected.status.value}
        found = decode_estimates(told["/cam/homography"][stamp_ns], {0: 1})
        if expected.homography is None:
            assert not found
            continue
        largest = max(largest, np.abs(corners(found[0].H) - corners(expected.homography.H)).max())
        outline = [(p.x, p.y) for p in told["/cam/outline"][stamp_ns].polygon.points]
        assert_allclose(outline, expected.outline, atol=1e-3)
        # The poses are the same numbers, covariance and all.
        if expected.pose is not None:
            assert told["/cam/pose"][stamp_ns] == pose_message(make_message, result_header(result), expected.pose)
            odometry = odometry_message(make_message, result_header(result), "poster", expected.pose)
            assert told["/cam/targets/poster/odom"][stamp_ns] == odometry
    assert largest < 1e-9, "px; the acceptance is 0.01"
    for topic in list(heard):
        peer.unhear(topic)
    peer.wait(lambda: not camera.is_heard, "the end of the subscriptions, when nobody listens any more")


def corners(H: np.ndarray) -> np.ndarray:
    x = np.array([[0, 0, 1], [1000, 0, 1], [1000, 700, 1], [0, 700, 1.0]]) @ H.T
    return x[:, :2] / x[:, 2:]


def test_a_stage_says_what_it_lacks_and_obeys_its_services(imgu, world, peer, prompt_s):
    foreign = "qos_overrides./image_color.publisher.depth"
    other = "qos_overrides./debug_image.publisher.depth"
    node = imgu("node", "matcher", *world.arguments, "-p", f"{foreign}:=3", "-p", f"{other}:=3")
    node.wait_for_line("matcher: subscribes to /keypoints")
    node.wait_for_line(f"{foreign}: unknown parameter")
    node.wait_for_line(f"{other}: unknown parameter")
    node.wait_for_line("an override for another node?")
    peer.hear("/diagnostics", DIAGNOSTICS)
    peer.hear("/matches", CLOUD)

    def says(words: str) -> bool:
        said = [status.message for message in peer.heard["/diagnostics"] for status in message.status]
        peer.heard["/diagnostics"].clear()
        return any(words in line for line in said)

    peer.wait(lambda: says("no publisher on /keypoints"), "the missing topic")
    answer = peer.call(SetBool, "/matcher/pause", SetBool.Request(data=True))
    assert answer.success
    peer.wait(lambda: says("paused"), "the pause")
    assert peer.call(SetBool, "/matcher/pause", SetBool.Request(data=False)).success
    assert peer.call(Trigger, "/matcher/reset", Trigger.Request()).success
    answer = peer.call(Trigger, "/matcher/reload", Trigger.Request())
    assert answer.success
    assert answer.message == "targets: poster"
    # A cloud that is none of keypoints is refused, and the node lives.
    clouds = peer.publisher("/keypoints", CLOUD)
    wrong = make_message(CLOUD)
    peer.wait(lambda: says("rejected: point cloud"), "the reason", again=lambda: clouds.publish(wrong))
    for round_trip in range(3):
        for transition in (DEACTIVATE, CLEANUP, CONFIGURE, ACTIVATE):
            request = ChangeState.Request(transition=Transition(id=transition))
            assert peer.call(ChangeState, "/matcher/change_state", request).success, (round_trip, transition)
    peer.wait(lambda: says("rejected: point cloud"), "the reason, again", again=lambda: clouds.publish(wrong))
    assert node.stop() < prompt_s
    assert node.process.returncode == 0, node.text
