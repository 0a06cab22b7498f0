# SPDX-License-Identifier: Apache-2.0
"""Detection of the references that no track led to: which of them, and how thoroughly."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any, Protocol

import cv2
import numpy as np

from imgu_ros.build_cache import BuildCache
from imgu_ros.config.components import DetectionParameters
from imgu_ros.detect.features import Features, find_faint_features
from imgu_ros.detect.frame_context import FrameContext
from imgu_ros.detect.outlines import OutlineSearch
from imgu_ros.detect.robust_fit import RobustFit, draws
from imgu_ros.detect.search_passes import SearchPass, search, tentative_matches
from imgu_ros.reference.features import TargetFeatures, extractor_options, thorough_parameters
from imgu_ros.reference.planar import PlanarReference
from imgu_ros.result import ReferenceResult, Stage, Status
from imgu_ros.types import Points
from imgu_ros.vision.descriptors.describe import Descriptions
from imgu_ros.vision.descriptors.extractor import make_extractor
from imgu_ros.vision.matching.index import DescriptorIndex, build_index
from imgu_ros.vision.matching.matches import Matches

#: Up to so many missing references are searched one by one; among more, the index chooses.
_DIRECT = 3
#: Number of failures in a row after which the less likely references are skipped. Measured: benchmarks/thresholds.py,
#: study many.
_FAILURES = 3
#: Votes of the index without which a reference is not searched. Measured: benchmarks/thresholds.py, study many.
_FEWEST_VOTES = {SearchPass.FIRST: 3, SearchPass.CLOSE: 5, SearchPass.THOROUGH: 5}
#: Areas covered by references already found are drawn at an eighth of the resolution: exact enough to leave out
#: keypoints.
_MASK_STEP = 8


class Detector(Protocol):
    """Detects references of one kind in frames."""

    def prepare(self) -> None:
        """Compute what the first search would have to wait for."""

    def detect(
        self, context: FrameContext, missing: Sequence[Any], covered: Sequence[Points], thorough: bool
    ) -> Iterator[ReferenceResult]:
        """Yield the results of the missing references that were searched for; others are not in view.

        Parameters
        ----------
        context : the frame
        missing : the references of this kind that no track led to
        covered : outlines, (4, 2) raw px, of the references that were found already
        thorough : search thoroughly although other references are tracked
        """


class ReferenceDetector:
    """Detects planar images by keypoints.

    Parameters
    ----------
    references : made with the same parameters
    parameters : those of detection
    cache : keeps what is computed; what was computed before of the same references is used again
    """

    def __init__(
        self, references: Sequence[PlanarReference], parameters: DetectionParameters, cache: BuildCache | None = None
    ) -> None:
        self._references = tuple(references)
        self._parameters = parameters
        self._index: DescriptorIndex | None = None
        self._outlines = OutlineSearch(references)
        cache = BuildCache() if cache is None else cache
        self._extractor = cache.make(make_extractor, extractor_options(parameters))
        if len(references) > _DIRECT:
            self._index = cache.make(_index_of, *(reference.features for reference in references))

    def prepare(self) -> None:
        """See `Detector.prepare`."""
        if self._parameters.search.thorough:
            for reference in self._references[:_DIRECT]:
                reference.close.features()
                reference.thorough.features()

    def detect(
        self, context: FrameContext, missing: Sequence[PlanarReference], covered: Sequence[Points], thorough: bool
    ) -> Iterator[ReferenceResult]:
        """See `Detector.detect`.

        References that a first pass does not find are searched for from near, then thoroughly.
        """
        again = self._parameters.search.thorough and (thorough or not covered)
        some_found, covered = bool(covered), list(covered)
        left: dict[str, ReferenceResult | None] = {reference.name: None for reference in missing}
        for search_pass in SearchPass if again else (SearchPass.FIRST,):
            wanted = [reference for reference in missing if reference.name in left]
            if not wanted:
                break
            for result in self._search(context, search_pass, wanted, covered[:]):
                if search_pass is not SearchPass.FIRST or some_found:
                    # The published keypoints are all those of the first pass.
                    result = _without_indices(result)
                before = left.get(result.name)
                if before is None or before.confirmed_share is None or result.confirmed_share is not None:
                    # What is compared with the frame says more than that few keypoints agree.
                    left[result.name] = result
                if result.outline is not None:
                    covered.append(result.outline)
                    del left[result.name]
                    yield result
            if again and search_pass is SearchPass.FIRST:
                for result in self._by_outline(context, [each for each in wanted if each.name in left]):
                    if result.outline is None:
                        if result.confirmed_share is not None:
                            left[result.name] = result
                        continue
                    covered.append(result.outline)
                    del left[result.name]
                    yield result
        yield from (result for result in left.values() if result is not None)

    def _by_outline(self, context: FrameContext, wanted: Sequence[PlanarReference]) -> Iterator[ReferenceResult]:
        """Yield the results of references that are found by their outlines."""
        with context.clock.measures(Stage.MATCH):
            places = self._outlines.places(context, wanted)
        fit = RobustFit(context.frame, context.image, 1.0, self._parameters, context.clock)
        for reference in wanted:
            if reference.name in places:
                missing = ReferenceResult(reference.name, reference.number, Status.LOST)
                yield fit.locate_at(missing, reference, places[reference.name])

    def _search(
        self,
        context: FrameContext,
        search_pass: SearchPass,
        wanted: Sequence[PlanarReference],
        covered: Sequence[Points],
    ) -> Iterator[ReferenceResult]:
        parameters, features = self._parameters, context.features
        if search_pass is SearchPass.THOROUGH:
            parameters = thorough_parameters(parameters)
            features = find_faint_features(context.image, parameters, self._extractor, context.clock)
        features = _uncovered(features, covered, context.image.shape)
        with context.clock.measures(Stage.MATCH):
            likely = self._likely(features.described, wanted, _FEWEST_VOTES[search_pass])
        return while_promising(
            search(
                reference,
                search_pass,
                features,
                context,
                parameters,
                draws(parameters.seed, context.frame.stamp_ns, reference),
            )
            for reference in likely
        )

    def match(self, described: Descriptions) -> Iterator[ReferenceResult]:
        """Yield the references that a first pass would search for, the most likely first, with tentative matches."""
        for reference in self._likely(described, self._references, _FEWEST_VOTES[SearchPass.FIRST]):
            matches = tentative_matches(reference.features, described, self._parameters.matching)
            yield ReferenceResult(reference.name, reference.number, Status.LOST, matches=matches)

    def _likely(
        self, described: Descriptions, wanted: Sequence[PlanarReference], fewest: int
    ) -> Sequence[PlanarReference]:
        """Return the references that are worth a search, the most likely first."""
        if self._index is None or len(wanted) <= _DIRECT:
            return wanted
        position = {reference.name: at for at, reference in enumerate(self._references)}
        votes = self._index.votes(described.descriptors)[[position[reference.name] for reference in wanted]]
        order = np.argsort(-votes, kind="stable")
        return [wanted[at] for at in order[votes[order] >= fewest]]


def _index_of(*features: TargetFeatures) -> DescriptorIndex:
    return build_index([known.described.descriptors for known in features])


def while_promising(results: Iterable[ReferenceResult]) -> Iterator[ReferenceResult]:
    """Yield results, the most likely targets first, until several in a row say that there is nothing to be found."""
    failures = 0
    for result in results:
        failures = 0 if result.status.found else failures + 1
        yield result
        if failures >= _FAILURES:
            break


def _without_indices(result: ReferenceResult) -> ReferenceResult:
    """Return a result whose matches name no keypoints."""
    if result.matches is None:
        return result
    none = np.full(len(result.matches.matches), -1, np.intp)
    matches = Matches(none, none, result.matches.matches.distance)
    return replace(result, matches=replace(result.matches, matches=matches))


def _uncovered(features: Features, covered: Sequence[Points], shape: tuple[int, int]) -> Features:
    """Return the features without those on references that were found."""
    if not covered:
        return features
    height, width = shape
    mask = np.zeros((height // _MASK_STEP + 1, width // _MASK_STEP + 1), np.uint8)
    for outline in covered:
        corners = np.clip(np.rint(outline / _MASK_STEP), -30000, 30000).astype(np.int32)
        cv2.fillConvexPoly(mask, corners, 1)
    x, y = (features.described.keypoints.xy // _MASK_STEP).astype(np.intp).T
    kept = np.flatnonzero(mask[np.clip(y, 0, len(mask) - 1), np.clip(x, 0, mask.shape[1] - 1)] == 0)
    described = features.described
    return Features(features.pyramid, Descriptions(described.keypoints.chosen(kept), described.descriptors[kept]))
