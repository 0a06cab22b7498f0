# SPDX-License-Identifier: Apache-2.0
"""Detection of fiducial markers: OpenCV's aruco module finds them, the alignment of raw samples locates them."""

from __future__ import annotations

import contextlib
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from imgu_ros.build_cache import BuildCache
from imgu_ros.config.components import ReferenceParameters
from imgu_ros.detect.frame_context import FrameContext
from imgu_ros.errors import EstimationError, NotConfirmed
from imgu_ros.image.transfer_fit import SRGB_CURVE, TransferCurve, TransferFit, TransferKind
from imgu_ros.pose.planar_pose import distorting_camera, require_determined, require_plausible
from imgu_ros.reasons import NOT_IN_VIEW, seen_twice, why_not_found
from imgu_ros.reference.code_reading import read_code
from imgu_ros.reference.family import FamilyReference
from imgu_ros.reference.marker import MarkerReference
from imgu_ros.reference.marker_code import MarkerCode
from imgu_ros.reference.marker_layout import spread_out
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.verification import require_confirmed
from imgu_ros.result import ReferenceResult, Stage, Status
from imgu_ros.track.patch_alignment import align_patches
from imgu_ros.track.sample_refinement import (
    NO_HINTS,
    AlignedPatches,
    PatchAlignment,
    has_samples,
    mapped,
    refined_on_samples,
)
from imgu_ros.track.tracker import Followed, followed_result
from imgu_ros.types import Image, Matrix3, Points
from imgu_ros.vision.markers.finding import FoundMarker, MarkerFinder, distinct_markers, zooms_for
from imgu_ros.vision.projective.fit import fit_homography

#: Error of the corners that are found, raw px.
_REACH_PX = 2.0
#: Corners of the alignment are not farther from those that were found, raw px and as a share of the longer side: where
#: some patches fail, the others may put a corner elsewhere.
_FARTHEST_PX, _FARTHEST_SHARE = 2.0, 0.02
#: A marker of a board is elsewhere than the others say beyond this, raw px and as a share of its side.
_ELSEWHERE_PX, _ELSEWHERE = 3.0, 0.15
#: Most patches of the part of a board that was found.
_MOST_OF_PART = 80
#: With a curve the patches of a marker must disagree by less than this share of what they do without.
_BETTER = 0.8
#: Grey values between the darkest and the brightest hundredth of an image, below which it is stretched.
_DULL = 160
#: Of the pixels of an image one of so many is looked at for that.
_STRIDE = 4


@dataclass(frozen=True, slots=True, eq=False)
class _SeenCode:
    """A code, and a marker in the image that has it."""

    code: MarkerCode
    marker: FoundMarker


@dataclass(frozen=True, slots=True, eq=False)
class _CodedPlace:
    """Where a reference may be: codes that are seen, and their corners, (N, 2) template px and raw px."""

    codes: Sequence[MarkerCode]
    template_xy: Points
    image_xy: Points

    @classmethod
    def of(cls, seen: Sequence[_SeenCode]) -> _CodedPlace:
        codes = [each.code for each in seen]
        corners = [each.marker.corners for each in seen]
        return cls(codes, np.vstack([code.corners for code in codes]), np.vstack(corners))


