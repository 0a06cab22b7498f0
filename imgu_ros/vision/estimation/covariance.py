# SPDX-License-Identifier: Apache-2.0
"""The covariance of a least-squares estimate, by propagation (HZ section 5.2, result 5.11)."""

from __future__ import annotations

import math

import numpy as np

from imgu_ros.arguments import as_number, require_type
from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.types import Floats, as_matrix, as_points
from imgu_ros.vision.estimation.nonlinear import Minimum

#: Correlations are -1 to 1, save for rounding.
_LARGEST = 1.001
#: Range of squared thresholds, in units of 2 sigma^2, in which an efficiency is searched: 99 % and none of the data
#: beyond.
_FULLEST_U, _EMPTIEST_U = 0.01, 100.0
#: Smallest efficiency returned: of a threshold far below the noise, residuals say little.
_LEAST_EFFICIENCY = 0.3
#: Squares of such numbers are finite.
_PLAIN = 1e150


def propagated_covariance(minimum: Minimum, noise: float | None = None, correlation: Floats | None = None) -> Floats:
    """Return the covariance of the parameters at a minimum, (P, P).

    With errors of standard deviation sigma and correlation C between measurements it is
    sigma^2 (J^T J)^-1 J^T C J (J^T J)^-1, which for independent errors is sigma^2 (J^T J)^-1.

    Parameters
    ----------
    minimum : a plain least-squares minimum of N measurements of D coordinates
    noise : sigma of one residual; None: from the residuals, divided by the degrees of freedom that the fit left
    correlation : (N, N) correlation of the measurements' errors, the same for every coordinate; None: independent

    Raises
    ------
    DegenerateConfiguration
        If the measurements do not determine the parameters.
    ShapeError
        If the correlation is not (N, N).
    """
    require_type(minimum, Minimum, "minimum")
    noise = None if noise is None else as_number(noise, "noise")
    jacobian, residuals = minimum.linearisation.jacobian, minimum.linearisation.residuals
    count, _, parameters = jacobian.shape
    normal = minimum.normal_matrix
    inverse = _inverse(normal)
    taken = float(parameters)
    if correlation is not None:
        correlation = as_matrix(correlation, (count, count), "correlation")
        if not np.abs(correlation).max() <= _LARGEST:
            raise ShapeError(f"correlation: up to {np.abs(correlation).max():g}; need -1 to 1")
        middle = np.einsum("ndp,ndq->pq", jacobian, np.tensordot(correlation, jacobian, 1))
        # Correlated errors are followed by the fit more closely: trace(P C) degrees of freedom instead of P.
        taken = float(np.trace(inverse @ middle))
        inverse = inverse @ middle @ inverse
    if noise is not None and not 0 <= noise < 1e100:
        raise ShapeError(f"noise: {noise!r}; need a standard deviation")
    if noise is None:
        # A correspondence is worth two coordinates, also where symmetric residuals (D = 4) say them twice:
        # the sum of squares and the normal matrix are then both doubled, and the covariance comes out right.
        freedom = max(2 * count - taken, 1.0)
        noise = float(np.sqrt((residuals**2).sum() / freedom))
    return noise**2 * (inverse + inverse.T) / 2


def window_correlation(xy: Floats, side: float) -> Floats:
    """Return the correlation of errors of patches that share pixels, (N, N): the share of a window that overlaps.

    Parameters
    ----------
    xy : (N, 2) px, centres of square windows
    side : px, of the windows
    """
    side = as_number(side, "side")
    xy = as_points(xy, "xy")
    if not 0 < side < np.inf or (xy.size and not np.abs(xy).max() < 1e100):
        raise ShapeError(f"side, xy: {side!r}; need places in a picture, and a side above 0")
    x, y = (np.maximum(1 - np.abs(np.subtract.outer(c, c)) / side, 0) for c in np.ascontiguousarray(xy.T))
    return np.asarray(x * y, np.float64)


def selection_efficiency(mean_square: float, threshold: float) -> float:
    """Return how certain a fit to the errors within a threshold is, beside what its residuals tell, 0.3 to 1.

    The covariance from the residuals is to be divided by its square. Of plane Gaussian errors of variance
    sigma^2, those within t have the variance k sigma^2, with k = 1 - u e^-u / (1 - e^-u) and u = t^2 / (2 sigma^2).
    As points enter and leave with the fit, it is less certain by k again (the asymptotic variance of a skipped mean:
    Huber 1981, section 3.2). Errors that fill the circle tell nothing of sigma: below 0.3 it stays 0.3.

    Parameters
    ----------
    mean_square : of the lengths of the errors within the threshold, after the fit's degrees of freedom
    threshold : > 0

    Raises
    ------
    ShapeError
        If the mean square is negative or no number, or the threshold not positive.

    Examples
    --------
    >>> round(selection_efficiency(1.9, 3.0), 2)  # sigma 1, threshold 3: a hundredth of the errors are beyond
    0.95
    """
    mean_square, threshold = as_number(mean_square, "mean_square"), as_number(threshold, "threshold")
    if not (0 <= mean_square < _PLAIN and 1 / _PLAIN < threshold < _PLAIN):
        raise ShapeError(f"mean_square, threshold: {mean_square!r}, {threshold!r}; need >= 0 and > 0")
    wanted = mean_square / threshold**2
    low, high = _FULLEST_U, _EMPTIEST_U
    if wanted <= _kept_variance(high) / high:
        return 1.0
    for _ in range(40):
        u = math.sqrt(low * high)
        low, high = (u, high) if _kept_variance(u) / u > wanted else (low, u)
    return max(_kept_variance(low), _LEAST_EFFICIENCY)


def _kept_variance(u: float) -> float:
    return 1 - u * math.exp(-u) / -math.expm1(-u)


def _inverse(normal: Floats) -> Floats:
    scale = np.sqrt(np.diag(normal))
    if not (np.isfinite(scale).all() and (scale > 0).all()):
        raise DegenerateConfiguration("covariance: a parameter has no effect on the measurements; need more of them")
    try:
        return np.asarray(np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale), np.float64)
    except np.linalg.LinAlgError:
        raise DegenerateConfiguration("covariance: the measurements do not determine the parameters") from None
