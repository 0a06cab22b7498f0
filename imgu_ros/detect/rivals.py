# SPDX-License-Identifier: Apache-2.0
"""Which of several targets that share a part, as labels and cards of one design do, a place shows.

Two targets that differ in little more than a number are both found where one of them is. They are compared with the
frame by the same evidence: what they share says the same of both, so that the difference is that of the places where
they differ.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import combinations

import cv2
import numpy as np

from imgu_ros.config.components import DetectionParameters
from imgu_ros.detect.frame_context import FrameContext
from imgu_ros.errors import EstimationError
from imgu_ros.pose.planar_pose import distorting_camera, require_plausible
from imgu_ros.reasons import another_fits_better, not_told_from
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.template_cells import CELL, cell_means
from imgu_ros.reference.verification import Evidence, better_of, evidence
from imgu_ros.result import ReferenceResult, Stage, Status
from imgu_ros.track.patch_alignment import align_patches
from imgu_ros.track.tracker import Followed, followed_result
from imgu_ros.types import Image, Matrix3
from imgu_ros.vision.projective.transform import inverse3

#: Two targets are at one place when the intersection of their outlines is at least this share of the union.
_SAME_PLACE = 0.4
#: Share of the target that looks as it should below which a tracked target's rivals are compared in every frame.
_PERFECT = 0.97
#: Side of the images by which designs are compared, px.
_SIDE_PX = 96
#: Correlation of two targets' cells that are alike, and the share of them from which on two targets are rivals.
_ALIKE, _SHARED = 0.8, 0.2
#: Variance of a cell with enough contrast to tell.
_TEXTURED = 36.0
#: Widths over heights of one design differ by less than this factor.
_SAME_SHAPE = 1.03
#: Error of a rival's homography that alignment must bridge, raw px.
_REACH_PX = 8.0


class Rivals:
    """Which references share a part, and which of them a place shows.

    Parameters
    ----------
    references : the known ones
    parameters : those of detection
    """

    def __init__(self, references: Iterable[Reference], parameters: DetectionParameters) -> None:
        self._parameters = parameters
        self._designs: dict[str, Image] = {}
        # By the names of two: H_first_second, template px.
        self._known: dict[str, dict[str, Matrix3]] = {}
        self.know({reference.name: reference for reference in references})

    def know(self, references: Mapping[str, Reference]) -> None:
        """Know other references, by name, of which those of a name that was known are the same."""
        self._references = dict(references)
        known = self._references.keys()
        self._known = {
            name: {other: H for other, H in rivals.items() if other in known}
            for name, rivals in self._known.items()
            if name in known
        }

    def of_one_design(self, name: str) -> tuple[str, ...]:
        """Return the references that share a part of their design with one, at the same place."""
        return tuple(self._of(name))

    def settled(
        self, context: FrameContext, results: Mapping[str, ReferenceResult], thorough: bool
    ) -> dict[str, ReferenceResult]:
        """Return results of which no two are at one place.

        Parameters
        ----------
        context : the frame
        results : by name
        thorough : compare rivals of tracked references although these look as they should
        """
        settled = dict(results)
        if len(self._references) < 2:
            return settled
        found = [name for name, result in results.items() if result.outline is not None]
        with context.clock.measures(Stage.POSE):
            for first, second in combinations(found, 2):
                if settled[first].outline is not None and settled[second].outline is not None:
                    self._compare(context, settled, first, second)
            for name in found:
                result = settled[name]
                is_sure = result.status is Status.TRACKED and (result.confirmed_share or 0.0) >= _PERFECT
                if result.outline is not None and (thorough or not is_sure):
                    self._challenge(context, settled, name)
        for name in found:
            if settled[name].outline is not None:
                self._explain(settled, name)
        return settled

    def _explain(self, settled: dict[str, ReferenceResult], shown: str) -> None:
        """Say of references of one design with one that is shown why they were not confirmed."""
        for name in self._of(shown):
            result = settled.get(name)
            if result is not None and result.outline is None and result.confirmed_share is not None:
                settled[name] = replace(result, reason=another_fits_better(shown))

    def _compare(self, context: FrameContext, settled: dict[str, ReferenceResult], first: str, second: str) -> None:
        """Keep the better one of two references that were found, when they are at one place."""
        one, other = settled[first], settled[second]
        assert one.homography is not None and other.homography is not None
        if _overlap(one, other) < _SAME_PLACE:
            return
        self._learn(first, second, inverse3(one.homography.H) @ other.homography.H)
        evidences = [self._evidence(context, result.name, result.homography.H) for result in (one, other)]  # type: ignore[union-attr]
        better = better_of(*evidences)
        for result, rank in ((one, 0), (other, 1)):
            rival = (other, one)[rank]
            if better != rank:
                reason = not_told_from(rival.name) if better is None else another_fits_better(rival.name)
                settled[result.name] = _withheld(result, reason)

    def _challenge(self, context: FrameContext, settled: dict[str, ReferenceResult], name: str) -> None:
        """Compare a reference that was found with those of its design that were not."""
        result = settled[name]
        assert result.homography is not None
        own: Evidence | None = None
        for rival, H in self._of(name).items():
            if rival in settled and settled[rival].outline is not None:
                continue
            own = own or self._evidence(context, name, result.homography.H)
            there = result.homography.H @ H
            better = better_of(own, self._evidence(context, rival, there))
            if better == 1:
                replaced = self._aligned(context, rival, there)
                if replaced is not None:
                    settled[rival], settled[name] = replaced, _withheld(result, another_fits_better(rival))
                    return
            if better is None and result.status is not Status.TRACKED:
                settled[name] = _withheld(result, not_told_from(rival))
                return

    def _evidence(self, context: FrameContext, name: str, H: Matrix3) -> Evidence | None:
        lens = distorting_camera(context.frame.camera)
        return evidence(context.image, self._references[name], H, lens, is_close=True)

    def _aligned(self, context: FrameContext, name: str, H: Matrix3) -> ReferenceResult | None:
        """Return the result of a reference at a place; None when its patches do not agree there."""
        reference, frame, p = self._references[name], context.frame, self._parameters
        lens = distorting_camera(frame.camera)
        try:
            aligned = align_patches(
                context.image, reference, H, lens, p.refinement, p.homography.min_inliers, _REACH_PX
            )
            require_plausible(reference.plane, aligned.homography)
            found = evidence(context.image, reference, aligned.homography.H, lens)
            if found is None or not found.is_confirming:
                return None
            followed = Followed(aligned, found.share)
            return reference.pose(followed_result(reference, followed, Status.DETECTED), aligned, frame)
        except EstimationError:
            return None

    def _learn(self, first: str, second: str, H: Matrix3) -> None:
        self._of(first)[second] = H
        self._of(second)[first] = inverse3(H)

    def _of(self, name: str) -> dict[str, Matrix3]:
        """Return the rivals of a reference, and where they lie in its template."""
        if name not in self._known:
            self._known[name] = {
                other: H for other in self._references if (H := self._one_design(name, other)) is not None
            }
        return self._known[name]

    def _one_design(self, first: str, second: str) -> Matrix3 | None:
        """Return H_first_second where two references share a part at the same place of their outlines; else None."""
        if self._references[first].codes or self._references[second].codes:
            return None  # codes tell them apart
        (width, height), (other_width, other_height) = (self._references[name].size for name in (first, second))
        shape = width / height / (other_width / other_height)
        if first == second or not 1 / _SAME_SHAPE < shape < _SAME_SHAPE:
            return None
        a, b = self._design(first), self._design(second)
        if a.shape != b.shape:
            b = cv2.resize(b, (a.shape[1], a.shape[0]), interpolation=cv2.INTER_AREA)
        mean_a, mean_b = cell_means(a), cell_means(b)
        power_a, power_b = (cell_means(x * x) - mean * mean for x, mean in ((a, mean_a), (b, mean_b)))
        covariance = cell_means(a * b) - mean_a * mean_b
        textured = power_a >= _TEXTURED
        alike = textured & (covariance > 0) & (covariance * covariance >= _ALIKE**2 * power_a * power_b)
        if int(np.count_nonzero(alike)) < _SHARED * max(int(np.count_nonzero(textured)), 1):
            return None
        sx, sy = width / other_width, height / other_height
        return np.array([[sx, 0, (sx - 1) / 2], [0, sy, (sy - 1) / 2], [0, 0, 1]])

    def _design(self, name: str) -> Image:
        if name not in self._designs:
            templates = self._references[name].templates
            octaves = next(iter(templates.values())) if templates else templates[True]
            octave = min(octaves, key=lambda each: abs(math.log(max(each.level.image.shape) / _SIDE_PX)))
            image = octave.level.image
            height, width = (CELL * max(int(side) // CELL, 1) for side in image.shape)
            self._designs[name] = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA).astype(np.float32)
        return self._designs[name]


def _overlap(one: ReferenceResult, other: ReferenceResult) -> float:
    """Return the intersection of two outlines over their union."""
    assert one.outline is not None and other.outline is not None
    a, b = one.outline.astype(np.float32), other.outline.astype(np.float32)
    shared, _ = cv2.intersectConvexConvex(a, b)
    union = abs(cv2.contourArea(a)) + abs(cv2.contourArea(b)) - shared
    return float(shared / union) if union > 0 else 0.0


def _withheld(result: ReferenceResult, reason: str) -> ReferenceResult:
    return ReferenceResult(
        result.name,
        result.number,
        Status.LOST,
        reason=reason,
        matches=None
        if result.matches is None
        else replace(result.matches, inliers=np.zeros_like(result.matches.inliers)),
        confirmed_share=result.confirmed_share,
    )
