"""The chain: one frame in, one result out."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from imgu_ros.errors import ImguError
from imgu_ros.params import Parameters
from imgu_ros.perception.clock import StageClock
from imgu_ros.perception.develop import develop
from imgu_ros.perception.frame import Frame
from imgu_ros.perception.result import Result, Stage, Status, TargetResult
from imgu_ros.perception.search import Searched, search
from imgu_ros.perception.targets import Target
from imgu_ros.vision.descriptors.describe import describe
from imgu_ros.vision.keypoints.detect import detect
from imgu_ros.vision.scale_space.pyramid import build_pyramid


class Chain:
    """From raw frames to poses of known targets.

    Parameters
    ----------
    parameters : all parameters
    targets : prepared with the same parameters
    """

    def __init__(self, parameters: Parameters, targets: Sequence[Target]) -> None:
        self._parameters = parameters
        self._targets = tuple(targets)

    @property
    def targets(self) -> tuple[Target, ...]:
        """The known targets."""
        return self._targets

    def process(self, frame: Frame) -> Result:
        """Work on one frame.

        A frame that the chain cannot work on is rejected in the result, with the reason; nothing is raised for it.
        """
        clock = StageClock()
        start = time.perf_counter_ns()
        try:
            return self._worked(frame, clock, start)
        except ImguError as error:
            rejected = tuple(
                TargetResult(t.name, i, Status.REJECTED, reason=str(error)) for i, t in enumerate(self._targets)
            )
            return Result(
                frame, rejected, reason=str(error), times_ns=clock.times_ns, total_ns=time.perf_counter_ns() - start
            )

    def reset(self) -> None:
        """Forget all that earlier frames told."""

    def _worked(self, frame: Frame, clock: StageClock, start: int) -> Result:
        p = self._parameters
        with clock.measures(Stage.DEVELOP):
            developed = develop(frame.image, p.raw, p.demosaic)
        with clock.measures(Stage.PYRAMID):
            pyramid = build_pyramid(
                developed.grey, p.pyramid.kind, p.pyramid.levels, p.pyramid.scales_per_octave, p.pyramid.max_side_px
            )
        with clock.measures(Stage.KEYPOINTS):
            keypoints = detect(pyramid, p.keypoints.detector, p.keypoints.max_count)
        with clock.measures(Stage.DESCRIBE):
            described = describe(pyramid, keypoints, p.descriptor.kind)
        searched = Searched(frame, developed.grey, described)
        targets = tuple(
            self._searched(target, index, searched, clock) for index, target in enumerate(self._targets)
        )
        return Result(
            frame=frame,
            targets=targets,
            developed=developed,
            pyramid=pyramid,
            keypoints=described.keypoints,
            descriptors=described.descriptors,
            times_ns=clock.times_ns,
            total_ns=time.perf_counter_ns() - start,
        )

    def _searched(self, target: Target, index: int, searched: Searched, clock: StageClock) -> TargetResult:
        # A stream of its own for each frame and target: a skipped frame changes no other frame's draws.
        rng = np.random.default_rng((self._parameters.seed, searched.frame.stamp_ns % 2**64, index))
        return search(target, index, searched, self._parameters, rng, clock)
