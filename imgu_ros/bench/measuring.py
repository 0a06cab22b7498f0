# SPDX-License-Identifier: Apache-2.0
"""Methods on the same frames, one after the other on each frame, against the truth and the clock."""

from __future__ import annotations

import gc
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest

import numpy as np

from imgu_ros.bench.methods import Answer, BenchmarkMethod
from imgu_ros.errors import ShapeError
from imgu_ros.reference.templates import TargetImage
from imgu_ros.simulate.scene import size_of
from imgu_ros.simulate.sequence import SimulatedFrame
from imgu_ros.simulate.truth import Truth, corner_error, normalised_squared_error
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.rotation import log_so3


@dataclass(frozen=True, slots=True, eq=False)
class FrameMeasurement:
    """One method, one frame, one target.

    Attributes
    ----------
    method, frame, target : whose answer to what; `frame` counts the frames that were shown
    present : whether the frame shows the target
    answered : whether the method gave a homography
    corner_px : error of the corners, infinite beyond the horizon; None without answer or without truth
    rotation_deg, translation_percent : errors of the pose; the translation's of the true distance
    nees : see `normalised_squared_error`
    status, reason : the method's words
    """

    method: str
    frame: int
    target: str
    present: bool
    answered: bool
    corner_px: float | None = None
    rotation_deg: float | None = None
    translation_percent: float | None = None
    nees: float | None = None
    status: str = ""
    reason: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Timing:
    """How long one method took for one frame: on the clock, of all cores together, and in each stage, ms."""

    method: str
    frame: int
    ms: float
    cpu_ms: float
    stages_ms: Mapping[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """All samples and timings of a run."""

    samples: list[FrameMeasurement]
    timings: list[Timing]


@dataclass(frozen=True, slots=True, eq=False)
class MeasurementPlan:
    """Frames, and the methods that they are shown to.

    Attributes
    ----------
    methods : forget all earlier frames first
    batches : frames in order, in lists that are complete before they are worked on
    targets : the known ones, as the methods have them
    every : methods that see every n-th frame only, by name
    """

    methods: Sequence[BenchmarkMethod]
    batches: Iterable[Sequence[SimulatedFrame]]
    targets: Sequence[TargetImage]
    every: Mapping[str, int] = field(default_factory=dict)


def measure(show: MeasurementPlan) -> Measured:
    """Show the same frames to every method.

    On each frame the methods take turns, and who begins changes from frame to frame, so that a slower or faster moment
    of the machine, and what one leaves in the caches, meets them alike. Frames are made before the clock runs.

    Returns
    -------
    samples in the order of frames, and timings
    """
    return measure_in_turn([show])[0]


def measure_in_turn(shows: Sequence[MeasurementPlan]) -> list[Measured]:
    """Measure several shows, a list of frames of each in turn, so that a slower moment of the machine meets all alike.

    Returns
    -------
    as `measure`, one for each show
    """
    measured = [Measured([], []) for _ in shows]
    for show in shows:
        for method in show.methods:
            method.reset()
    counts = [0] * len(shows)
    for batches in zip_longest(*(show.batches for show in shows), fillvalue=()):
        for number, batch in enumerate(batches):
            _shown_batch(shows[number], batch, counts[number], measured[number])
            counts[number] += len(batch)
    return measured


def _shown_batch(show: MeasurementPlan, batch: Sequence[SimulatedFrame], first: int, measured: Measured) -> None:
    sizes = {target.name: size_of(target) for target in show.targets}
    for index, simulated in enumerate(batch, first):
        turn = index % len(show.methods)
        for method in (*show.methods[turn:], *show.methods[:turn]):
            if index % show.every.get(method.name, 1) == 0:
                _shown(method, index, simulated, sizes, measured)


def _shown(
    method: BenchmarkMethod,
    index: int,
    simulated: SimulatedFrame,
    sizes: Mapping[str, tuple[int, int]],
    measured: Measured,
) -> None:
    # As timeit does: garbage of one method is not collected in another's time.
    enabled = gc.isenabled()
    gc.disable()
    try:
        cpu, start = time.process_time_ns(), time.perf_counter_ns()
        answered = method.answer(simulated.frame)
        ns, cpu_ns = time.perf_counter_ns() - start, time.process_time_ns() - cpu
    finally:
        if enabled:
            gc.enable()
    stages = {stage: t / 1e6 for stage, t in answered.stages_ns.items()}
    measured.timings.append(Timing(method.name, index, ns / 1e6, cpu_ns / 1e6, stages))
    for answer in answered.answers:
        truths = [truth for truth in simulated.truths if truth.target == answer.target]
        measured.samples.append(_sample(method.name, index, answer, truths, sizes, simulated))


def _sample(
    method: str,
    index: int,
    answer: Answer,
    truths: Sequence[Truth],
    sizes: Mapping[str, tuple[int, int]],
    simulated: SimulatedFrame,
) -> FrameMeasurement:
    plain = FrameMeasurement(
        method, index, answer.target, bool(truths), answer.H is not None, status=answer.status, reason=answer.reason
    )
    if answer.H is None or not truths:
        return plain
    camera = simulated.frame.camera
    # Of several copies of a target each is right: the nearest counts.
    errors = [_corner_px(answer, truth, sizes[answer.target], simulated, camera) for truth in truths]
    nearest = int(np.argmin(errors))
    rotation = translation = nees = None
    pose, true = answer.pose, truths[nearest].pose
    if pose is not None and true is not None:
        delta_r, delta_t = log_so3(true.R @ pose.R.T), true.t - pose.t
        rotation = float(np.rad2deg(np.linalg.norm(delta_r)))
        translation = float(100 * np.linalg.norm(delta_t) / np.linalg.norm(true.t))
        if answer.covariance is not None:
            nees = normalised_squared_error(true, pose, answer.covariance)
    return FrameMeasurement(
        method,
        index,
        answer.target,
        True,
        True,
        errors[nearest],
        rotation,
        translation,
        nees,
        answer.status,
        answer.reason,
    )


def _corner_px(
    answer: Answer, truth: Truth, size: tuple[int, int], simulated: SimulatedFrame, camera: Camera | None
) -> float:
    pixels = simulated.frame.image.pixels
    assert answer.H is not None
    try:
        return corner_error(answer.H, truth.H, size, (pixels.shape[1], pixels.shape[0]), camera)
    except ShapeError:  # an answer that is no number
        return float("inf")
