# SPDX-License-Identifier: Apache-2.0
"""Normal equations of patches of raw samples, and the motion of the plane that solves them together."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from imgu_ros.errors import DegenerateConfiguration, NoConsensus
from imgu_ros.image.raw_samples import Singles
from imgu_ros.types import Floats, Indices, Mask, Matrix3, Points

#: A patch whose displacement is farther from the plane's motion is an outlier: chi-squared of 2 degrees of freedom.
#: Measured: benchmarks/thresholds.py, study samples.
_OUTLIER = 16.0
#: The spread is known to be moderate, in units in which the samples determine it to 1: decides where they do not.
_SPREAD_PRIOR = 1e-4
#: Least ratio of what a patch tells across its edge and along it.
_WEAKEST = 1e-6
#: Standard deviation of a patch's displacement before its samples are looked at, px.
_FARTHEST_PX = 0.5
#: A motion that is expected to be a smaller share of its standard deviation need not be made. Measured:
#: benchmarks/thresholds.py, study samples.
_SETTLED = 0.5
#: Places of the spread in a motion and its change.
_OF_SPREAD = np.arange(8, 11)
#: Among these the variance of the patches' own displacements is chosen, px^2.
_OWN_VARIANCES = np.concatenate(([0.0], np.geomspace(1e-5, 0.25, 19)))
#: The normal distribution's quantile below which one sum of squares in twenty is, see Wilson & Hilferty (1931).
_QUANTILE_05 = -1.6449
#: Variance of a normal distribution over the median of its square.
_OF_MEDIAN_SQUARE = 1 / 0.4549
#: One of so many sites is looked at for the noise.
_NOISE_STRIDE = 4


@dataclass(frozen=True, slots=True, eq=False)
class PatchSolution:
    """The solution of all patches' equations.

    Attributes
    ----------
    theta : (11,) motion p0 ... p7, see `SitesFit`, and change of the spread xx, xy, yy, px^2
    information : (8, 8) of the motion
    own : variance of the patches' own displacements, px^2
    kept : (N,) patches that agree
    displacements : (N, 2) px, by how much farther each would go
    told, scores : (N, 2, 2) and (N, 2), normal equations of that, beside its own displacement
    """

    theta: Floats
    information: Floats
    own: float
    kept: Mask
    displacements: Points
    told: Floats
    scores: Points

    def is_settled(self, before: Floats) -> bool:
        """Whether a further motion would change little, by this one and the one before, (8,)."""
        motion = self.theta[:8]
        this2, before2 = float(motion @ self.information @ motion), float(before @ self.information @ before)
        # The next is to this one as this one to the one before.
        return before2 > 0 and this2 * min(this2 / before2, 1.0) < _SETTLED**2


@dataclass(frozen=True, slots=True, eq=False)
class SitesFit:
    """The motion of a plane by the raw samples.

    Attributes
    ----------
    H : H_image_picture
    chosen : (N,) index of each patch among the given centres
    kept : (N,) patches that agree
    displacements : (N, 2) px, by how much more their own samples would move them
    T : (3, 3) similarity of the image that makes its points of moderate size
    information : (8, 8) of the motion (p0 ... p7), I - D the motion of the normalised image, D = [[p0 p1 p2] [p3 p4 p5]
        [p6 p7 0]]
    covariance : (8, 8) of the motion, with what the residuals tell of errors beside noise
    doubted : (8, 8) beside it, of what moves all patches alike: the motion while rows, or all, are exposed
    own_px : standard deviation of the patches' own displacements, beside noise
    registration_px : error of the prediction at a site, as if it were displaced by so much
    noise : variance of a bright site, share of full scale squared
    moved_px : largest motion of a patch in the last step
    spread : (3,) what the point spread is wider than assumed, px^2: variances xx, xy, yy
    """

    H: Matrix3
    chosen: Indices
    kept: Mask
    displacements: Points
    T: Matrix3
    information: Floats
    covariance: Floats
    doubted: Floats
    own_px: float
    registration_px: float
    noise: float
    moved_px: float
    spread: Floats


class PatchEquations:
    """Normal equations of each patch for displacement and spread; gain and offset of each channel are eliminated.

    Parameters
    ----------
    terms : (2 C + 6, N, S) float32, see `SiteAlignment`
    weights : (N, S) float32
    channels : their number C
    by_motion : (N, 2, 8) derivative of the patches' displacements by the motion of the plane, px

    Attributes
    ----------
    S, b : (N, 5, 5) and (N, 5), left and right side
    gains : of each patch and channel before a motion, (N, C), and their weights
    """

    def __init__(self, terms: Singles, weights: Singles, channels: int, by_motion: Floats) -> None:
        self._by = by_motion
        self._terms = terms
        products = ((terms * weights).transpose(1, 0, 2) @ terms.transpose(1, 2, 0)).astype(np.float64)
        # Without the constants the predictions of the channels are orthogonal.
        f, one = slice(5, 5 + channels), slice(5 + channels, 5 + 2 * channels)
        self._totals = np.diagonal(products[:, one, one], axis1=1, axis2=2) + 1e-9
        self._by_one = products[:, one] / self._totals[:, :, None]
        products -= products[:, :, one] @ self._by_one
        # A flat patch has no gain: the prior decides only there.
        power = np.diagonal(products[:, f, f], axis1=1, axis2=2) + 1e-7 * self._totals
        self._by_f = products[:, f] / power[:, :, None]
        self.gains = self._by_f[:, :, -1].copy(), power
        products -= products[:, :, f] @ self._by_f
        self._f = f
        self.S, self.b = products[:, :5, :5], products[:, :5, -1]

    def residuals(self, displacements: Points, spread: Floats) -> Singles:
        """Return what the samples (N, S) are off, after displacements (N, 2) px and a change of the spread."""
        count = len(displacements)
        x = np.zeros((count, len(self._terms), 1))
        x[:, :2, 0], x[:, 2:5, 0], x[:, -1] = -displacements, -spread, 1
        x[:, self._f] = -self._by_f @ x
        x[:, self._f.stop : -1] = -self._by_one @ x
        e: Singles = (x.astype(np.float32).transpose(0, 2, 1) @ self._terms.transpose(1, 0, 2))[:, 0]
        return e

    def solved(
        self, own: float, kept: Mask, rounds: int, fewest: int, least_own: float = 0.0, is_exact: bool = False
    ) -> PatchSolution:
        """Solve for motion and spread, with a random displacement of each patch.

        Parameters
        ----------
        own, kept : variance of those displacements, px^2, and (N,) which patches agree, as a start
        rounds : both are estimated so often
        fewest : patches that must agree
        least_own : smallest variance of their own displacements, px^2
        is_exact : where patches agree better than by such a variance, it is smaller

        Raises
        ------
        NoConsensus
            If fewer agree.
        DegenerateConfiguration
            If they do not determine a homography.
        """
        S, b = self.S, self.b
        strength, U = _eigen(S[:, :2, :2])
        right_side = np.concatenate((S, b[:, :, None]), axis=2)
        # Along the axes of what a patch tells of its displacement, its equations are one for each: of the motion, of
        # the spread, and the right side.
        back, strengths = np.swapaxes(U, 1, 2), strength.reshape(-1)
        of_motion = (back @ self._by).reshape(-1, 8)
        rows = np.empty((len(strengths), 12))
        np.multiply(of_motion, strengths[:, None], out=rows[:, :8])
        rows[:, 8:] = (back @ right_side[:, :2, 2:]).reshape(-1, 4)
        of_spread = right_side[:, 2:, 2:].reshape(-1, 12)
        normal = np.empty((11, 12))
        for _ in range(rounds):
            if np.count_nonzero(kept) < fewest:
                raise NoConsensus(f"sites: {np.count_nonzero(kept)} patches agree; need {fewest}")
            # A random displacement takes off what the patch's own says: S (1 / own + S)^-1 of it.
            weights = np.repeat(kept, 2) / (1 + own * strengths)
            weighted = rows * weights[:, None]
            normal[:8] = of_motion.T @ weighted
            normal[8:, :8] = normal[:8, 8:11].T
            normal[8:, 8:] = (kept @ of_spread).reshape(3, 4) - own * (weighted[:, 8:11].T @ rows[:, 8:])
            scale = np.sqrt(np.maximum(normal.diagonal(), 1e-30))
            scaled = normal[:, :11] / (scale[:, None] * scale)
            scaled[_OF_SPREAD, _OF_SPREAD] += _SPREAD_PRIOR
            regular, solution = cv2.solve(scaled, (normal[:, 11] / scale)[:, None], flags=cv2.DECOMP_LU)
            if not regular:
                raise DegenerateConfiguration("sites: they do not determine a homography")
            theta: Floats = solution[:, 0] / scale
            rotated = rows[:, 11] - rows[:, :11] @ theta
            along = (rotated**2 / strengths).reshape(-1, 2)
            rotated = rotated.reshape(-1, 2)
            own = _own_variance(along[kept], strength[kept], least_own, is_exact)
            kept = (along / (1 + own * strength)).sum(axis=1) < _OUTLIER
        unknown = cv2.solve(scaled[8:, 8:], scaled[8:, :8], flags=cv2.DECOMP_LU)[1]
        information = (scaled[:8, :8] - scaled[:8, 8:] @ unknown) * (scale[:8, None] * scale[:8])
        # Along an edge a patch tells nothing: no displacement is the likeliest.
        displacements = (U @ (rotated / (strength + 1 / _FARTHEST_PX**2))[:, :, None])[:, :, 0]
        scores = (U @ (rotated / (1 + own * strength))[:, :, None])[:, :, 0]
        told = (U * (strength / (1 + own * strength))[:, None]) @ np.swapaxes(U, 1, 2)
        return PatchSolution(theta, information, own, kept, displacements, told, scores)


def smooth_misfit_of(solution: PatchSolution, places: Points) -> float:
    """Return by how much patches of the same ninth of the target agree more than noise makes them: 1 by noise.

    A bent print, a lens that the camera's numbers do not describe, or a motion during the exposure of the rows.

    Parameters
    ----------
    solution : of N patches
    places : (N, 2) their centres
    """
    kept = solution.kept
    at, told = places[kept], solution.told[kept]
    low = at.min(axis=0)
    column, row = np.minimum((at - low) / (np.ptp(at, axis=0) / 3), 2).astype(np.intp).T
    information, scores = np.zeros((9, 2, 2)), np.zeros((9, 2))
    np.add.at(information, column + 3 * row, told)
    np.add.at(scores, column + 3 * row, solution.scores[kept])
    some = np.trace(information, axis1=1, axis2=2) > 0
    freedom = 2 * np.count_nonzero(some) - 8
    if freedom <= 0:
        return 1.0
    strength, U = _eigen(information[some])
    return float(((scores[some, None] @ U)[:, 0] ** 2 / strength).sum()) / freedom


def _eigen(S: Floats) -> tuple[Floats, Floats]:
    """Return eigenvalues (N, 2), a little above 0, and eigenvectors (N, 2, 2) of symmetric matrices (N, 2, 2)."""
    a, b, d = S[:, 0, 0], S[:, 0, 1], S[:, 1, 1]
    half, angle = np.hypot((a - d) / 2, b), np.arctan2(2 * b, a - d) / 2
    values = np.stack(((a + d) / 2 + half, (a + d) / 2 - half), axis=1)
    c, s = np.cos(angle), np.sin(angle)
    vectors = np.stack((c, -s, s, c), axis=1).reshape(-1, 2, 2)
    floor: Floats = _WEAKEST * values[:, :1] + 1e-12
    return np.maximum(values, floor, dtype=np.float64), vectors.astype(np.float64, copy=False)


def _own_variance(squares: Floats, strength: Floats, least: float, is_exact: bool) -> float:
    """Return the variance of the patches' own displacements that makes their mean misfit that of chi-squared.

    It is at least `least`; of exact edges less where so small a misfit would be by chance in one frame of twenty only:
    many patches tell it better than what is known beforehand.
    """
    misfits = (squares / (1 + _OWN_VARIANCES[:, None, None] * strength)).sum(axis=(1, 2))
    freedom = max(2 * len(squares) - 8, 1)
    below = np.flatnonzero(misfits <= freedom)
    own = float(_OWN_VARIANCES[below[0] if len(below) else -1])
    if is_exact and own < least:
        part = 2 / (9 * freedom)
        possible = misfits >= freedom * max(1 - part + _QUANTILE_05 * part**0.5, 0.0) ** 3
        least = min(least, float(_OWN_VARIANCES[possible].max(initial=0.0)))
    return max(own, least)


def noise_of(e: Singles, slope2: Singles, brightness: Singles, usable: Mask) -> tuple[float, float]:
    """Return variance of a bright site, and squared registration error, px^2, by robust medians.

    Parameters
    ----------
    e, slope2 : (N, S) residuals of the samples, and the squared slope of their light
    brightness, usable : (N, S) of each sample, and whether it counts

    Raises
    ------
    NoConsensus
        If no sample has more slope than the others.
    """
    some = np.flatnonzero(usable)[::_NOISE_STRIDE]
    e2, s2, light = e.ravel()[some] ** 2, slope2.ravel()[some], brightness.ravel()[some]
    steep = s2 > median_of(s2) if len(s2) else np.zeros(0, bool)
    if not steep.any():
        raise NoConsensus("sites: they do not vary as the picture does")
    noise = max(median_of(e2[~steep] / light[~steep]) * _OF_MEDIAN_SQUARE, 1e-9)
    over = (e2[steep] - np.float32(noise / _OF_MEDIAN_SQUARE) * light[steep]) / np.maximum(s2[steep], 1e-12)
    registration = max(median_of(over) * _OF_MEDIAN_SQUARE, 1e-6)
    return noise, registration


def median_of(values: Singles | Floats) -> float:
    """Return the upper median; np.median takes several times as long."""
    half = len(values) // 2
    return float(np.partition(values, half)[half])
