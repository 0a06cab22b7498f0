# SPDX-License-Identifier: Apache-2.0
"""Two cameras on one topic, a process that is stopped, a frame that takes long, a full /dev/shm, bursts of calls."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")

from rclpy.node import Node
from std_srvs.srv import Trigger

from imgu_ros.messages.header import decode_header
from imgu_ros.ros.qos import image_qos

pytestmark = pytest.mark.soak

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
RATE_HZ = 30


def told(peer: Any, topic: str, *parts: str) -> list[Any]:
    """Return the entries of a diagnostics topic whose message has all parts."""
    return [s for m in peer.heard[topic] for s in m.status if all(part in s.message for part in parts)]


def test_two_cameras_on_the_same_topics(imgu, world, peer, make_camera):
    """Equal stamps: each image gets its own camera_info, and what is odd is said with the names of the nodes."""
    node = imgu("node", "perception", *world.arguments, "-r", "image_raw:=/cam/image_raw")
    peer.hear("/pose", POSE)
    peer.hear("/diagnostics", DIAGNOSTICS)
    node.wait_for_line("targets: poster")
    peer.wait(peer.has_publishers, "discovery")
    other = Node("second_camera", context=peer.context, enable_rosout=False, start_parameter_services=False)
    cameras = [make_camera(peer), make_camera(peer)]
    for name in ("_image", "_info"):
        publisher = getattr(cameras[1], name)
        kind, topic = publisher.msg_type, publisher.topic_name
        peer.node.destroy_publisher(publisher)
        setattr(cameras[1], name, other.create_publisher(kind, topic, image_qos()))
    for camera in cameras:
        camera.wait_for_node()
    frame = world.frames[0]
    expected = np.linalg.norm(world.results[0].first.pose.t)
    # The second camera's focal length is another: with the first one's camera_info its poses would be wrong.
    second = frame.camera.K.copy()
    second[0, 0] *= 1.5
    second[1, 1] *= 1.5
    start_ns = time.time_ns()
    for number in range(40):
        stamp_ns = start_ns + number * 10**9 // RATE_HZ
        left, right = (replace(frame, stamp_ns=stamp_ns, frame_id=name) for name in ("left", "right"))
        infos: tuple[dict[str, Any], ...] = ({}, {"k": second.ravel()})
        both = list(zip(cameras, (left, right), infos, strict=True))
        for camera, one, _ in both[:: 1 if number % 2 else -1]:
            camera.send_image(one)
        for camera, one, info in both[:: 1 if number % 4 < 2 else -1]:
            camera.send_info(one, stamp_ns, **info)
        peer.spin(1 / RATE_HZ)
    who = "2 nodes (/peer, /second_camera) publish /cam/image_raw and /cam/camera_info"
    peer.wait(lambda: told(peer, "/diagnostics", who, "each frame_id ('left', 'right') is paired"), "a warning")
    distances: dict[str, list[float]] = {"left": [], "right": []}
    for pose in peer.heard["/pose"]:
        p = pose.pose.pose.position
        distances[pose.header.frame_id].append(float(np.linalg.norm((p.x, p.y, p.z))))
    assert all(len(found) > 20 for found in distances.values()), {k: len(v) for k, v in distances.items()}
    np.testing.assert_allclose(distances["left"], expected, rtol=0.01)
    assert min(distances["right"]) > 1.3 * expected
    assert node.text.count("2 nodes (/peer") == 1
    other.destroy_node()


@pytest.mark.parametrize("reliability", ["best_effort", "reliable"])
def test_after_a_stop_fresh_frames_are_served_first(imgu, world, peer, make_camera, reliability):
    """The stamps are those of a simulation: they tell nothing of the age. A reliable camera sends old frames again."""
    override = f"qos_overrides./cam/image_raw.subscription.reliability:={reliability}"
    node = imgu("node", "perception", *world.arguments, "-r", "image_raw:=/cam/image_raw", "-p", override)
    peer.hear("/pose", POSE)
    peer.hear("/diagnostics", DIAGNOSTICS)
    node.wait_for_line("targets: poster")
    peer.wait(peer.has_publishers, "discovery")
    camera = make_camera(peer)
    if reliability == "reliable":
        peer.node.destroy_publisher(camera._image)
        camera._image = peer.publisher("/cam/image_raw", "sensor_msgs/msg/Image")
    camera.wait_for_node()
    sent_s: dict[int, float] = {}

    def send(seconds: float) -> None:
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            stamp_ns = 10**9 + len(sent_s) * 10**9 // RATE_HZ
            sent_s[stamp_ns] = time.monotonic()
            camera.send(replace(world.frames[0], stamp_ns=stamp_ns))
            peer.spin(1 / RATE_HZ)

    send(2.0)
    peer.wait(lambda: len(peer.heard["/pose"]) > 10, "poses", again=lambda: send(0.5))
    node.process.send_signal(signal.SIGSTOP)
    try:
        peer.spin(0.2)
        peer.heard["/pose"].clear()
        stopped_s = time.monotonic()
        send(3.0)
    finally:
        node.process.send_signal(signal.SIGCONT)
    resumed_s = time.monotonic()
    send(3.0)
    node.wait_for_line("suspended, or without processor time, for 3.")
    sent = [sent_s[decode_header(pose).stamp_ns] for pose in peer.heard["/pose"]]
    # The frame in hand is finished, and the last one before the end may be fresh enough.
    old_s = [at_s for at_s in sent if at_s < resumed_s - 0.2]
    assert len(old_s) <= 1 and all(at_s < stopped_s for at_s in old_s), (old_s, resumed_s)
    assert len(sent) > RATE_HZ / 2
    said = [s.message for s in told(peer, "/diagnostics", "suspended") if s.name.endswith("output")][-1]
    dropped = int(said.partition(" s: ")[2].split()[0])
    assert dropped >= (reliability == "reliable")
    values = {v.key: v.value for s in peer.heard["/diagnostics"][-1].status if "input" in s.name for v in s.values}
    assert int(values["skipped"]) >= dropped
    assert "got lost" not in node.text


SLOW = """
import sys, time
from imgu_ros.localizer import Localizer
process = Localizer.process
def slow(localizer, frame, *rest, **more):
    time.sleep(5)
    return process(localizer, frame, *rest, **more)
