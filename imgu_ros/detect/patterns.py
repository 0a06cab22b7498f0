# SPDX-License-Identifier: Apache-2.0
"""Detection of chessboards and grids of dots: by OpenCV's detectors, and by their outlines where a part is hidden."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from imgu_ros.build_cache import BuildCache
from imgu_ros.config.components import DetectionParameters
from imgu_ros.detect.frame_context import FrameContext
from imgu_ros.detect.outlines import OutlineSearch
from imgu_ros.detect.robust_fit import RobustFit
from imgu_ros.pose.planar_pose import distorting_camera
from imgu_ros.reasons import NOT_IN_VIEW
from imgu_ros.reference.pattern import PatternReference
from imgu_ros.result import ReferenceResult, Stage, Status
from imgu_ros.types import Matrix3, Points
from imgu_ros.vision.projective.fit import fit_homography


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
    if seen is None:
        return []
    if lens is not None:
        seen, valid = lens.ideal_pixels(seen)
        if not valid.all():
            return []
    points, _ = reference.grid
    return [fit_homography(points, each).H for each in reference.turned(seen)]
