# SPDX-License-Identifier: Apache-2.0
"""A frame while it is processed: what the steps of the pipeline need of it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

from imgu_ros.detect.features import Features
from imgu_ros.errors import ShapeError
from imgu_ros.frame import Frame
from imgu_ros.image.frame_image import Development, FrameImage
from imgu_ros.image.transfer_fit import CurveSamples
from imgu_ros.result import Result, Stage, StageClock


class FrameContext:
    """A frame while it is processed.

    Parameters
    ----------
    frame : as it came
    development : of the frame
    extract : detects and describes the keypoints of a grey image, and takes the time of the stages

    Attributes
    ----------
    frame : as given
    clock : takes the time of the stages
    curve_samples : of references that were detected: they tell the transfer curve
    """

    def __init__(
        self, frame: Frame, development: Development, extract: Callable[[FrameImage, StageClock], Features]
    ) -> None:
        self._start_ns = time.perf_counter_ns() - development.took_ns
        self.frame = frame
        self._development = development
        self._extract = extract
        self._features: Features | None = None
        self.curve_samples: list[Callable[[], CurveSamples]] = []
        self.clock = StageClock()
        self.clock.times_ns[Stage.DEVELOP] = development.took_ns

    @property
    def image(self) -> FrameImage:
        """The frame's image.

        Raises
        ------
        ShapeError
            If the frame could not be developed.
        """
        if self._development.image is None:
            raise ShapeError(self._development.reason)
        return self._development.image

    @property
    def features(self) -> Features:
        """The frame's pyramid, keypoints and descriptors; computed on the first call."""
        if self._features is None:
            self._features = self._extract(self.image, self.clock)
        return self._features

    @property
    def computed_features(self) -> Features | None:
        """The features; None when nothing has needed them."""
        return self._features

    def timed(self, result: Result) -> Result:
        """Return a result with the time that the frame has taken so far."""
        return replace(result, times_ns=self.clock.times_ns, total_ns=time.perf_counter_ns() - self._start_ns)