class MarkerDetector:
    """Detects fiducial markers and boards of them by their codes.

    Parameters
    ----------
    references : made with the same parameters
    parameters : those of references
    cache : not used: nothing takes time
    """

    def __init__(
        self, references: Sequence[Reference], parameters: ReferenceParameters, cache: BuildCache | None = None
    ) -> None:
        self._parameters = parameters
        families = dict.fromkeys(code.family for reference in references for code in reference.codes)
        self._finders = {family: MarkerFinder(family) for family in families}

    def prepare(self) -> None:
        """See `Detector.prepare`: nothing takes time."""

    def detect(
        self, context: FrameContext, missing: Sequence[Reference], covered: Sequence[Points], thorough: bool
    ) -> Iterator[ReferenceResult]:
        """See `Detector.detect`; of a family those of its ids that are found and were no references before."""
        left = {reference.name: reference for reference in missing if isinstance(reference, MarkerReference)}
        families = {each.image.family: each for each in missing if isinstance(each, FamilyReference)}
        results: dict[str, ReferenceResult] = {}
        with context.clock.measures(Stage.MATCH):
            grey = _contrasting(context.image.grey)
        for zooms in _passes(context.image.shape, everything=thorough or not covered):
            with context.clock.measures(Stage.MATCH):
                candidates = self._candidates(grey, zooms, left, families)
            for marker, places in candidates:
                name = marker.name
                if name in results and results[name].status.found:
                    continue  # an id of a family, found in a pass before
                results[name] = self._located(context, marker, places)
                if results[name].status.found:
                    left.pop(name, None)
            if not left and not families:
                break
        for reference in missing:
            if isinstance(reference, MarkerReference):
                result = results.pop(reference.name) if reference.name in results else None
                yield result or _lost(reference, NOT_IN_VIEW)
        yield from (result for result in results.values() if result.status.found)

    def _candidates(
        self,
        grey: Image,
        zooms: Sequence[int],
        wanted: Mapping[str, MarkerReference],
        families: Mapping[str, FamilyReference],
    ) -> list[tuple[MarkerReference, list[_CodedPlace]]]:
        """Return where the wanted references, and ids of families that are none, may be by their codes."""
        by_code = {(code.family, code.number): (each, code) for each in wanted.values() for code in each.codes}
        seen: dict[str, tuple[MarkerReference, list[_SeenCode]]] = {}
        for family, finder in self._finders.items():
            numbers = {number for own, number in by_code if own == family}
            if not numbers and family not in families:
                continue
            only = None if family in families else numbers
            every = [each for zoom in zooms for each in finder.find(grey, zoom, only)]
            for found in distinct_markers(every):
                if found.number not in numbers:
                    unseen = families[family].unseen(found.number)
                    if unseen is None:
                        continue
                    numbers.add(found.number)
                    by_code[family, found.number] = unseen, unseen.codes[0]
                reference, code = by_code[family, found.number]
                seen.setdefault(reference.name, (reference, []))[1].append(_SeenCode(code, found))
        return [(reference, _gathered(each)) for reference, each in seen.values()]

    def _located(
        self, context: FrameContext, reference: MarkerReference, candidates: Sequence[_CodedPlace]
    ) -> ReferenceResult:
        """Return where a reference is, of the places that have its codes."""
        places: list[Followed] = []
        first: EstimationError | None = None
        for candidate in candidates:
            try:
                places.append(self._aligned(context, reference, candidate))
            except EstimationError as error:
                first = first or error.with_traceback(None)
        if len(places) > 1:
            return _lost(reference, seen_twice(len(places)))
        try:
            if not places:
                assert first is not None
                raise first
            with context.clock.measures(Stage.POSE):
                found = followed_result(reference, places[0], Status.DETECTED)
                return reference.pose(found, places[0].alignment, context.frame)
        except EstimationError as error:
            minimum = self._parameters.homography.min_inliers
            return _lost(reference, why_not_found(error, minimum, minimum, minimum))

    def _aligned(self, context: FrameContext, reference: MarkerReference, candidate: _CodedPlace) -> Followed:
        """Return where a reference is near a place that has its codes.

        Raises
        ------
        EstimationError
            If the frame does not show it there.
        """
        image, lens = context.image, distorting_camera(context.frame.camera)
        template_xy, corners = candidate.template_xy, candidate.image_xy
        if lens is not None:
            corners, valid = lens.ideal_pixels(corners)
            if not valid.all():
                raise NotConfirmed("a corner is where the lens model does not hold")
        with context.clock.measures(Stage.REFINE):
            aligned = self._refined(context, reference, candidate, fit_homography(template_xy, corners).H)
        seen = aligned.homography.H if aligned.H_seen is None else aligned.H_seen
        farthest = float(np.abs(mapped(seen, template_xy) - corners).max())
        if farthest > max(_FARTHEST_PX, _FARTHEST_SHARE * float(np.ptp(corners, axis=0).max())):
            raise NotConfirmed(f"its patches put a corner {farthest:.1f} px from where it is seen")
        found = require_confirmed(image, reference, seen, lens)
        require_determined(reference.plane, aligned, found.is_covered)
        reads = [(code, read_code(image, code, seen, lens)) for code in candidate.codes]
        if not any(read is not None and read.wrong <= code.tolerated for code, read in reads):
            wrong = min((read.wrong for _, read in reads if read is not None), default=0)
            raise NotConfirmed(f"{wrong} cells of its code differ", found.share)
        return Followed(aligned, found.share)

    def _refined(
        self, context: FrameContext, reference: MarkerReference, candidate: _CodedPlace, H: Matrix3
    ) -> PatchAlignment:
        image, p, lens = context.image, self._parameters, distorting_camera(context.frame.camera)
        part = self._aligned_part(context, reference, candidate, H)
        H, fewest = H if part is None else part.homography.H, p.homography.min_inliers
        try:
            aligned = align_patches(image, reference, H, lens, p.refinement, fewest, _REACH_PX)
        except EstimationError:
            if part is None:
                raise
            aligned = part  # what is not found is covered
        require_plausible(reference.plane, aligned.homography)
        if aligned.samples is None or not image.may_have_curve:
            return aligned
        if image.curve is None:
            aligned = self._through_curve(context, reference, aligned)
        if aligned.samples is not None:
            context.curve_samples.append(aligned.samples)
        return aligned

    def _aligned_part(
        self, context: FrameContext, reference: MarkerReference, candidate: _CodedPlace, H: Matrix3
    ) -> PatchAlignment | None:
        """Return the alignment of the markers of a board that were found; None: there are no others, or it fails.

        The corners of a few do not tell well enough where the others are.
        """
        image, lens = context.image, distorting_camera(context.frame.camera)
        if len(candidate.codes) == len(reference.codes) or not has_samples(image, reference):
            return None
        xy = reference.image.template.corners
        boxes = [code.corners for code in candidate.codes]
        inside = [((xy >= box.min(axis=0) - 1) & (xy <= box.max(axis=0) + 1)).all(axis=1) for box in boxes]
        xy, _ = spread_out(xy[np.any(inside, axis=0)], _MOST_OF_PART)
        start, fewest = AlignedPatches(H, xy, 0, len(xy)), self._parameters.homography.min_inliers
        try:
            return refined_on_samples(image, reference, start, lens, fewest, NO_HINTS)
        except EstimationError:
            return None

    def _through_curve(
        self, context: FrameContext, reference: MarkerReference, aligned: PatchAlignment
    ) -> PatchAlignment:
        """Return the alignment with the camera's curve, as this marker shows it; the frame's image has it from then on.

        Through a curve the edges of black and white seem to be elsewhere, at every marker's own places.
        """
        image, p, lens = context.image, self._parameters, distorting_camera(context.frame.camera)
        best, chosen, needed = aligned, None, _BETTER
        curve = _curve_of(aligned)
        for each in () if curve is None else (curve, SRGB_CURVE):
            image.curve = each
            with contextlib.suppress(EstimationError):
                H = aligned.homography.H
                found = align_patches(image, reference, H, lens, p.refinement, p.homography.min_inliers, _REACH_PX)
                if found.samples is not None and found.homography.rms_px < needed * best.homography.rms_px:
                    best, chosen, needed = found, each, 1.0
        image.curve = chosen
        return best


