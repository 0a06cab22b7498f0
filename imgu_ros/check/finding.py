# SPDX-License-Identifier: Apache-2.0
"""How small a reference may be seen and still be found: searched for in simulated views of every size and tilt."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from imgu_ros.build_cache import BuildCache
from imgu_ros.check.trial_views import TrialView, TrialViews
from imgu_ros.config.parameters import Parameters
from imgu_ros.localizer import Localizer
from imgu_ros.reference.reference import Reference
from imgu_ros.result import ReferenceResult
from imgu_ros.types import Floats, Matrix3

#: Longer side of the views, px, largest first: steps of a factor of sqrt(2).
SIZES_PX = tuple(round(384 / math.sqrt(2) ** step, 1) for step in range(9))
#: Tilts of the views of one size, degrees: what hand and robot see.
TILTS_DEG = (7.5, 22.5, 37.5, 52.5)
#: After so many sizes in which nothing was found no smaller one is tried.
_HOPELESS = 2
#: Right is a homography whose outer corners are off by at most this share of the longer side, and so many px, rms.
_RIGHT_SHARE, _RIGHT_PX = 0.15, 10.0
#: Found dependably: in this share of the views.
DEPENDABLE_SHARE = 0.8
#: How fast the share falls with the size of a tilted view across (size * cos(tilt)), natural logarithms for a factor of
#: e in the odds. Measured: benchmarks/target_scores.py --slopes.
SLOPE = 0.08
#: In frames of another renderer, before photographs and sheets of text, targets need to be larger by this factor.
#: Measured: benchmarks/target_scores.py.
_HARDER = 1.22
#: A view this wide across is a large one, px.
_LARGE_PX = 128.0
#: Sizes and shares that are fitted.
_LOG_SIZES = np.linspace(math.log(16), math.log(900), 130)
_CEILINGS = np.linspace(0.0, 1.0, 41)


@dataclass(frozen=True, slots=True)
class SearchTrial:
    """One view: longer side, px, tilt, and whether the reference was found where it is, without doubt, or elsewhere."""

    seen_px: float
    tilt_deg: float
    found: bool
    wrong: bool
    reason: str = ""


@dataclass(frozen=True, slots=True)
class FindingCurve:
    """The share of views in which a reference is found, by its size across: where it is tilted, size * cos(tilt).

    Attributes
    ----------
    trials : the views
    ceiling : share in large views
    middle_px : longer side at which half of that share is found, seen straight on
    """

    trials: tuple[SearchTrial, ...]
    ceiling: float
    middle_px: float

    def share(self, seen_px: float, tilt_deg: float = 0.0) -> float:
        """Return the share of the views of a size and tilt in which the reference is found."""
        return self.ceiling * float(_logistic(_log_across(seen_px, tilt_deg), math.log(self.middle_px)))

    def smallest_px(self, share: float = DEPENDABLE_SHARE) -> float | None:
        """Return the longer side, straight on, from which on so large a share is found, px; None: it never is."""
        if self.ceiling <= share:
            return None
        # The odds of the share of the ceiling.
        return self.middle_px * math.pow(share / (self.ceiling - share), SLOPE)

    @property
    def large_share(self) -> float:
        """Share of the large views in which it was found."""
        large = [t.found for t in self.trials if _log_across(t.seen_px, t.tilt_deg) >= math.log(_LARGE_PX)]
        return sum(large) / max(len(large), 1)

    @property
    def wrong(self) -> int:
        """Number of views in which a homography came out that is not right."""
        return sum(trial.wrong for trial in self.trials)


def finding_curve(reference: Reference, views: TrialViews, parameters: Parameters, seed: int = 0) -> FindingCurve:
    """Search for a reference in simulated views, each by itself.

    Parameters
    ----------
    reference : made with the same parameters
    views : of it
    parameters : of the pipeline
    seed : of the views
    """
    parameters = replace(parameters, tracking=replace(parameters.tracking, enabled=False))
    localizer = Localizer(parameters, [reference], BuildCache())
    localizer.prepare()
    trials: list[SearchTrial] = []
    unfound = 0
    for size_index, seen_px in enumerate(SIZES_PX):
        some = drawn = False
        for tilt_index, tilt_deg in enumerate(TILTS_DEG):
            rng = np.random.default_rng([seed, size_index, tilt_index])
            size = seen_px * math.sqrt(2) ** rng.uniform(-0.5, 0.5)
            tilt = tilt_deg + rng.uniform(-7.5, 7.5)
            if unfound >= _HOPELESS:
                trials.append(SearchTrial(size, tilt, False, False, "not tried: larger ones were not found"))
                continue
            view = views.anywhere(size, math.radians(tilt), rng)
            if view is None:
                continue
            drawn = True
            trials.append(_searched(localizer.process(view.frame).first, view, tilt, reference))
            some |= trials[-1].found
        unfound += drawn and not some
        unfound = 0 if some else unfound
    curve = fitted_curve(trials)
    return replace(curve, middle_px=_HARDER * curve.middle_px)


def fitted_curve(trials: Iterable[SearchTrial]) -> FindingCurve:
    """Return the curve of views: the mean over all curves, weighted by how likely the views are with each."""
    trials = tuple(trials)
    if not trials:
        return FindingCurve((), 0.0, math.exp(_LOG_SIZES[-1]))
    sizes = np.array([_log_across(trial.seen_px, trial.tilt_deg) for trial in trials])
    found = np.array([trial.found for trial in trials])
    share = _CEILINGS[:, None, None] * _logistic(sizes[None, None], _LOG_SIZES[None, :, None])
    # One view in fifty fails by chance of another kind.
    share = 0.01 + 0.97 * share
    log = np.where(found, np.log(share), np.log1p(-share)).sum(axis=2)
    weight = np.exp(log - log.max())
    # Most targets are found in every large view.
    weight *= (1 + 4 * (_CEILINGS > 0.97))[:, None]
    weight /= weight.sum()
    ceiling, middle = float((weight.sum(axis=1) * _CEILINGS).sum()), float((weight.sum(axis=0) * _LOG_SIZES).sum())
    return FindingCurve(trials, ceiling, math.exp(middle))


def _log_across(seen_px: float, tilt_deg: float) -> float:
    return math.log(seen_px * math.cos(math.radians(tilt_deg)))


def _logistic(log_size: Floats | float, middle: Floats | float) -> Floats:
    return np.asarray(1 / (1 + np.exp(-(np.asarray(log_size) - middle) / SLOPE)))


def _searched(result: ReferenceResult, view: TrialView, tilt_deg: float, reference: Reference) -> SearchTrial:
    if result.homography is None:
        return SearchTrial(view.seen_px, tilt_deg, False, False, result.reason)
    right = _corner_px(result.homography.H, view.H, reference) <= min(_RIGHT_SHARE * view.seen_px, _RIGHT_PX)
    # Of places where it looks the same, none is told to be the right one.
    return SearchTrial(view.seen_px, tilt_deg, right and not result.alike, not right, result.reason)


def _corner_px(H: Matrix3, true_H: Matrix3, reference: Reference) -> float:
    """Return the rms distance of the outer corners from their true places, px; infinite behind the camera."""
    a, b = H @ reference.outline_homogeneous, true_H @ reference.outline_homogeneous
    if not (a[2] > 0).all():
        return math.inf
    return float(np.sqrt((((a[:2] / a[2]) - (b[:2] / b[2])) ** 2).sum(axis=0).mean()))
