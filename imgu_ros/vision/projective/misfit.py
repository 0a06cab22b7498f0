# SPDX-License-Identifier: Apache-2.0
"""Whether residuals look like noise, or like something that the model does not know."""

from __future__ import annotations

import math

import numpy as np

from imgu_ros.arguments import shown_value
from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Mask, Points, as_floats, as_points

#: Cells across and down: means over fewer miss a bend, over more they drown in noise. Measured:
#: benchmarks/thresholds.py, study covariance.
_CELLS = 3
_NUMBERS = np.arange(_CELLS * _CELLS)[:, None]
#: What is larger is told as this.
_LARGEST = 1e12


def smooth_misfit(
    points: Points, residuals: Points, used: Mask, variance: float, correlation: Floats | None = None, fitted: int = 8
) -> float:
    """Return how much the residuals' means over ninths of the plane exceed those of noise: 1 on average if they do not.

    A lens that distorts, a rolling shutter or a bent plane leave residuals that neighbours share.

    Parameters
    ----------
    points : (N, 2) in the plane
    residuals : (N, 2)
    used : (N,) bool, those that the model was fitted to
    variance : of one coordinate of a residual
    correlation : (N, N) of the errors of different points; None: independent
    fitted : parameters of the model

    Returns
    -------
    The sum of the squared means, each in units of its variance, over its degrees of freedom; 1 where there are too few
    ninths with points in them to tell, or no residuals.

    Raises
    ------
    ShapeError
        If the arrays do not fit each other.

    Examples
    --------
    >>> points = np.array([[x, y] for y in range(12) for x in range(12)], float)
    >>> used = np.ones(144, bool)
    >>> noise = np.random.default_rng(0).normal(size=(144, 2))
    >>> bent = noise + np.cos(points / 2)
    >>> smooth_misfit(points, noise, used, 1.0, fitted=0) < 2, smooth_misfit(points, bent, used, 1.0, fitted=0) > 4
    (True, True)
    """
    if not isinstance(variance, float | int) or not isinstance(fitted, int):
        raise ShapeError(
            f"variance, fitted: {shown_value(variance)}, {shown_value(fitted)}; need a number and an integer"
        )
    points, residuals = as_points(points, "points"), as_points(residuals, "residuals")
    try:
        used = np.asarray(used)
    except ValueError as error:
        raise ShapeError(f"used: {error}; need {len(points)} bool") from None
    if residuals.shape != points.shape or used.shape != points.shape[:1] or used.dtype != bool:
        raise ShapeError(
            f"residuals, used: shapes {residuals.shape}, {used.shape}; need {points.shape} and bool for it"
        )
    if not variance > 0 or not used.any():
        return 1.0
    # Ninths of the rectangle that holds all points: those not in use leave theirs as they are.
    low = points.min(axis=0)
    third = np.maximum((points.max(axis=0) - low) / _CELLS, 1e-300)
    column, row = np.minimum((points - low) / third, _CELLS - 0.5).astype(np.intp).T
    cells = np.where(used, column + _CELLS * row, -1)
    members = (cells == _NUMBERS).astype(np.float64)
    shared = members.sum(axis=1)
    if not shared.all():
        members, shared = members[shared > 0], shared[shared > 0]
    freedom = 2 * len(members) - fitted
    if freedom <= 0:
        return 1.0
    sums = members @ residuals
    if correlation is not None:
        correlation = as_floats(correlation, "correlation")
        if correlation.shape != (len(points),) * 2:
            raise ShapeError(f"correlation: shape {correlation.shape}; need {(len(points),) * 2}")
        shared = np.einsum("gi,gi->g", members @ correlation, members)
        # Errors that cancel each other (a negative correlation) tell nothing of what neighbours share.
        shared = np.maximum(shared, 1e-300)
    scaled = sums / np.sqrt(shared * variance)[:, None]
    squared = float(np.vdot(scaled, scaled)) / freedom
    return min(squared, _LARGEST) if math.isfinite(squared) else _LARGEST
