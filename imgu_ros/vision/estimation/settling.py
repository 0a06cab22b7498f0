# SPDX-License-Identifier: Apache-2.0
"""From a consensus to a fit whose own inliers are those it was fitted to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from imgu_ros.errors import TooFewPoints
from imgu_ros.types import Mask, as_mask

#: Fits to inliers that the fit before told.
_MOST_ROUNDS = 10

Fit = TypeVar("Fit")


@dataclass(frozen=True, slots=True, eq=False)
class SettledFit(Generic[Fit]):
    """A fit, and what it was fitted to.

    Attributes
    ----------
    result : the fit
    inliers : the mask (N,) that chose its data
    """

    result: Fit
    inliers: Mask


@dataclass(frozen=True, slots=True, eq=False)
class InlierFit(Generic[Fit]):
    """A fit to chosen data, and what agrees with it.

    Attributes
    ----------
    fit : the fit to the data that a mask (N,) chooses; its errors are passed on
    agreeing : the mask (N,) of what agrees with a fit
    fewest : inliers that a fit needs; below that the fit before stands
    count : N

    Examples
    --------
    >>> values = np.array([0.0, 1.0, 2.0, 3.5, 50.0])
    >>> near = InlierFit(lambda mask: values[mask].mean(), lambda mean: abs(values - mean) < 3, 2, 5)
    >>> settled = near.settled(values < 2)
    >>> float(settled.result), settled.inliers.tolist()
    (1.625, [True, True, True, True, False])
    """

    fit: Callable[[Mask], Fit]
    agreeing: Callable[[Fit], Mask]
    fewest: int
    count: int

    def settled(self, inliers: Mask) -> SettledFit[Fit]:
        """Fit to the inliers, then to those of that fit, and so on until they stay the same.

        Raises
        ------
        ShapeError
            If the inliers are no mask (N,).
        TooFewPoints
            If there are fewer than `fewest`.
        """
        inliers = as_mask(inliers, self.count, "inliers")
        chosen = int(np.count_nonzero(inliers))
        if chosen < self.fewest:
            raise TooFewPoints(f"inliers: {chosen}; need at least {self.fewest}")
        for _ in range(_MOST_ROUNDS):
            fitted = inliers
            result = self.fit(fitted)
            inliers = self.agreeing(result)
            if np.count_nonzero(inliers) < self.fewest or np.array_equal(inliers, fitted):
                break
        return SettledFit(result, fitted)
