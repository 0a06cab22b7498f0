# SPDX-License-Identifier: Apache-2.0
"""The live nodes with `camera.info_file` and `raw.encoding`: no camera_info is waited for, and both may change."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")

from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from imgu_ros.cli.main import main
from imgu_ros.files.camera_info_file import camera_info_text
from imgu_ros.messages.camera_info import camera_info_message
from imgu_ros.messages.geometry import pose_message
from imgu_ros.messages.header import Header
from imgu_ros.messages.results import result_header
from imgu_ros.ros.messages import make_message
from imgu_ros.vision.camera.intrinsics import make_camera as camera_of

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
CLOUD = "sensor_msgs/msg/PointCloud2"
STATUS = "diagnostic_msgs/msg/DiagnosticArray"


@pytest.fixture
def camera_file(world: Any, tmp_path: Path) -> Path:
    path = tmp_path / "camera.yaml"
    path.write_text(camera_info_text(world.frames[0].camera))
    return path


def values(message: Any, suffix: str) -> dict[str, str]:
    entry = next(s for s in message.status if s.name.endswith(suffix))
    return {v.key: v.value for v in entry.values} | {"message": entry.message}


def ask(peer: Any, name: str, **given: object) -> Any:
    request = SetParametersAtomically.Request()
    request.parameters = [
        Parameter(key.replace("__", "."), value=value).to_parameter_msg() for key, value in given.items()
    ]
    return peer.call(SetParametersAtomically, f"{name}/set_parameters_atomically", request).result


class Sender:
    """A driver without calibration: images alone, of a mosaic that it calls grey."""

    def __init__(self, peer: Any, make_camera: Any) -> None:
        self.camera = make_camera(peer)
        self._peer = peer

    def wait_for_node(self) -> None:
        self._peer.wait(lambda: self.camera.is_subscribed, "the node's subscription")
        self._peer.wait(self._peer.has_publishers, "the node's outputs")
        self._peer.spin(0.5)

    def send(self, frame: Any, encoding: str = "mono8") -> None:
        self.camera.send_image(frame, encoding=encoding)


def test_a_camera_from_a_file_and_a_mosaic_called_grey(imgu, world, peer, make_camera, camera_file):
    """What comes out is what comes out with the right camera_info and encoding, bit for bit, and is not held back."""
    node = imgu(
        "node", "perception", *world.arguments, "-r", "image_raw:=/cam/image_raw",
        "-p", f"camera.info_file:={camera_file}", "-p", "raw.encoding:=bayer_rggb8",
    )  # fmt: skip
    peer.hear("/pose", POSE)
    peer.hear("/diagnostics", STATUS)
    sender = Sender(peer, make_camera)
    sender.wait_for_node()
    delays = []
    for count, frame in enumerate(world.frames, 1):
        begun = time.monotonic()
        sender.send(frame)
        peer.wait(lambda n=count: len(peer.heard["/pose"]) == n, f"pose {count}")
        delays.append(time.monotonic() - begun)
    expected = [pose_message(make_message, result_header(result), result.first.pose) for result in world.results]
    assert peer.heard["/pose"] == expected
    # An image that waits for a camera_info waits 0.3 s at least.
    assert min(delays) < 0.25
    peer.spin(3.0)  # long enough for the causes that the log tells
    assert "camera_info" not in node.text
    last = peer.heard["/diagnostics"][-1]
    assert values(last, "camera")["message"] == "calibrated"
    assert values(last, "camera")["info_file"] == str(camera_file)
    assert values(last, "input")["camera_info_topic"] == ""
    assert float(values(last, "camera")["fx"]) == world.frames[0].camera.K[0, 0]
    assert not peer.node.count_subscribers("/cam/camera_info")


def test_a_change_takes_effect_with_the_next_frame_and_keeps_tracks(
    imgu, world, peer, make_camera, camera_file, tmp_path
):
    node = imgu("node", "perception", *world.arguments, "-r", "image_raw:=/cam/image_raw")
    node.wait_for_line("targets: poster")
    for topic, type_name in (("/pose", POSE), ("/status", STATUS), ("/homography", CLOUD)):
        peer.hear(topic, type_name)
    sender = Sender(peer, make_camera)
    sender.wait_for_node()
    frames = iter(replace(world.frames[0], stamp_ns=world.frames[0].stamp_ns + k * 10_000_000) for k in range(1000))

    def next_status() -> dict[str, str]:
        count = len(peer.heard["/status"])
        sender.send(next(frames), "bayer_rggb8")
        peer.wait(lambda: len(peer.heard["/status"]) > count, "status")
        return values(peer.heard["/status"][-1], "poster")

    assert next_status()["pose_status"] == "uncalibrated"
    assert not peer.heard["/pose"]
    # What cannot be used is refused, and nothing changes.
    missing = ask(peer, "/perception", camera__info_file=str(tmp_path / "none.yaml"))
    assert not missing.successful
    assert "none.yaml" in missing.reason
    broken = tmp_path / "broken.yaml"
    broken.write_text("camera_matrix: nothing\n")
    assert "broken.yaml" in ask(peer, "/perception", camera__info_file=str(broken)).reason
    unknown = ask(peer, "/perception", raw__encoding="bayer_rgbg8")
    assert not unknown.successful
    assert "bayer_rggb8" in unknown.reason
    assert next_status()["pose_status"] == "uncalibrated"
    # The file takes effect with the next frame, and the track goes on.
    assert ask(peer, "/perception", camera__info_file=str(camera_file)).successful
    status = next_status()
    assert (status["status"], status["pose_status"]) == ("tracked", "metric")
    assert ask(peer, "/perception", raw__encoding="mono16").successful
    assert "2 bytes a pixel" in str(next_status())
    assert ask(peer, "/perception", raw__encoding="").successful
    assert next_status()["pose_status"] == "metric"
    # A file that is written anew counts after ~/reload; one that is broken by then is refused, and the old one stays.
    peer.spin(0.3)
    distance = abs(peer.heard["/pose"][-1].pose.pose.position.z)
    truth = world.frames[0].camera
    other = camera_of(truth.K * [[1.002], [1.002], [1]], (), "plumb_bob", truth.width, truth.height)
    camera_file.write_text(camera_info_text(other))
    assert peer.call(Trigger, "/perception/reload", Trigger.Request()).success
    count = len(peer.heard["/pose"])
    assert next_status()["pose_status"] == "metric"
    peer.wait(lambda: len(peer.heard["/pose"]) > count, "the pose")
    assert abs(peer.heard["/pose"][-1].pose.pose.position.z) == pytest.approx(1.002 * distance, rel=5e-4)
    camera_file.write_text("nothing")
    assert not peer.call(Trigger, "/perception/reload", Trigger.Request()).success
    assert next_status()["pose_status"] == "metric"
    # Without the file camera_info counts again.
    assert ask(peer, "/perception", camera__info_file="").successful
    peer.wait(lambda: peer.node.count_subscribers("/cam/camera_info"), "the subscription of camera_info")
    assert next_status()["pose_status"] == "uncalibrated"
    assert node.process.poll() is None
    assert "Traceback" not in node.text


def test_a_camera_of_another_resolution_is_said_with_both_sizes(imgu, world, peer, make_camera, tmp_path):
    path = tmp_path / "full.yaml"
    path.write_text(camera_info_text(camera_of(np.diag([800.0, 800, 1]) + [[0, 0, 480], [0, 0, 360], [0, 0, 0]], (),
                                               "plumb_bob", 960, 720)))  # fmt: skip
    node = imgu(
        "node", "perception", *world.arguments, "-r", "image_raw:=/cam/image_raw", "-p", f"camera.info_file:={path}"
    )
    peer.hear("/status", STATUS)
    sender = Sender(peer, make_camera)
    sender.wait_for_node()
    peer.wait(lambda: peer.heard["/status"], "status", again=lambda: sender.send(world.frames[0], "bayer_rggb8"))
    status = values(peer.heard["/status"][-1], "poster")
    assert status["pose_status"] == "uncalibrated"
    assert "size 960 x 720 px, image 480 x 360 px" in str(status)
    stamps = iter(range(1, 1000))
    peer.wait(
        lambda: "960 x 720" in node.text, "the log",
        again=lambda: sender.send(replace(world.frames[0], stamp_ns=next(stamps) * 10**9), "bayer_rggb8"),
    )  # fmt: skip
    assert "on /cam/camera_info" not in node.text


@pytest.mark.parametrize("name", ["perception", "homography", "pose", "demosaic"])
def test_a_file_that_cannot_be_read_stops_the_start_in_one_line(capsys, ros_domain, tmp_path, name):
    path = tmp_path / "none.yaml"
    assert main(["node", name, "-p", f"camera.info_file:={path}"]) == 1
    error = [line for line in capsys.readouterr().err.splitlines() if "none.yaml" in line]
    assert len(error) == 1
    assert error[0].startswith("imgu: error: camera.info_file: ")


def test_stages_with_a_camera_from_a_file(imgu, world, peer, make_camera, camera_file):
    """Six nodes, a driver that knows no camera and calls its mosaic grey: metric poses all the same."""
    common = (*world.arguments, "-p", f"camera.info_file:={camera_file}", "-p", "raw.encoding:=bayer_rggb8")
    started = [
        imgu("node", name, *common, "-r", "__ns:=/cam")
        for name in ("demosaic", "pyramid", "features", "matcher", "homography", "pose")
    ]
    peer.hear("/cam/pose", POSE)
    peer.hear("/cam/reduced/camera_info", "sensor_msgs/msg/CameraInfo")
    sender = Sender(peer, make_camera)
    sender.wait_for_node()
    stamps = iter(range(1, 1000))
    peer.wait(
        lambda: peer.heard["/cam/pose"], "a pose",
        again=lambda: sender.send(replace(world.frames[0], stamp_ns=next(stamps) * 10**9)),
    )  # fmt: skip
    truth = world.results[0].first.pose
    position = peer.heard["/cam/pose"][-1].pose.pose.position
    assert np.linalg.norm(np.array([position.x, position.y, position.z]) - truth.t) < 0.01
    frame = world.frames[0]
    expected = camera_info_message(make_message, Header(0, frame.frame_id), frame.camera)
    assert list(peer.heard["/cam/reduced/camera_info"][-1].k) == list(expected.k)
    assert not peer.node.count_subscribers("/cam/camera_info")
    answer = peer.call(Trigger, "/cam/demosaic/reload", Trigger.Request())
    assert (answer.success, answer.message) == (True, f"camera.info_file: {camera_file}")
    camera_file.write_text("nothing")
    answer = peer.call(Trigger, "/cam/demosaic/reload", Trigger.Request())
    assert not answer.success
    assert answer.message.startswith(f"camera.info_file: {camera_file}: ")
    assert all("Traceback" not in node.text for node in started)
