# SPDX-License-Identifier: Apache-2.0
"""The node, live: what it publishes is what the pipeline computes, and nothing stops it but a signal."""

from __future__ import annotations

import signal
import sys
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")

from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool, Trigger

from imgu_ros.cli.main import main
from imgu_ros.messages.features import decode_homographies
from imgu_ros.messages.geometry import odometry_message, pose_message
from imgu_ros.messages.header import Header, decode_header
from imgu_ros.messages.image import decode_image
from imgu_ros.messages.results import result_header
from imgu_ros.ros.messages import make_message, message_class

IMAGE = "sensor_msgs/msg/Image"
INFO = "sensor_msgs/msg/CameraInfo"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
ODOMETRY = "nav_msgs/msg/Odometry"
CLOUD = "sensor_msgs/msg/PointCloud2"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"


def values(message: Any, suffix: str) -> dict[str, str]:
    entry = next(s for s in message.status if s.name.endswith(suffix))
    return {v.key: v.value for v in entry.values} | {"message": entry.message}


@pytest.fixture
def node(imgu, world, prompt_s):
    started = imgu("node", "perception", *world.arguments, "-r", "image_raw:=/cam/image_raw")
    started.wait_for_line("targets: poster")
    yield started
    if started.process.poll() is None:
        took = started.stop()
        assert started.process.returncode == 0, started.text
        assert took < prompt_s
    assert "Traceback" not in started.text


def test_live_equals_offline_bit_for_bit(node, world, peer, make_camera):
    peer.hear("/pose", POSE)
    peer.hear("/targets/poster/odom", ODOMETRY)
    peer.hear("/homography", CLOUD)
    camera = make_camera(peer)
    camera.wait_for_node()
    for count, frame in enumerate(world.frames, 1):
        camera.send(frame)
        peer.wait(lambda n=count: len(peer.heard["/homography"]) == n, f"result {count}")
    peer.wait(lambda: len(peer.heard["/targets/poster/odom"]) == len(world.frames), "odometry")
    for index, result in enumerate(world.results):
        expected = pose_message(make_message, result_header(result), result.first.pose)
        assert peer.heard["/pose"][index] == expected
        assert peer.heard["/pose"][index].header == expected.header
        odometry = odometry_message(make_message, result_header(result), "poster", result.first.pose)
        assert peer.heard["/targets/poster/odom"][index] == odometry
        row = decode_homographies(peer.heard["/homography"][index])[0]
        assert np.array_equal(row["h"].reshape(3, 3), result.first.homography.H)


def test_every_output_carries_the_header_and_none_is_made_for_nobody(node, world, peer, make_camera):
    camera = make_camera(peer)
    peer.hear("/diagnostics", DIAGNOSTICS)
    peer.wait(lambda: peer.heard["/diagnostics"], "diagnostics")
    assert "idle: no subscribers" in values(peer.heard["/diagnostics"][-1], "output")["message"]
    assert not camera.is_subscribed
    outputs = {
        "/image_color": IMAGE, "/image_mono": IMAGE, "/pyramid/level_0": IMAGE, "/debug_image": IMAGE,
        "/debug_image/compressed": "sensor_msgs/msg/CompressedImage", "/keypoints": CLOUD, "/matches": CLOUD,
        "/outline": "geometry_msgs/msg/PolygonStamped", "/targets/poster/pose": POSE, "/status": DIAGNOSTICS,
    }  # fmt: skip
    for topic, type_name in outputs.items():
        peer.hear(topic, type_name)
    peer.hear("/path", "nav_msgs/msg/Path")
    camera.wait_for_node()
    frame = world.frames[0]
    camera.send(frame)
    peer.wait(
        lambda: all(peer.heard[topic] for topic in [*outputs, "/path"]), "all outputs", again=lambda: camera.send(frame)
    )
    for topic in outputs:
        assert decode_header(peer.heard[topic][0]) == Header(frame.stamp_ns, frame.frame_id), topic
    assert np.array_equal(decode_image(peer.heard["/image_color"][0]).pixels, world.results[0].developed.color())
    assert values(peer.heard["/status"][0], "poster")["status"] in ("detected", "tracked")
    for topic in [*outputs, "/path"]:
        peer.unhear(topic)
    peer.wait(lambda: not camera.is_subscribed, "the end of the subscription")