def _gathered(seen: Sequence[_SeenCode]) -> list[_CodedPlace]:
    """Return the places where one reference may be, of all that has its codes: one of those seen once; else each."""
    times = Counter(each.code for each in seen)
    once = [each for each in seen if times[each.code] == 1]
    if not once:
        return [_CodedPlace.of([each]) for each in seen if each.code is seen[0].code]
    while len(once) > 1:
        # A marker that lies elsewhere than the others say is another one with that id.
        place = _CodedPlace.of(once)
        try:
            H = fit_homography(place.template_xy, place.image_xy, refine=None).H
        except EstimationError:
            break
        away = np.abs(mapped(H, place.template_xy) - place.image_xy).reshape(-1, 8).max(axis=1)
        allowed = [max(_ELSEWHERE_PX, _ELSEWHERE * math.sqrt(each.marker.area)) for each in once]
        worst = int(np.argmax(away / allowed))
        if away[worst] <= allowed[worst]:
            break
        del once[worst]
    return [_CodedPlace.of(once)]


def _curve_of(aligned: PatchAlignment) -> TransferCurve | None:
    """Return the curve that the samples of a marker show; None where they go with the light."""
    if aligned.samples is None:
        return None
    fit = TransferFit()
    fit.add(aligned.samples())
    return None if fit.curve is None or fit.curve.kind is TransferKind.LINEAR else fit.curve


def _passes(shape: tuple[int, int], everything: bool) -> Iterator[tuple[int, ...]]:
    """Yield by how much an image is enlarged, pass by pass."""
    zooms = zooms_for(shape)
    # Two at first: where several markers have an id, one search alone may find one of them.
    yield zooms[: 2 if everything else 1]
    if everything:
        yield from ((zoom,) for zoom in zooms[2:])


def _lost(reference: MarkerReference, reason: str) -> ReferenceResult:
    return ReferenceResult(reference.name, reference.number, Status.LOST, reason=reason)


def _contrasting(grey: Image) -> Image:
    """Return an image with the whole range of grey values: the finder's threshold is in grey values."""
    low, high = np.percentile(grey[::_STRIDE, ::_STRIDE], (1, 99))
    if high - low >= _DULL:
        return grey
    factor = _DULL / max(high - low, 1.0)
    table = np.clip((np.arange(256) - low) * factor, 0, 255)
    return cv2.LUT(grey, np.rint(table).astype(np.uint8))
