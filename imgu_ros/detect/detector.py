# SPDX-License-Identifier: Apache-2.0
"""Looking for the targets that no track led to: which of them, and how thoroughly."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from imgu_ros.build_cache import BuildCache
from imgu_ros.config.parameters import Parameters
from imgu_ros.detect.features import Features, find_features
from imgu_ros.detect.robust_fit import draws
from imgu_ros.detect.search_passes import Searched, SearchPass, search, tentative_matches
from imgu_ros.frame import Frame
from imgu_ros.image.grey_pyramid import GreyPyramid
from imgu_ros.reference.features import TargetFeatures, extractor_options, thorough_parameters
from imgu_ros.reference.planar import Target
from imgu_ros.result import ReferenceResult, Stage, Status
from imgu_ros.stage_clock import StageClock
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


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A frame to look for targets in.

    Attributes
    ----------
    frame : as it came
    pictures : the grey one, at every resolution
    features : of a first look
    covered : outlines, (4, 2) raw px, of the targets that were found already
    """

    frame: Frame
    pictures: GreyPyramid
    features: Features
    covered: Sequence[Points] = ()


class ReferenceDetector:
    """Looks for known targets.

    Parameters
    ----------
    targets : prepared with the same parameters
    parameters : all parameters
    parts : takes what is made; what was made before of the same targets is used again
    """

    def __init__(self, targets: Sequence[Target], parameters: Parameters, parts: BuildCache | None = None) -> None:
        self._targets = tuple(targets)
        self._parameters = parameters
        self._index: DescriptorIndex | None = None
        parts = BuildCache() if parts is None else parts
        self._extractor = parts.make(make_extractor, extractor_options(parameters))
        if len(targets) > _DIRECT:
            self._index = parts.make(_index_of, *(target.features for target in targets))

    def prepare(self) -> None:
        """Make what the first thorough search would have to wait for."""
        if self._parameters.search.thorough:
            for target in self._targets[:_DIRECT]:
                target.close.features()
                target.thorough.features()

    def features(self, pictures: GreyPyramid, clock: StageClock) -> Features:
        """Return the keypoints and descriptors of a frame's first look."""
        return find_features(pictures, self._parameters, self._extractor, clock)

    def seek(
        self, view: View, missing: Sequence[int], clock: StageClock, although_tracked: bool
    ) -> Iterator[ReferenceResult]:
        """Yield what became of the missing targets that were looked for.

        Those that a first look does not find are looked for from near, then thoroughly.

        Parameters
        ----------
        view : the frame
        missing : indices of targets
        clock : takes the time of the stages
        although_tracked : look more than once also when others were found before this search
        """
        left: dict[int, ReferenceResult | None] = dict.fromkeys(missing)
        covered = list(view.covered)
        for look in SearchPass if self._again(view, although_tracked) else (SearchPass.FIRST,):
            if not left:
                break
            features = view.features
            if look is SearchPass.THOROUGH:
                features = find_features(view.pictures, thorough_parameters(self._parameters), self._extractor, clock)
            for result in self._search(replace(view, features=features, covered=covered[:]), look, tuple(left), clock):
                left[result.number] = result
                if result.outline is not None:
                    covered.append(result.outline)
                    yield left.pop(result.number) or result
        yield from (result for result in left.values() if result is not None)

    def _again(self, view: View, although_tracked: bool) -> bool:
        """Whether there is more than a first look."""
        return self._parameters.search.thorough and (although_tracked or not view.covered)

    def _search(
        self, view: View, look: SearchPass, missing: Sequence[int], clock: StageClock
    ) -> Iterator[ReferenceResult]:
        features = _uncovered(view, view.features)
        searched = Searched(view.frame, view.pictures, features, look)
        parameters = thorough_parameters(self._parameters) if look is SearchPass.THOROUGH else self._parameters
        with clock.measures(Stage.MATCH):
            likely = self._likely(features.described, missing, _FEWEST_VOTES[look])
        results = (
            search(
                self._targets[index],
                index,
                searched,
                parameters,
                draws(self._parameters, view.frame.stamp_ns, index),
                clock,
            )
            for index in likely
        )
        for result in while_promising(results):
            # The frame's keypoints that are told are all those of the first look.
            yield _without_indices(result) if look is not SearchPass.FIRST or view.covered else result

    def match(self, described: Descriptions) -> Iterator[ReferenceResult]:
        """Yield the targets that a first look would look for, the most likely first, with their tentative matches."""
        for index in self._likely(described, range(len(self._targets)), _FEWEST_VOTES[SearchPass.FIRST]):
            target = self._targets[index]
            matches = tentative_matches(target.features, described, self._parameters)
            yield ReferenceResult(target.name, index, Status.LOST, matches=matches)

    def _likely(self, described: Descriptions, missing: Sequence[int], fewest: int) -> Sequence[int]:
        """Return the missing targets that are worth a search, the most likely first."""
        if self._index is None or len(missing) <= _DIRECT:
            return missing
        candidates = np.array(missing)
        votes = self._index.votes(described.descriptors)[candidates]
        order = np.argsort(-votes, kind="stable")
        return [int(index) for index in candidates[order[votes[order] >= fewest]]]


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


def _uncovered(view: View, features: Features) -> Features:
    """Return the features without those on targets that were found."""
    if not view.covered:
        return features
    height, width = view.pictures.shape
    mask = np.zeros((height // _MASK_STEP + 1, width // _MASK_STEP + 1), np.uint8)
    for outline in view.covered:
        corners = np.clip(np.rint(outline / _MASK_STEP), -30000, 30000).astype(np.int32)
        cv2.fillConvexPoly(mask, corners, 1)
    x, y = (features.described.keypoints.xy // _MASK_STEP).astype(np.intp).T
    kept = np.flatnonzero(mask[np.clip(y, 0, len(mask) - 1), np.clip(x, 0, mask.shape[1] - 1)] == 0)
    described = features.described
    return Features(features.pyramid, Descriptions(described.keypoints.chosen(kept), described.descriptors[kept]))