def test_bad_frames_are_said_and_do_not_stop_the_node(node, world, peer, make_camera):
    peer.hear("/status", DIAGNOSTICS)
    peer.hear("/diagnostics", DIAGNOSTICS)
    camera = make_camera(peer)
    camera.wait_for_node()
    first, second, third, last = world.frames
    for frame, changes in (
        (first, {"encoding": "bayer_rgbg8"}),
        (second, {"width": 100_000}),
        (third, {"height": 0}),
    ):
        count = len(peer.heard["/status"])
        camera.send(frame, **changes)
        peer.wait(
            lambda n=count: len(peer.heard["/status"]) > n, f"status of a frame with {changes}",
            again=lambda f=frame, c=changes: camera.send(f, **c),
        )  # fmt: skip
        assert values(peer.heard["/status"][-1], "poster")["status"] == "rejected"
    camera.send(last, K_zero=True)
    peer.wait(lambda: values(peer.heard["/status"][-1], "poster")["status"] != "rejected", "a good frame")
    assert values(peer.heard["/status"][-1], "poster")["status"] == "detected"
    assert values(peer.heard["/status"][-1], "poster")["pose_status"] == "uncalibrated"
    # Diagnostics come once a second: on a fast machine none may have come yet.
    peer.wait(
        lambda: peer.heard["/diagnostics"] and values(peer.heard["/diagnostics"][-1], "input")["rejected"] == "3",
        "diagnostics",
    )
    assert values(peer.heard["/diagnostics"][-1], "input")["unknown_encodings"] == "1"
    assert "bayer_rgbg8" in node.text
    node.wait_for_line("uncalibrated: camera_info: K is all zero: the camera is not calibrated")
    count = len(peer.heard["/status"])
    camera.send(replace(last, stamp_ns=last.stamp_ns + 1), K_zero=True)
    peer.wait(lambda: len(peer.heard["/status"]) > count, "another frame")
    peer.spin(0.2)
    assert node.text.count("uncalibrated") == 1
    # A row length that the data contradict is said once, and costs nothing.
    for later in (2, 3):
        count = len(peer.heard["/status"])
        camera.send(replace(last, stamp_ns=last.stamp_ns + later), step=7)
        peer.wait(lambda n=count: len(peer.heard["/status"]) > n, "a frame with a wrong step")
        assert values(peer.heard["/status"][-1], "poster")["status"] in ("detected", "tracked")
    node.wait_for_line("/cam/image_raw: step: 7 bytes; read as ")
    peer.spin(0.2)
    assert node.text.count("step: 7 bytes") == 1


def test_services_and_parameters(node, world, peer, make_camera):
    peer.hear("/homography", CLOUD)
    camera = make_camera(peer)
    refused = peer.call(Trigger, "/perception/set_target_from_view", Trigger.Request())
    assert not refused.success
    assert "no frame yet" in refused.message
    camera.wait_for_node()
    camera.send(world.frames[0])
    peer.wait(lambda: peer.heard["/homography"], "a result", again=lambda: camera.send(world.frames[0]))

    reload_ = peer.call(Trigger, "/perception/reload", Trigger.Request())
    assert reload_.success, reload_.message
    assert "poster" in reload_.message
    assert peer.call(Trigger, "/perception/reset", Trigger.Request()).success

    request = SetParameters.Request()
    request.parameters = [
        Parameter("homography.threshold_px", value=1e9).to_parameter_msg(),
        Parameter("homography.treshold_px", value=2.0).to_parameter_msg(),
        Parameter("homography.threshold_px", value=2).to_parameter_msg(),
        Parameter("publish_tf", value=True).to_parameter_msg(),
    ]
    results = peer.call(SetParameters, "/perception/set_parameters", request).results
    assert [r.successful for r in results] == [False, False, True, False]
    assert "need 0.1 to 100 px" in results[0].reason
    assert "nearest known: homography.threshold_px" in results[1].reason
    both = SetParametersAtomically.Request()
    both.parameters = [
        Parameter("keypoints.max_count", value=400).to_parameter_msg(),
        Parameter("seed", value=-1).to_parameter_msg(),
    ]
    assert not peer.call(SetParametersAtomically, "/perception/set_parameters_atomically", both).result.successful
    both.parameters = both.parameters[:1]
    assert peer.call(SetParametersAtomically, "/perception/set_parameters_atomically", both).result.successful

    # The pipeline is rebuilt beside the one that works: results soon have the new number of keypoints.
    peer.hear("/keypoints", CLOUD)
    peer.spin(0.5)
    camera.send(world.frames[1])
    peer.wait(
        lambda: peer.heard["/keypoints"] and 0 < peer.heard["/keypoints"][-1].width <= 400, "fewer keypoints",
        again=lambda: camera.send(world.frames[1]),
    )  # fmt: skip

    images = SetParameters.Request()
    images.parameters = [Parameter("targets.images", value=["/nowhere/x.png"]).to_parameter_msg()]
    assert peer.call(SetParameters, "/perception/set_parameters", images).results[0].successful
    refused = peer.call(Trigger, "/perception/reload", Trigger.Request())
    assert not refused.success
    assert "/nowhere/x.png" in refused.message

    view = peer.call(Trigger, "/perception/set_target_from_view", Trigger.Request())
    assert view.success, view.message
    peer.hear("/targets/view/outline", "geometry_msgs/msg/PolygonStamped")
    peer.spin(0.5)
    # The view itself once more: the next one of this short sequence is far away.
    same = replace(world.frames[1], stamp_ns=world.frames[1].stamp_ns + 1)
    camera.send(same)
    peer.wait(lambda: peer.heard["/targets/view/outline"], "the view as a target", again=lambda: camera.send(same))

    assert peer.call(SetBool, "/perception/pause", SetBool.Request(data=True)).success
    peer.wait(lambda: not camera.is_subscribed, "pause")
    assert peer.call(SetBool, "/perception/pause", SetBool.Request(data=False)).success
    peer.wait(lambda: camera.is_subscribed, "the end of the pause")


