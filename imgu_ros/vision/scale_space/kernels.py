# SPDX-License-Identifier: Apache-2.0
"""One-dimensional Gaussian kernels: sampled and discrete (IU 3.3.1, 3.3.2; Lindeberg 1990)."""

from __future__ import annotations

import math

import numpy as np

from imgu_ros.arguments import as_integer, as_number
from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats

_MAX_SIGMA_PX = 1000.0
_MAX_REACH_PX = 20_000


def sampled_gaussian(sigma: float, reach: int | None = None) -> Floats:
    """Return the Gaussian's values at the pixels, normalised to sum 1.

    Parameters
    ----------
    sigma : px, 0 to 1000
    reach : px on each side, 0 to 20000; None: 4 sigma, beyond which lies 6e-5

    Returns
    -------
    (2 reach + 1,)

    Raises
    ------
    ShapeError
        If sigma or the reach lies outside its range.

    Notes
    -----
    Source: IU 3.3.1. Its variance is sigma^2 to 1e-4 from sigma 0.8 on, and falls short below.

    Examples
    --------
    >>> sampled_gaussian(1.0, 2).round(4).tolist()
    [0.0545, 0.2442, 0.4026, 0.2442, 0.0545]
    """
    sigma = as_number(sigma, "sigma")
    reach = None if reach is None else as_integer(reach, "reach")
    _check(sigma, reach)
    reach = math.ceil(4 * sigma) if reach is None else int(reach)
    if sigma < 1e-3:
        return _one(reach)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    return np.asarray(weights / weights.sum())


def discrete_gaussian(sigma: float, reach: int | None = None) -> Floats:
    """Return the discrete analogue of the Gaussian, T(n, t) = exp(-t) I_n(t) with t = sigma^2.

    It alone makes a true scale space of pixels: T(., s) * T(., t) = T(., s + t) exactly, its variance is sigma^2
    exactly, and smoothing never makes a new extremum, at any sigma.

    Parameters
    ----------
    sigma : px, 0 to 1000
    reach : px on each side, 0 to 20000; None: so far that less than 1e-16 lies beyond

    Returns
    -------
    (2 reach + 1,), not normalised: what its sum lacks to 1 lies beyond the reach.

    Raises
    ------
    ShapeError
        If sigma or the reach lies outside its range.

    Notes
    -----
    Source: Lindeberg 1990, "Scale-space for discrete signals", equation 21; IU 3.3.2. I_n is the modified Bessel
    function of the first kind.

    Examples
    --------
    >>> discrete_gaussian(1.0, 2).round(4).tolist()
    [0.0499, 0.2079, 0.4658, 0.2079, 0.0499]
    """
    sigma = as_number(sigma, "sigma")
    reach = None if reach is None else as_integer(reach, "reach")
    _check(sigma, reach)
    # Chernoff's bound of a difference of two Poisson variables: far out the tail falls faster than exponentially.
    reach = math.ceil(9 * sigma + 20) if reach is None else int(reach)
    variance = sigma * sigma
    if variance == 0:
        return _one(reach)
    from scipy.special import ive  # takes a tenth of a second to import, and few need it

    half = ive(np.arange(reach + 1, dtype=np.float64), variance)
    return np.concatenate([half[:0:-1], half])


def discrete_reach(sigma: float, missing: float) -> int:
    """Return the least reach beyond which the discrete kernel holds at most `missing`, px.

    Parameters
    ----------
    sigma : px, 0 to 1000
    missing : share beyond the reach, 1e-12 to 1

    Raises
    ------
    ShapeError
        If a number lies outside its range.

    Examples
    --------
    >>> discrete_reach(1.0, 1e-3)
    4
    """
    sigma = as_number(sigma, "sigma")
    missing = as_number(missing, "missing")
    if not 1e-12 <= missing <= 1:
        raise ShapeError(f"missing: {missing!r}; need 1e-12 to 1")
    weights = discrete_gaussian(sigma)
    half = weights[len(weights) // 2 :]
    beyond = 2 * np.cumsum(half[::-1])[::-1] - 2 * half
    return int(np.argmax(beyond <= missing))


def _one(reach: int) -> Floats:
    weights = np.zeros(2 * reach + 1)
    weights[reach] = 1
    return weights


def _check(sigma: float, reach: int | None) -> None:
    if not 0 <= sigma <= _MAX_SIGMA_PX:
        raise ShapeError(f"sigma: {sigma!r}; need 0 to {_MAX_SIGMA_PX:g} px")
    if reach is not None and (not isinstance(reach, int | np.integer) or not 0 <= reach <= _MAX_REACH_PX):
        raise ShapeError(f"reach: {reach!r}; need an integer, 0 to {_MAX_REACH_PX} px")
