# SPDX-License-Identifier: Apache-2.0
"""Cameras that come, go and change, and a node that does the same: poses resume, and nothing is left over."""

from __future__ import annotations

import os
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")

from imgu_ros.vision.camera.intrinsics import make_camera as camera_model
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage

pytestmark = pytest.mark.soak

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
PATH = "nav_msgs/msg/Path"
STATUS = "diagnostic_msgs/msg/DiagnosticArray"


def resident_mb(pid: int) -> float:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1024


def threads_and_files(pid: int) -> tuple[int, int]:
    return len(os.listdir(f"/proc/{pid}/task")), len(os.listdir(f"/proc/{pid}/fd"))


def smaller(frame: Any) -> Any:
    """Return a frame of half the size, in grey: another resolution and another encoding."""
    pixels = frame.image.pixels
    grey = cv2.cvtColor(pixels, cv2.COLOR_BayerBG2GRAY)
    half = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    height, width = half.shape
    K = np.diag([0.5, 0.5, 1.0]) @ (frame.camera.K + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]))
    K[:2, 2] -= 0.5
    camera = camera_model(K, np.array(frame.camera.distortion), frame.camera.model, width, height)
    return replace(frame, image=RawImage(half, PixelLayout(ColorModel.MONO)), camera=camera)


def test_cameras_come_go_and_change(imgu, world, peer, make_camera):
    node = imgu("node", "perception", *world.arguments, "-r", "image_raw:=/cam/image_raw")
    node.wait_for_line("targets: poster")
    peer.hear("/pose", POSE)
    peer.wait(peer.has_publishers, "the node's outputs")
    frame, poses = world.frames[0], peer.heard["/pose"]
    small = smaller(frame)
    resumed_s, memory_mb = [], []
    for _ in range(8):
        camera = make_camera(peer)
        camera.wait_for_node()
        for version, encoding in ((frame, "bayer_rggb8"), (small, "mono8"), (frame, "bayer_rggb8")):
            count, started = len(poses), time.monotonic()

            def send(camera: Any = camera, version: Any = version, encoding: str = encoding) -> None:
                now = replace(version, stamp_ns=time.time_ns())
                camera.send_info(now, now.stamp_ns)
                camera.send_image(now, encoding=encoding)

            send()
            peer.wait(lambda count=count: len(poses) > count, "a pose", again=send)
            resumed_s.append(time.monotonic() - started)
            t = poses[-1].pose.pose.position
            truth = world.results[0].first.pose.t
            # The same view, whatever the resolution.
            assert np.linalg.norm([t.x - truth[0], t.y - truth[1], t.z - truth[2]]) < 0.02 * np.linalg.norm(truth)
        camera.close()
        memory_mb.append(resident_mb(node.process.pid))
    assert memory_mb[-1] - memory_mb[2] < 5, memory_mb
    if "IMGU_QUIET" in os.environ:
        print("resumed after", sorted(resumed_s)[-3:], "memory", memory_mb)
    assert "[ERROR]" not in node.text
    assert "Traceback" not in node.text


def test_a_recording_in_a_loop_begins_anew(imgu, world, peer, make_camera):
    """Stamps that jump back by more than a second: the target is detected again, and the path starts again."""
    node = imgu("node", "perception", *world.arguments, "-r", "image_raw:=/cam/image_raw")
    node.wait_for_line("targets: poster")
    peer.hear("/status", STATUS)
    peer.hear("/path", PATH)
    camera = make_camera(peer)
    camera.wait_for_node()
    # As far apart as a path's messages, and without motion: every frame but a round's first is tracked.
    still = [replace(world.frames[0], stamp_ns=10**18 + i * 1_100_000_000) for i in range(4)]
    first_rounds: list[list[str]] = []
    for _ in range(2):
        said = []
        for frame in still:
            count, paths = len(peer.heard["/status"]), len(peer.heard["/path"])
            camera.send(frame)
            peer.wait(lambda n=count: len(peer.heard["/status"]) > n, "a status")
            peer.wait(lambda n=paths: len(peer.heard["/path"]) > n, "a path")
            values = {v.key: v.value for v in peer.heard["/status"][-1].status[0].values}
            said.append(f"{values['status']} {len(peer.heard['/path'][-1].poses)}")
        first_rounds.append(said)
    assert first_rounds[0] == first_rounds[1] == ["detected 1", "tracked 2", "tracked 3", "tracked 4"]


