# SPDX-License-Identifier: Apache-2.0
"""Straight lines a x + b y + c = 0: through points by total least squares, or by consensus (IU 7.1, 7.5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import DegenerateConfiguration, ShapeError, TooFewPoints
from imgu_ros.types import Floats, Indices, Mask, Points, as_matrix, as_points
from imgu_ros.vision.estimation.chance import shares_of_places

#: Squares of larger numbers, summed, overflow.
_LARGEST = 1e100
#: Difference of the variances along and across the line, as a share of their sum, below which there is no line.
_ROUND = 1e-12
#: Points beside a line that tell how many lie near it by chance.
_ENOUGH_BESIDE = 3


@dataclass(frozen=True, slots=True, eq=False)
class LineEstimate:
    """An estimated line.

    Attributes
    ----------
    line : (3,) a, b, c with a^2 + b^2 = 1; the larger of a and b is positive
    covariance : (3, 3) of it, rank 2
    rms : root mean square distance of the points
    """

    line: Floats
    covariance: Floats
    rms: float


def fit_line(points: ArrayLike, weights: ArrayLike | None = None) -> LineEstimate:
    """Fit the line with the least sum of squared distances; vertical ones are lines like any other.

    Total least squares: the normal is the points' direction of least variance.

    Parameters
    ----------
    points : (N, 2), N >= 2
    weights : (N,) >= 0, of the squared distances; None: all 1. Where a point of weight 0 lies changes nothing

    Returns
    -------
    With the covariance of independent errors, equal in x and y, to first order; their variance from the residuals,
    so 0 where the points are two.

    Raises
    ------
    TooFewPoints
        If there are fewer than two points (of weight above 0).
    DegenerateConfiguration
        If they coincide, or spread equally in all directions.
    ShapeError
        If a number is not finite or too large, or a weight negative.

    Examples
    --------
    >>> fit_line([[3, 0], [3, 5], [3, 9]]).line.round(9).tolist()  # x = 3
    [1.0, 0.0, -3.0]
    """
    points = _checked(points)
    w = np.ones(len(points)) if weights is None else as_matrix(weights, (len(points),), "weights")
    if w.min() < 0 or not 0 < w.max() < _LARGEST:
        raise ShapeError("weights: negative, too large, or all 0; need numbers >= 0, some of them > 0")
    points, w = points[w > 0], w[w > 0] / w.max()
    if len(points) < 2:
        raise TooFewPoints(f"weights: {len(points)} above 0; need at least 2")
    total = float(w.sum())
    centroid = w @ points / total
    unit = float(np.sqrt(w @ ((points - centroid) ** 2).sum(axis=1) / total))
    if not unit > 1e-100:
        raise DegenerateConfiguration(f"points: all {len(points)} coincide; need two that differ")
    away = (points - centroid) / unit
    variances, vectors = np.linalg.eigh((w[:, None] * away).T @ away / total)
    gap = float(variances[1] - variances[0])
    if not gap > _ROUND * float(variances.sum()):
        raise DegenerateConfiguration("points: as wide as long; need points that spread along a line")
    normal = vectors[:, 0] * (1 if vectors[np.argmax(np.abs(vectors[:, 0])), 0] > 0 else -1)
    distance = away @ normal
    # The angle turns about the centroid; the offset moves the centroid: to first order they are independent.
    variance = float((w * distance**2).sum()) / max(len(points) - 2, 1)
    along = np.array([-normal[1], normal[0]])
    by_angle = np.append(along, -along @ centroid)
    by_offset = np.array([0.0, 0.0, -1.0])
    covariance = variance * (
        np.outer(by_angle, by_angle) / (total * gap) + unit**2 * np.outer(by_offset, by_offset) / total
    )
    line = np.append(normal, -normal @ centroid)
    return LineEstimate(line, covariance, unit * float(np.sqrt((w * distance**2).sum() / total)))


class LineModel:
    """The model of `ransac` for lines: hypotheses are (B, 3), a x + b y + c = 0 with a^2 + b^2 = 1; errors distances.

    Parameters
    ----------
    points : (N, 2)

    Raises
    ------
    ShapeError
        If a number is not finite or too large.
    TooFewPoints
        If there are fewer than two points.
    """

    sample_size = 2
    codimension = 1

    def __init__(self, points: ArrayLike) -> None:
        self.points = _checked(points)

    @property
    def count(self) -> int:
        """Number of points."""
        return len(self.points)

    def generate(self, samples: Indices) -> Floats:
        """Return the lines (B', 3) through pairs (B, 2); coinciding points give none."""
        p, q = self.points[samples[:, 0]], self.points[samples[:, 1]]
        normal = np.column_stack((p[:, 1] - q[:, 1], q[:, 0] - p[:, 0]))
        length = np.hypot(*normal.T)
        apart = length > 0
        normal = normal[apart] / length[apart, None]
        return np.column_stack((normal, -np.einsum("bi,bi->b", normal, p[apart])))

    def squared_errors(self, hypotheses: Floats) -> Floats:
        """Return the squared distances, (B, N)."""
        return np.asarray((hypotheses[:, :2] @ self.points.T + hypotheses[:, 2:]) ** 2, np.float64)

    def refit(self, hypothesis: Floats, inliers: Mask) -> Floats:
        """Return the total least squares line of the inliers."""
        del hypothesis
        return fit_line(self.points[inliers]).line

    def shares(self, threshold: float) -> Floats:
        """Return what each point counts, (N,): 1 / number of those within a quarter of the threshold.

        No hypothesis maps all points onto one place, so that what is near each other need not count as one.
        """
        return shares_of_places(self.points, threshold / 4)

    def agreement_probability(self, hypothesis: Floats, threshold: float) -> float:
        """Return the probability that a point of another line is within the threshold, as those beside the line tell.

        Where there are few of those, as points that spread across the line as far as the agreeing ones do along it.
        """
        across = np.abs(self.points @ hypothesis[:2] + hypothesis[2])
        along = self.points[across <= threshold] @ np.array([-hypothesis[1], hypothesis[0]])
        reach = max(float(np.ptp(along)) / 2, threshold) if len(along) else threshold
        beside = np.sort(across[(across > threshold) & (across <= reach)])
        probability = threshold / reach
        if len(beside) >= _ENOUGH_BESIDE:
            # The nearer half of those beside: what spreads along a line is not as likely near it as far from it.
            strip = max(float(beside[len(beside) // 2]) - threshold, threshold)
            probability = max(probability, (len(beside) // 2 + 1) / len(self.points) * threshold / strip)
        return min(1.0, probability)


def _checked(points: ArrayLike) -> Points:
    points = as_points(points)
    if len(points) < 2:
        raise TooFewPoints(f"points: {len(points)}; need at least 2")
    if not np.abs(points).max() < _LARGEST:
        raise ShapeError(f"points: up to {np.abs(points).max():g}; need less than {_LARGEST:g}")
    return points
