# SPDX-License-Identifier: Apache-2.0
"""Detection of chessboards and grids of dots: by OpenCV's detectors, and by their outlines where a part is hidden."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from imgu_ros.build_cache import BuildCache
from imgu_ros.config.components import DetectionParameters
from imgu_ros.detect.frame_context import FrameContext
from imgu_ros.detect.outlines import OutlineSearch
from imgu_ros.detect.robust_fit import RobustFit
from imgu_ros.pose.planar_pose import distorting_camera
from imgu_ros.reasons import NOT_IN_VIEW
from imgu_ros.reference.pattern import PatternReference
from imgu_ros.result import ReferenceResult, Stage, Status
from imgu_ros.types import Floats, Image, Matrix3, Points
from imgu_ros.vision.projective.fit import fit_homography

#: Share of the places of one more row of dots that are dark where there is one, and bright between.
_GOES_ON = 0.6


class PatternDetector:
    """Detects chessboards and grids of dots.

    Parameters
    ----------
    references : made with the same parameters
    parameters : those of detection
    cache : not used
    """

    def __init__(
        self, references: Sequence[PatternReference], parameters: DetectionParameters, cache: BuildCache | None = None
    ) -> None:
        self._parameters = parameters
        self._outlines = OutlineSearch(references)

    def prepare(self) -> None:
        """See `Detector.prepare`: nothing."""

    def detect(
        self, context: FrameContext, missing: Sequence[PatternReference], covered: Sequence[Points], thorough: bool
    ) -> Iterator[ReferenceResult]:
        """See `Detector.detect`."""
        fit = RobustFit(context.frame, context.image, 1.0, self._parameters, context.clock)
        for reference in missing:
            result = ReferenceResult(reference.name, reference.number, Status.LOST)
            with context.clock.measures(Stage.MATCH):
                starts = _starts(context, reference)
            result = fit.locate_at(result, reference, starts)
            if not result.status.found and (thorough or not covered) and self._parameters.search.thorough:
                with context.clock.measures(Stage.MATCH):
                    places = self._outlines.places(context, [reference])
                result = fit.locate_at(result, reference, places.get(reference.name, ()))
            if not result.status.found and not result.reason:
                result = ReferenceResult(reference.name, reference.number, Status.LOST, reason=NOT_IN_VIEW)
            yield result


def _starts(context: FrameContext, reference: PatternReference) -> list[Matrix3]:
    """Return H_image_template, ideal px, of each turn of a grid that is found."""
    seen, lens = reference.found_in(context.image.grey), distorting_camera(context.frame.camera)
    points, columns = reference.grid
    if seen is None or (reference.has_dots and _goes_on(context.image.grey, seen.reshape(-1, columns, 2))):
        return []
    if lens is not None:
        seen, valid = lens.ideal_pixels(seen)
        if not valid.all():
            return []
    return [fit_homography(points, each).H for each in reference.turned(seen)]


def _goes_on(grey: Image, seen: Points) -> bool:
    """Return whether dots (R, C, 2) px are a part of a larger grid: one more row or column of dark dots is there."""
    for grid in (seen, seen[::-1], np.swapaxes(seen, 0, 1), np.swapaxes(seen, 0, 1)[::-1]):
        # A shifted row is like the second one before it.
        beyond = grid[1] - (grid[2] - grid[0])
        dark, bright = np.median(_sampled(grey, grid[0])), np.median(_sampled(grey, (grid[0][1:] + grid[0][:-1]) / 2))
        in_view = ((beyond > 0) & (beyond < np.array(grey.shape[::-1]) - 1)).all(axis=1)
        if np.count_nonzero(in_view) < 2:
            continue
        beyond, middle = beyond[in_view], (dark + bright) / 2
        is_dark, is_bright = _sampled(grey, beyond) < middle, _sampled(grey, (beyond[1:] + beyond[:-1]) / 2) > middle
        if min(np.mean(is_dark), np.mean(is_bright)) > _GOES_ON:
            return True
    return False


def _sampled(grey: Image, xy: Points) -> Floats:
    at = xy.astype(np.float32)[None]
    return np.asarray(cv2.remap(grey, at[..., 0], at[..., 1], cv2.INTER_LINEAR)[0], np.float64)