def test_a_hundred_transitions_leave_nothing_behind(imgu, world, peer, make_camera):
    """In any order, also ones that are not possible, while somebody listens and a camera sends."""
    import random

    from lifecycle_msgs.msg import State, Transition
    from lifecycle_msgs.srv import ChangeState, GetState

    # The less there is to prepare, the more transitions.
    less = ["-p", "search.thorough:=false", "-p", "keypoints.max_count:=300"]
    node = imgu("node", "perception", *world.arguments, *less, "-r", "image_raw:=/cam/image_raw")
    node.wait_for_line("targets: poster")
    peer.hear("/pose", POSE)
    camera = make_camera(peer)
    camera.wait_for_node()
    change = peer.node.create_client(ChangeState, "/perception/change_state")
    ask = peer.node.create_client(GetState, "/perception/get_state")
    peer.wait(lambda: change.service_is_ready() and ask.service_is_ready(), "services")

    def call(client: Any, request: Any) -> Any:
        future = client.call_async(request)
        peer.wait(future.done, "an answer")
        return future.result()

    T, S = Transition, State
    leads = {
        (S.PRIMARY_STATE_UNCONFIGURED, T.TRANSITION_CONFIGURE): S.PRIMARY_STATE_INACTIVE,
        (S.PRIMARY_STATE_INACTIVE, T.TRANSITION_ACTIVATE): S.PRIMARY_STATE_ACTIVE,
        (S.PRIMARY_STATE_ACTIVE, T.TRANSITION_DEACTIVATE): S.PRIMARY_STATE_INACTIVE,
        (S.PRIMARY_STATE_INACTIVE, T.TRANSITION_CLEANUP): S.PRIMARY_STATE_UNCONFIGURED,
    }
    transitions = sorted({transition for _, transition in leads})
    rng, state, made = random.Random(1), S.PRIMARY_STATE_ACTIVE, 0
    figures: list[tuple[float, int, int]] = []
    while made < 100:
        wanted = rng.choice(transitions)
        camera.send(replace(world.frames[made % 4], stamp_ns=time.time_ns()))
        answer = call(change, ChangeState.Request(transition=T(id=wanted)))
        assert answer.success == ((state, wanted) in leads)
        state = leads.get((state, wanted), state)
        made += answer.success
        if made % 20 == 0:
            assert call(ask, GetState.Request()).current_state.id == state
        if state == S.PRIMARY_STATE_UNCONFIGURED and answer.success:
            figures.append((resident_mb(node.process.pid), *threads_and_files(node.process.pid)))
    early, late = figures[len(figures) // 3], figures[-1]
    if "IMGU_QUIET" in os.environ:
        print(figures)
    assert late[0] - early[0] < 5, figures
    assert late[1] <= early[1], figures
    assert late[2] <= early[2], figures
    while state != S.PRIMARY_STATE_ACTIVE:
        wanted = T.TRANSITION_CONFIGURE if state == S.PRIMARY_STATE_UNCONFIGURED else T.TRANSITION_ACTIVATE
        assert call(change, ChangeState.Request(transition=T(id=wanted))).success
        state = leads[state, wanted]
    peer.heard["/pose"].clear()

    def send() -> None:
        camera.send(replace(world.frames[0], stamp_ns=time.time_ns()))

    peer.wait(lambda: camera.is_subscribed, "the node's subscription")
    peer.wait(lambda: peer.heard["/pose"], "a pose", again=send)
    assert "[ERROR]" not in node.text
    assert "Traceback" not in node.text