Localizer.process = slow
from imgu_ros.cli.main import main
sys.exit(main(sys.argv[1:]))
"""


def test_a_frame_that_takes_long_is_told_meanwhile(environment, world, peer, make_camera, tmp_path):
    script = tmp_path / "slow.py"
    script.write_text(SLOW)
    arguments = ["node", "perception", *world.arguments, "-r", "image_raw:=/cam/image_raw"]
    node = subprocess.Popen([sys.executable, str(script), *arguments], env=environment, stderr=subprocess.DEVNULL)
    try:
        for topic in ("/status", "/diagnostics"):
            peer.hear(topic, DIAGNOSTICS)
        peer.wait(peer.has_publishers, "discovery")
        camera = make_camera(peer)
        camera.wait_for_node()
        reset = peer.node.create_client(Trigger, "/perception/reset")
        peer.wait(reset.service_is_ready, "the service")
        frame = replace(world.frames[0], stamp_ns=12_500_000_000)
        camera.send(frame)
        peer.wait(lambda: told(peer, "/status", "held the worker"), "the report of a long frame")
        # A reset waits for the frame's end, and nothing else waits for the reset.
        answer = reset.call_async(Trigger.Request())
        peer.wait(lambda: told(peer, "/status", "tracked") or told(peer, "/status", "detected"), "the result")
        peer.wait(answer.done, "the answer of the reset")
        assert answer.result().success
        peer.node.destroy_client(reset)
        said = "one frame has held the worker for ", " s (stamp 12.500 s, 480 x 360 bayer_rggb8)"
        for topic, name in (("/status", "poster"), ("/diagnostics", "/perception: output")):
            held = [s for s in told(peer, topic, *said) if s.name == name]
            assert len(held) >= 2, topic
            assert all(s.level == b"\1" for s in held)
            times_s = [float(s.message.partition("worker for ")[2].split()[0]) for s in held]
            assert times_s == sorted(times_s) and 1.0 <= times_s[0] < times_s[-1] < 20
        peer.heard["/diagnostics"].clear()
        peer.wait(lambda: len(peer.heard["/diagnostics"]) > 1, "diagnostics")
        assert not told(peer, "/diagnostics", "held the worker")
    finally:
        node.terminate()
        try:
            node.wait(20)
        finally:
            node.kill()


def test_of_a_burst_of_calls_the_last_ten_are_answered(imgu, world, peer):
    """What docs/ros.md says: a service keeps ten requests."""
    node = imgu("node", "perception", *world.arguments)
    node.wait_for_line("targets: poster")
    client = peer.node.create_client(Trigger, "/perception/reset")
    peer.wait(client.service_is_ready, "the service")
    assert peer.call(Trigger, "/perception/reset", Trigger.Request()).success
    calls = [client.call_async(Trigger.Request()) for _ in range(10)]
    peer.wait(lambda: all(call.done() for call in calls), "ten answers", 5.0)
    calls = [client.call_async(Trigger.Request()) for _ in range(100)]
    peer.wait(lambda: all(call.done() for call in calls[-10:]), "the last ten answers", 5.0)
    peer.spin(0.5)
    assert sum(call.done() for call in calls) < 100, "the queue has become longer: say so in docs/ros.md"
    assert peer.call(Trigger, "/perception/reset", Trigger.Request()).success
    peer.node.destroy_client(client)


FULL = """
mount -t tmpfs -o size=16m tmpfs /dev/shm || exit 77
head -c 100M /dev/zero > /dev/shm/fill 2>/dev/null
"$@" 2>&1
echo exit code $?
rm /dev/shm/fill
"$@" 2>&1 &
node=$!
sleep 6
head -c 100M /dev/zero > /dev/shm/fill 2>/dev/null
sleep 6
kill -INT $node
wait $node
echo exit code $?
"""


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to mount a small /dev/shm of its own")
def test_a_full_shared_memory_is_said_before_anything_dies_of_it(environment):
    node = [sys.executable, "-m", "imgu_ros.cli.main", "node", "perception"]
    done = subprocess.run(
        ["unshare", "--mount", "bash", "-c", FULL, "bash", *node],
        env=environment, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    if done.returncode == 77 or "unshare" in done.stderr:
        pytest.skip(f"needs a mount namespace: {done.stderr.strip()}")
    at_start, _, running = done.stdout.partition("exit code 1\n")
    assert at_start.startswith("imgu: error: /dev/shm is full: 17 MB, 0.0 MB free: ROS would end with a bus error; "
                               "remove what fills it"), done.stdout  # fmt: skip
    assert running.count("/dev/shm is full: 17 MB, 0.0 MB free: processes that start now") == 1, done.stdout
    assert running.endswith("exit code 0\n"), done.stdout
