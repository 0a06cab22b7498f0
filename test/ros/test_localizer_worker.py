# SPDX-License-Identifier: Apache-2.0
"""The worker: parameters that change between frames cost no track that does not depend on them."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")

from imgu_ros.config.values import parameters_from
from imgu_ros.files.camera_info_file import camera_info_text
from imgu_ros.frame import Frame
from imgu_ros.messages.camera_info import camera_info_message
from imgu_ros.messages.header import Header
from imgu_ros.messages.image import image_message
from imgu_ros.reference import features as target_features
from imgu_ros.reference.templates import TargetImage
from imgu_ros.result import Result, Status
from imgu_ros.ros import localizer_worker as worker_module
from imgu_ros.ros.frame_queue import FrameQueue
from imgu_ros.ros.frame_worker import FrameMessages
from imgu_ros.ros.localizer_worker import LocalizerWorker, ResultHandlers
from imgu_ros.ros.messages import make_message
from imgu_ros.simulate.sequence import Simulation, default_targets, simulate_sequence


class Running:
    """A worker, and the results of the frames that it is given."""

    def __init__(self, images: tuple[TargetImage, ...]) -> None:
        self.parameters = parameters_from({"pyramid.max_side_px": 400, "keypoints.max_count": 300})
        self.results: list[Result] = []
        self.failures: list[str] = []
        self._came = threading.Event()
        self._slot: FrameQueue[FrameMessages] = FrameQueue()
        handlers = ResultHandlers(self._on_result, lambda _: None, self.failures.append, lambda: False)
        self.worker = LocalizerWorker(self._slot, lambda: self.parameters, handlers)
        self.worker.use(self.worker.build(images))

    def work(self, frame: Frame) -> Result:
        self._came.clear()
        header = Header(frame.stamp_ns, frame.frame_id)
        image = image_message(make_message, header, frame.image.pixels, "bayer_rggb8")
        assert frame.camera is not None
        self._slot.put(
            FrameMessages(
                {"image_raw": image}, camera_info_message(make_message, header, frame.camera), time.monotonic()
            )
        )
        assert self._came.wait(20), self.failures
        return self.results[-1]

    def change(self, values: dict[str, object]) -> None:
        """Set parameters, and wait until the pipeline for them is made."""
        self.parameters = parameters_from(values, self.parameters)
        end = time.monotonic() + 20
        while self.worker.parameters is not self.parameters:
            assert time.monotonic() < end
            self.worker.follow()
            with self.worker.between_frames():
                self.worker._take_over()
            time.sleep(0.005)

    def _on_result(self, result: Result) -> None:
        self.results.append(result)
        self._came.set()


@pytest.fixture
def described(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """One entry for every view of a target that was described."""
    made: list[Any] = []
    describe = target_features._described
    monkeypatch.setattr(target_features, "_described", lambda *given: made.append(given) or describe(*given))
    return made


@pytest.fixture(scope="module")
def images() -> tuple[TargetImage, ...]:
    return default_targets(1, seed=3, width_m=0.5)


@pytest.fixture(scope="module")
def frames(images: tuple[TargetImage, ...]) -> list[Frame]:
    simulation = Simulation(width=480, height=360, frames=120, seed=3)
    return [simulated.frame for simulated in islice(simulate_sequence(simulation, images), 8)]


def test_a_running_worker_keeps_its_tracks(
    images: tuple[TargetImage, ...], frames: list[Frame], described: list[Any]
) -> None:
    running = Running(images)
    try:
        assert running.work(frames[0]).first.status is Status.DETECTED
        assert running.work(frames[1]).first.status is Status.TRACKED
        before = len(described)
        for frame, values in zip(
            frames[2:6],
            ({"path.max_length": 7}, {"compressed.jpeg_quality": 50}, {"seed": 4, "frames.camera": "eye"},
             {"homography.threshold_px": 2.0, "demosaic.method": "malvar"}),
            strict=True,
        ):  # fmt: skip
            running.change(values)
            assert running.work(frame).first.status is Status.TRACKED, values
        assert len(described) == before
        running.change({"keypoints.max_count": 200})
        assert len(described) == before + 2
        assert running.work(frames[6]).first.status is Status.TRACKED
        running.worker.reset()
        assert running.work(frames[7]).first.status is Status.DETECTED
        assert not running.failures
    finally:
        assert running.worker.close(5.0)


def test_a_reload_describes_all_anew_and_a_cleanup_forgets_all(
    images: tuple[TargetImage, ...], frames: list[Frame], described: list[Any]
) -> None:
    running = Running(images)
    worker = running.worker
    try:
        running.work(frames[0])
        once = len(described)
        read_again = [replace(image, pixels=image.pixels.copy(), width_m=0.7) for image in images]
        worker.use(worker.build(read_again))
        assert len(described) == 2 * once
        target = running.work(frames[1]).first
        assert target.status is Status.TRACKED
        worker.drop()
        worker.use(worker.build(read_again))
        assert len(described) == 3 * once
        assert running.work(frames[2]).first.status is Status.DETECTED
    finally:
        assert worker.close(5.0)


def test_a_camera_file_that_has_vanished_is_said_and_read_when_it_is_there(
    images: tuple[TargetImage, ...], frames: list[Frame], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker_module, "_AGAIN_S", 0.0)
    running = Running(images)
    try:
        path = tmp_path / "camera.yaml"
        running.parameters = parameters_from({"camera.info_file": str(path)}, running.parameters)
        for frame in frames[:2]:
            assert running.work(frame).first.pose is not None, "camera_info counts as before"
        assert "camera.yaml" in running.worker.reading_problem
        assert len(running.failures) == 2
        assert running.worker.info_file == ""
        assert frames[0].camera is not None
        path.write_text(camera_info_text(frames[0].camera))
        running.work(frames[2])
        assert (running.worker.info_file, running.worker.reading_problem) == (str(path), "")
        assert len(running.failures) == 2
    finally:
        assert running.worker.close(5.0)


def test_poor_targets_are_those_in_use(images: tuple[TargetImage, ...]) -> None:
    """A picture that looks the same turned is said as long as it is a target, its name among others."""
    half = images[0].pixels[:400]
    turned = TargetImage("turned", np.vstack((half, half[::-1, ::-1])), 0.5)
    running = Running((*images, turned))
    try:
        assert set(running.worker.poor_targets) == {"turned"}
        assert "turned by 180 degrees" in running.worker.poor_targets["turned"]
        running.worker.use(running.worker.build(images))
        assert running.worker.poor_targets == {}
        running.worker.use(running.worker.build([turned]))
        assert set(running.worker.poor_targets) == {"turned"}
        running.worker.drop()
        assert running.worker.poor_targets == {}
    finally:
        running.worker.close()
