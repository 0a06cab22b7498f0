# SPDX-License-Identifier: Apache-2.0
"""A small motion of the plane from displacements of its points, also of displacements measured in blurred images."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_flag, shown_value
from imgu_ros.errors import DegenerateConfiguration, NoConsensus, ShapeError
from imgu_ros.types import Floats, Mask, Matrix3, Points, as_floats, as_points

#: Iterations with Cauchy's weights, which converge to the majority from any start. Measured: benchmarks/thresholds.py,
#: study tracking.
_CAUCHY_ROUNDS = 2
#: Iterations with Tukey's weights, which are 0 for outliers. Measured: benchmarks/thresholds.py, study tracking.
_TUKEY_ROUNDS = 2
_TUKEY = 4.685  # 95 % efficient for normal errors
#: Points have unit size: a larger parameter is the noise of an undetermined one.
_LARGEST_MOTION = 1e3
#: Determinant of a motion below which it squeezes the plane to a line.
_LEAST_DETERMINANT = 1e-9
#: Limits of displacements and deviations: their squares are finite and normal floats.
_LARGEST_PX = 1e12
#: Smaller extents and deviations are rounding, px.
_SMALLEST_PX = 1e-9
_RAYLEIGH_MEDIAN = 1.1774  # in sigmas of one coordinate
#: RMS motion, px, that weighs as much as the prior assumption that nothing is blurred. Measured:
#: benchmarks/thresholds.py, study blur.
_ASSUMED_PX = 0.1
#: RMS motions, px, from which a gain is learned: Lucas-Kanade is not linear for longer ones, and shorter ones are
#: noise. Measured: benchmarks/thresholds.py, study blur.
_LONGEST_PX, _SHORTEST_PX = 1.5, 0.03
#: Limits of the singular values of a gain. Measured: benchmarks/thresholds.py, study blur.
_WEAKEST, _STRONGEST = 0.2, 1.5
#: Largest displacements from which a gain is learned.
_LARGEST_LEARNED_PX = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """A motion of the plane.

    Attributes
    ----------
    parameters : (8,) of the homography I + [[p0 p1 p2] [p3 p4 p5] [p6 p7 0]] of the normalised points
    agreeing : (N,) inliers: displacements of non-zero weight
    sigma_px : robust standard deviation of one coordinate
    largest_px : largest change of a coordinate of the points, in absolute value
    """

    parameters: Floats
    agreeing: Mask
    sigma_px: float
    largest_px: float


class PlaneMotion:
    """Fits motions to displacements of a fixed set of points.

    To first order a homography I + D moves x by a linear function of D (IU 6.5): eight numbers, or six for an
    affine map.

    Parameters
    ----------
    points : (N, 2) px
    affine : without the two projective parameters

    Attributes
    ----------
    points : (N, 2) px, as given
    unit_px : length of a unit of the normalised points
    normalised : (3, 3) normalised points from px
    back : (3, 3) px from normalised points, the inverse of `normalised`
    by_parameters : (N, 2, 8), or (N, 2, 6) if affine: derivative of the normalised points' displacements

    Raises
    ------
    DegenerateConfiguration
        If all points coincide.

    Examples
    --------
    Four corners of a square and its middle grow by a tenth, one of them is wrong:

    >>> points = np.array([[0, 0], [100, 0], [100, 100], [0, 100], [50, 50], [20, 70]])
    >>> displacements = 0.1 * (points - 50)
    >>> displacements[4] = 9
    >>> motions = PlaneMotion(points, affine=True)
    >>> motion = motions.fit(displacements, np.ones(6, bool))
    >>> (motions.matrix(motion.parameters).round(3) + 0.0).tolist()[0], motion.agreeing.tolist()
    ([1.1, 0.0, -5.0], [True, True, True, True, False, True])
    """

    def __init__(self, points: ArrayLike, affine: bool = False) -> None:
        affine = as_flag(affine, "affine")
        points = as_points(points, "points", 1)
        if not np.abs(points).max() < _LARGEST_PX:
            raise ShapeError(f"points: up to {np.abs(points).max():g}; need less than {_LARGEST_PX:g} px")
        self._prepare(points, affine)

    @classmethod
    def unchecked(cls, points: Points, affine: bool) -> PlaneMotion:
        """Return the same for points that need no checks of type, shape and size."""
        motion = cls.__new__(cls)
        motion._prepare(points, affine)
        return motion

    def _prepare(self, points: Points, affine: bool) -> None:
        self.points = points
        centre = points.mean(axis=0)
        self.unit_px = float(np.sqrt(((points - centre) ** 2).mean()))
        if not self.unit_px > _SMALLEST_PX:
            raise DegenerateConfiguration("points: they coincide; need points that span the plane")
        x, y = ((points - centre) / self.unit_px).T
        self.normalised = np.array([[1, 0, -centre[0]], [0, 1, -centre[1]], [0, 0, self.unit_px]]) / self.unit_px
        self.back = np.array([[self.unit_px, 0, centre[0]], [0, self.unit_px, centre[1]], [0, 0, 1]])
        by = np.zeros((len(points), 2, 6 if affine else 8))
        by[:, 0, 0] = by[:, 1, 3] = x
        by[:, 0, 1] = by[:, 1, 4] = y
        by[:, 0, 2] = by[:, 1, 5] = 1
        if not affine:
            by[:, 0, 6], by[:, 0, 7] = -x * x, -x * y
            by[:, 1, 6], by[:, 1, 7] = -x * y, -y * y
        self.by_parameters = by
        # J^T J of each point: their weighted sum is one product of a vector and a matrix.
        self._products = np.einsum("nip,niq->npq", by, by).reshape(len(points), -1)

    def fit(self, displacements: Points, usable: Mask, floor_px: float = 0.01, before: Motion | None = None) -> Motion:
        """Fit the motion that the majority of the displacements agrees with.

        Parameters
        ----------
        displacements : (N, 2) px, of all points or of the first N
        usable : (N,) bool, displacements that are used
        floor_px : least standard deviation of a coordinate, > 0
        before : motion fitted before to nearly the same displacements, or to the first of them: its inliers are a
            start that saves iterations

        Raises
        ------
        NoConsensus
            If too few are usable, or they do not determine a motion.
        ShapeError
            If an argument has another shape, type or range.
        """
        displacements = as_floats(displacements, "displacements")
        count = len(displacements) if displacements.ndim else 0
        if count > len(self.by_parameters) or displacements.shape != (count, 2):
            raise ShapeError(
                f"displacements: shape {displacements.shape}; need (N, 2), N up to {len(self.by_parameters)}"
            )
        if not isinstance(usable, np.ndarray) or usable.dtype != np.bool_ or usable.shape != (count,):
            raise ShapeError(f"usable: {getattr(usable, 'shape', type(usable).__name__)}; need ({count},) of bool")
        if count and not np.abs(displacements).max() < _LARGEST_PX:
            raise ShapeError(f"displacements: not finite, or too large; need less than {_LARGEST_PX:g} px")
        if not (isinstance(floor_px, float | int) and _SMALLEST_PX <= floor_px <= _LARGEST_PX):
            raise ShapeError(f"floor_px: {shown_value(floor_px)}; need {_SMALLEST_PX:g} to {_LARGEST_PX:g}")
        if not isinstance(before, Motion | None):
            raise ShapeError(f"before: {shown_value(before)}; need a Motion, or None")
        return self.fit_unchecked(displacements, usable, floor_px, before)

    def fit_unchecked(
        self, displacements: Points, usable: Mask, floor_px: float = 0.01, before: Motion | None = None
    ) -> Motion:
        """`fit` without the checks of its arguments."""
        count, parameters = len(displacements), self.by_parameters.shape[2]
        used = int(np.count_nonzero(usable))
        if 2 * used < parameters + 4:
            raise NoConsensus(f"displacements: {used} usable; need {parameters // 2 + 2}")
        moved = displacements / self.unit_px
        rows, products = self.by_parameters[:count].reshape(-1, parameters), self._products[:count]
        floor = floor_px / self.unit_px
        weights = usable.astype(np.float64)
        cauchy_rounds, rounds = _CAUCHY_ROUNDS, _CAUCHY_ROUNDS + _TUKEY_ROUNDS
        if before is not None:
            rounds = _TUKEY_ROUNDS
            cauchy_rounds = 1
            if len(before.agreeing) == count and 2 * np.count_nonzero(before.agreeing & usable) >= parameters + 4:
                weights *= before.agreeing
                cauchy_rounds, rounds = 0, 1
        motion: Floats = np.zeros(parameters)
        moving, sigma = np.zeros((count, 2)), floor
        for turn in range(rounds):
            normal = (weights @ products).reshape(parameters, parameters)
            right = (weights[:, None] * moved).ravel() @ rows
            # For a few rows, OpenCV is three times as fast as NumPy.
            regular, solution = cv2.solve(normal, right[:, None], flags=cv2.DECOMP_CHOLESKY)
            # The points have unit size: a larger solution is the noise of undetermined parameters.
            if not regular or not np.abs(solution).max() < _LARGEST_MOTION:
                raise NoConsensus("displacements: they do not determine a motion; need points that span the plane")
            motion = np.asarray(solution[:, 0], np.float64)
            moving = (rows @ motion).reshape(count, 2)
            away = moved - moving
            away *= away
            squared = away[:, 0] + away[:, 1]
            # The median distance; np.median takes ten times as long.
            of_used = squared if used == count else squared[usable]
            sigma = max(math.sqrt(float(np.partition(of_used, used // 2)[used // 2])) / _RAYLEIGH_MEDIAN, floor)
            if turn < cauchy_rounds:
                weights = usable / (1 + squared / (2 * sigma) ** 2)
            else:
                weights = np.maximum(1 - squared / (_TUKEY * sigma) ** 2, 0)
                weights *= weights
                weights *= usable
        largest = float(np.abs(moving).max()) * self.unit_px
        all_eight = np.zeros(8)
        all_eight[:parameters] = motion
        return Motion(all_eight, weights > 0, sigma * self.unit_px, largest)

    def displacements(self, motion: Motion, first: int) -> Points:
        """Return the displacements of the `first` points by a `motion`, (N, 2) px."""
        parameters = self.by_parameters.shape[2]
        rows = self.by_parameters[:first].reshape(-1, parameters)
        return np.asarray((rows @ motion.parameters[:parameters]).reshape(first, 2) * self.unit_px)

    def matrix(self, motion: Floats) -> Matrix3:
        """Return the homography (3, 3), in px, of a motion's parameters, (8,).

        Raises
        ------
        ShapeError
            If they are not eight finite numbers, or too large.
        """
        a, b, c, d, e, f, g, h = _parameters(motion).tolist()
        return np.asarray(self.back @ [[1 + a, b, c], [d, 1 + e, f], [g, h, 1]] @ self.normalised)

    def inverse(self, motion: Floats) -> Matrix3:
        """Return the homography (3, 3), in px, of the inverse of a motion.

        Raises
        ------
        ShapeError
            As for `matrix`.
        DegenerateConfiguration
            If the motion maps the plane to a line or mirrors it.
        """
        return self.inverse_unchecked(_parameters(motion))

    def inverse_unchecked(self, motion: Floats) -> Matrix3:
        """`inverse` without the checks of its argument."""
        a, b, c, d, e, f, g, h = motion.tolist()
        a, e = a + 1, e + 1
        if not a * (e - f * h) - b * (d - f * g) + c * (d * h - e * g) > _LEAST_DETERMINANT:
            raise DegenerateConfiguration("motion: it maps the plane to a line or mirrors it; need a small motion")
        # A homography has no scale: its adjugate is its inverse.
        adjugate = [
            [e - f * h, c * h - b, b * f - c * e],
            [f * g - d, a - c * g, c * d - a * f],
            [d * h - e * g, b * g - a * h, a * e - b * d],
        ]
        return np.asarray(self.back @ adjugate @ self.normalised)


class BlurGain:
    """The linear map (2, 2) from true displacements of patches to measured ones; the identity until motions are known.

    In an image that is less sharp than the patches, Lucas-Kanade measures displacements that are too short, most of all
    along the blur. A known motion between two measurements shows by how much.

    Attributes
    ----------
    matrix : (2, 2)
    weakest : its smaller singular value, below 1 in blurred images
    """

    def __init__(self) -> None:
        self.matrix: Floats = np.eye(2)
        self.weakest = 1.0
        self._inverse: Floats = self.matrix
        self._products: Floats = np.zeros((2, 2))
        self._squares: Floats = self._products
        self._count = 0

    def corrected(self, measured: ArrayLike) -> Points:
        """Return the true displacements (N, 2) of measured ones, (N, 2)."""
        return self.corrected_unchecked(_plain(measured, "measured"))

    def corrected_unchecked(self, measured: Points) -> Points:
        """`corrected` without the checks of its argument."""
        return measured if self._count == 0 else np.asarray(measured @ self._inverse.T)

    def learn(self, applied: ArrayLike, change: ArrayLike) -> None:
        """Learn from the change of displacements by a known motion.

        Parameters
        ----------
        applied : (N, 2) px, by which the patches were moved
        change : (N, 2) px, by which their measured displacements became smaller

        Raises
        ------
        ShapeError
            If they are not as many, or no displacements in an image.
        """
        applied, change = _plain(applied, "applied"), _plain(change, "change")
        if applied.shape != change.shape:
            raise ShapeError(f"change: shape {change.shape}; need {applied.shape}")
        self.learn_unchecked(applied, change)

    def learn_unchecked(self, applied: Points, change: Points) -> None:
        """`learn` without the checks of its arguments."""
        count = len(applied)
        squares = applied.T @ applied
        total = float(squares[0, 0] + squares[1, 1])
        if not _SHORTEST_PX**2 * count < total <= 2 * _LONGEST_PX**2 * count:
            return
        self._products = self._products + change.T @ applied
        self._squares = self._squares + squares
        self._count = max(self._count, count)
        assumed = self._count * _ASSUMED_PX**2
        (a, b), (c, d) = self._products.tolist()
        (p, q), (_, r) = self._squares.tolist()
        a, d, p, r = a + assumed, d + assumed, p + assumed, r + assumed
        det = p * r - q * q
        gain = np.array([[a * r - b * q, b * p - a * q], [c * r - d * q, d * p - c * q]]) / det
        # Its singular values.
        (a, b), (c, d) = gain.tolist()
        half, product = (a * a + b * b + c * c + d * d) / 2, abs(a * d - b * c)
        strongest = math.sqrt(half + math.sqrt(max(half * half - product * product, 0.0)))
        self.weakest = product / strongest if strongest > 0 else 0.0
        if self.weakest < _WEAKEST or strongest > _STRONGEST:
            U, strengths, Vt = np.linalg.svd(gain)
            gain = (U * np.clip(strengths, _WEAKEST, _STRONGEST)) @ Vt
            self.weakest = max(self.weakest, _WEAKEST)
            (a, b), (c, d) = gain.tolist()
        self.matrix = gain
        self._inverse = np.array([[d, -b], [-c, a]]) / (a * d - b * c)


def _plain(displacements: ArrayLike, name: str) -> Points:
    displacements = as_points(displacements, name)
    if displacements.size and not np.abs(displacements).max() < _LARGEST_LEARNED_PX:
        largest = np.abs(displacements).max()
        raise ShapeError(f"{name}: up to {largest:g}; need less than {_LARGEST_LEARNED_PX:g} px")
    return displacements


def _parameters(motion: Floats) -> Floats:
    motion = as_floats(motion, "motion")
    if motion.shape != (8,) or not np.abs(motion).max() < _LARGEST_PX:
        raise ShapeError(f"motion: shape {motion.shape}; need (8,), less than {_LARGEST_PX:g}")
    return motion