def test_lifecycle_by_hand_and_a_namespace(imgu, world, peer, prompt_s, make_camera):
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState

    node = imgu(
        "node", "perception", *world.arguments, "-p", "autostart:=false",
        "--ros-args", "-r", "__ns:=/robot", "-r", "__node:=eyes", "-r", "image_raw:=cam/image_raw",
    )  # fmt: skip

    def change(transition: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(peer.call(ChangeState, "/robot/eyes/change_state", request).success)

    assert change(Transition.TRANSITION_CONFIGURE)
    assert change(Transition.TRANSITION_ACTIVATE)
    peer.hear("/robot/targets/poster/pose", POSE)
    camera = make_camera(peer, "/robot/cam")
    camera.wait_for_node()
    camera.send(world.frames[0])
    peer.wait(lambda: peer.heard["/robot/targets/poster/pose"], "a pose", again=lambda: camera.send(world.frames[0]))
    assert change(Transition.TRANSITION_DEACTIVATE)
    peer.wait(lambda: not camera.is_subscribed, "deactivation")
    assert change(Transition.TRANSITION_CLEANUP)
    assert change(Transition.TRANSITION_CONFIGURE)
    assert change(Transition.TRANSITION_ACTIVATE)
    peer.wait(lambda: camera.is_subscribed, "activation")
    assert node.stop(signal.SIGTERM) < prompt_s
    assert node.process.returncode == 0
    assert "Traceback" not in node.text


def test_a_signal_ends_a_busy_node(imgu, world, peer, prompt_s, make_camera):
    node = imgu("node", "perception", *world.arguments, "-r", "image_raw:=/cam/image_raw")
    node.wait_for_line("targets: poster")
    peer.hear("/debug_image", IMAGE)
    camera = make_camera(peer)
    camera.wait_for_node()
    end = time.monotonic() + 1.0
    while time.monotonic() < end or not peer.heard["/debug_image"]:
        camera.send(world.frames[0])
        peer.spin(0.01)
        assert time.monotonic() < end + 40
    assert node.stop(signal.SIGINT) < prompt_s
    assert node.process.returncode == 0, node.text
    assert "Traceback" not in node.text


@pytest.mark.parametrize("delay_s", [0.0, 0.4, 0.8])
def test_a_signal_ends_a_node_that_starts(imgu, world, delay_s, prompt_s):
    node = imgu("node", "perception", *world.arguments)
    node.wait_for_handler(signal.SIGTERM)
    time.sleep(delay_s)
    assert node.stop(signal.SIGTERM) < prompt_s
    assert node.process.returncode == 0, node.text
    assert "Traceback" not in node.text


def refusal(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Run the command in this process, which it is to leave at once; return its one line."""
    assert main(["node", "perception", *arguments]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    return error


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["-p", "homography.treshold_px:=2.0"], "unknown parameter; nearest known: homography.threshold_px"),
        (["-p", "seed:=x"], "seed: 'x' (str); need an integer"),
        (["-p", "targets.images:=[/nowhere/x.png]"], "/nowhere/x.png"),
        (["-p", "targets.poses:=[1.0]"], "targets.poses: 1 values"),
    ],
)
def test_what_cannot_start_says_why_in_one_line(capsys, ros_domain, arguments, said):
    assert said in refusal(capsys, *arguments)


def test_a_qos_override_of_no_topic_is_named(imgu, world, tmp_path):
    file = tmp_path / "p.yaml"
    file.write_text("/**: {ros__parameters: {qos_overrides: {/image_rw: {subscription: {depth: 2}}}}}\n")
    node = imgu("node", "perception", *world.arguments, "--params-file", str(file))
    node.wait_for_line("targets: poster")
    assert (
        "qos_overrides./image_rw.subscription.depth: unknown parameter; nearest known: qos_overrides./image_raw."
        in (node.text)
    )


def test_publish_tf_without_tf_messages_is_refused(capsys, ros_domain, monkeypatch):
    message_class.cache_clear()
    for name in ("tf2_msgs", "tf2_msgs.msg"):
        monkeypatch.setitem(sys.modules, name, None)
    line = refusal(capsys, "-p", "publish_tf:=true")
    assert "tf2_msgs" in line
    assert "apt install" in line
