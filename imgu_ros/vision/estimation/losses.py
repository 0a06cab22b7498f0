# SPDX-License-Identifier: Apache-2.0
"""Robust losses: how much a measurement's residual costs, and with what weight it counts (IU 7.5; HZ appendix 6.8).

A loss takes the squared lengths of residuals and gives weights and costs. Near zero every loss is the square itself,
with weight 1; iteratively reweighted least squares with these weights minimises the sum of the costs.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from imgu_ros.arguments import as_number
from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats

#: A robust loss: weight (N,) and cost (N,) of the measurements' squared lengths (N,).
Loss = Callable[[Floats], tuple[Floats, Floats]]

#: Squares of larger numbers overflow.
_LARGEST = 1e150


def huber(scale: float) -> Loss:
    """Return Huber's loss: quadratic to `scale`, linear beyond (Huber 1964). Convex: no new local minima.

    Raises
    ------
    ShapeError
        If the scale is not a positive number of plain size.

    Examples
    --------
    >>> weight, cost = huber(1.0)(np.array([0.25, 4.0]))
    >>> weight.tolist(), cost.tolist()
    ([1.0, 0.5], [0.25, 3.0])
    """
    scale = as_number(scale, "scale")
    scale = _checked(scale)

    def loss(squared: Floats) -> tuple[Floats, Floats]:
        length = np.sqrt(squared)
        far = length > scale
        safe = np.where(far, length, 1.0)
        return np.where(far, scale / safe, 1.0), np.where(far, 2 * scale * length - scale**2, squared)

    return loss


def cauchy(scale: float) -> Loss:
    """Return Cauchy's loss, scale^2 log(1 + r^2 / scale^2): an outlier's pull falls off as 1 / r.

    Raises
    ------
    ShapeError
        If the scale is not a positive number of plain size.

    Examples
    --------
    >>> weight, cost = cauchy(1.0)(np.array([0.0, 1.0]))
    >>> weight.tolist(), cost.round(6).tolist()
    ([1.0, 0.5], [0.0, 0.693147])
    """
    scale = as_number(scale, "scale")
    scale = _checked(scale)

    def loss(squared: Floats) -> tuple[Floats, Floats]:
        share = np.minimum(squared / scale**2, _LARGEST**2)
        return 1 / (1 + share), scale**2 * np.log1p(share)

    return loss


def tukey(scale: float) -> Loss:
    """Return Tukey's biweight: beyond `scale` a measurement has no pull at all (Beaton & Tukey 1974).

    Raises
    ------
    ShapeError
        If the scale is not a positive number of plain size.

    Examples
    --------
    >>> weight, cost = tukey(2.0)(np.array([0.0, 2.0, 9.0]))
    >>> weight.tolist(), cost.round(6).tolist()
    ([1.0, 0.25, 0.0], [0.0, 1.166667, 1.333333])
    """
    scale = as_number(scale, "scale")
    scale = _checked(scale)

    def loss(squared: Floats) -> tuple[Floats, Floats]:
        left = 1 - np.minimum(squared / scale**2, 1.0)
        return left**2, scale**2 / 3 * (1 - left**3)

    return loss


def _checked(scale: float) -> float:
    if not 1 / _LARGEST < scale < _LARGEST:
        raise ShapeError(f"scale: {scale!r}; need a number above 0, of plain size")
    return float(scale)
