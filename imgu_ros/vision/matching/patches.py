# SPDX-License-Identifier: Apache-2.0
"""Comparing two image patches (IU 5.1.1 to 5.1.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats


def ssd(a: ArrayLike, b: ArrayLike) -> float:
    """Return the sum of squared differences of two patches, sum (a - b)^2 (IU 5.1.1).

    Parameters
    ----------
    a, b : of one shape, at least one pixel, any real numbers below 1e150 in magnitude

    Raises
    ------
    ShapeError
        If they are not.

    Examples
    --------
    >>> ssd([[1, 2], [3, 4]], [[1, 2], [3, 7]])
    9.0
    """
    a, b = _checked(a, b)
    return float(np.square(a - b).sum())


def zmssd(a: ArrayLike, b: ArrayLike) -> float:
    """Return the zero-mean sum of squared differences of two patches: that of the patches less their means.

    An offset of the brightness changes nothing (IU 5.1.2). The patches `a` and `b`, and errors, as `ssd`.

    Examples
    --------
    >>> zmssd([[1, 2], [3, 4]], [[11, 12], [13, 14]])
    0.0
    """
    a, b = _checked(a, b)
    return float(np.square(_without_mean(a) - _without_mean(b)).sum())


def ncc(a: ArrayLike, b: ArrayLike) -> float:
    """Return the normalised cross-correlation of two patches, from -1 to 1; 1: equal up to offset and gain.

    With standard deviations that divide by N - 1, as in IU 5.1.3, the sum lies between -(N - 1) and N - 1; here it is
    divided by N - 1 too. The patches `a` and `b` are as for `ssd`.

    Raises
    ------
    ShapeError
        If they are not, or one patch is constant: it has no contrast to be normalised.

    Examples
    --------
    >>> ncc([[1, 2], [3, 4]], [[8, 6], [4, 2]])
    -1.0
    """
    units = []
    for name, patch in zip("ab", _checked(a, b), strict=True):
        differences = _without_mean(patch)
        if not differences.any():
            raise ShapeError(f"{name}: constant; need contrast")
        # Large and small numbers alike: their squares neither overflow nor vanish.
        differences /= np.abs(differences).max()
        units.append(differences / np.linalg.norm(differences))
    return float(np.clip((units[0] * units[1]).sum(), -1.0, 1.0))


#: Squares of larger numbers overflow.
_LARGEST = 1e150


def _checked(a: ArrayLike, b: ArrayLike) -> tuple[Floats, Floats]:
    first, second = _numbers(a, "a"), _numbers(b, "b")
    if first.shape != second.shape or not first.size:
        raise ShapeError(f"b: shape {second.shape}; need that of a, {first.shape}, and at least one pixel")
    return first, second


def _numbers(patch: ArrayLike, name: str) -> Floats:
    if isinstance(patch, np.ndarray) and patch.dtype.kind not in "biuf":
        raise ShapeError(f"{name}: data type {patch.dtype}; need real numbers")
    try:
        numbers = np.asarray(patch, np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ShapeError(f"{name}: {error}; need numbers") from None
    if not (np.abs(numbers) < _LARGEST).all():
        raise ShapeError(f"{name}: NaN or numbers of {_LARGEST:g} and more; need finite numbers below")
    return numbers


def _without_mean(patch: Floats) -> Floats:
    # A mean of equal numbers may differ from them in the last digit; differences to one of them are exactly 0.
    differences = patch - patch.flat[0]
    return np.asarray(differences - differences.mean())
