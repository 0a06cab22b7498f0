# SPDX-License-Identifier: Apache-2.0
"""The code of a fiducial marker, and how its cells look in a frame that blurs them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from imgu_ros.types import Floats, Mask, Matrix3, Points
from imgu_ros.vision.markers.dictionaries import marker_cells, marker_codes, marker_distance, nearest_marker

#: Cells of white about the black square that are known.
MARGIN = 1
#: Standard deviations of the blurs that are tried along columns and along rows, cells.
BLURS = (0.25, 0.4, 0.6, 0.85)
#: Samples of a cell lie within this share of it.
SAMPLED = 0.5


@dataclass(frozen=True, eq=False)
class MarkerCode:
    """The code of one marker.

    Attributes
    ----------
    family, number : which marker
    template_from_cells : (3, 3) from its cells, x right, y down, 0 to N from edge to edge of the black square, upright,
        to template px; the template has `MARGIN` cells of white about it
    """

    family: str
    number: int
    template_from_cells: Matrix3

    @cached_property
    def cells(self) -> Mask:
        """Which cells are white, (N, N), with the black border."""
        return marker_cells(self.family, self.number)

    @property
    def side(self) -> int:
        """Number of cells along a side, with the black border."""
        return len(self.cells)

    @property
    def corners(self) -> Points:
        """The outer corners of the black square, (4, 2) template px: top left, then clockwise, upright."""
        n = self.side
        at = np.array([[0, 0, 1], [n, 0, 1], [n, n, 1], [0, n, 1]]) @ self.template_from_cells.T
        return at[:, :2]

    @property
    def tolerated(self) -> int:
        """Number of inner cells that may differ where it goes out."""
        return (self.distance - 1) // 8

    @property
    def distance(self) -> int:
        """Number of cells in which the nearest other marker of the family differs."""
        return marker_distance(self.family, self.number)

    @cached_property
    def expected(self) -> tuple[Floats, Floats]:
        """How the cells look, -1 (black) to 1, at every pair of blurs, (B^2, N^2), and the pairs, (B^2, 2)."""
        white = np.pad(self.cells, MARGIN, constant_values=True).astype(np.float64)
        spread = [blurred_cells(self.side, sigma) for sigma in BLURS]
        looks = [rows @ (2 * white - 1) @ columns.T for rows in spread for columns in spread]
        pairs = np.array([(x, y) for y in BLURS for x in BLURS])
        return np.stack(looks).reshape(len(looks), -1), pairs

    def likeness_of_others(self, brightness: Floats) -> float:
        """Return the correlation of what is seen, (N^2,) with mean 0, with the likest other marker, turned or not."""
        length = float(np.linalg.norm(brightness))
        if not length > 0:
            return 0.0
        looks = _looks_of_all(self.family)
        likeness = (looks.reshape(-1, brightness.size) @ brightness).reshape(looks.shape[:-1]) / length
        likeness[:, 0, self.number] = -1
        return float(likeness.max())

    def nearest_other(self, read: Mask) -> int:
        """Return in how many cells what was read, (n, n) inner cells, differs from the nearest other marker."""
        return nearest_marker(self.family, self.number, read)


@lru_cache(maxsize=64)
def blurred_cells(side: int, sigma: float) -> Floats:
    """Return how bright cells are in a blurred row: (side, side + 2 margins) weights of the cells with the margin."""
    places = np.arange(side)[:, None] + MARGIN + 0.5 + np.linspace(-SAMPLED / 2, SAMPLED / 2, 3)
    edges = np.arange(side + 2 * MARGIN + 1)
    below = 0.5 * (1 + np.vectorize(math.erf)((edges - places[:, :, None]) / (sigma * math.sqrt(2))))
    # Beyond the margin it is taken to be white as well.
    below[:, :, 0], below[:, :, -1] = 0, 1
    weights: Floats = np.diff(below, axis=2).mean(axis=1)
    weights.flags.writeable = False
    return weights


@lru_cache(maxsize=8)
def _looks_of_all(family: str) -> Floats:
    """Return how the cells of all markers of a family look, turned, blurred alike along both axes: (B, 4, count, N^2).

    Each of mean 0 and length 1.
    """
    white = np.pad(marker_codes(family), ((0, 0), (1, 1), (1, 1)))
    side, looks = white.shape[1], []
    for sigma in BLURS:
        spread = blurred_cells(side, sigma)
        for turn in range(4):
            turned = np.pad(
                np.rot90(white, turn, axes=(1, 2)), ((0, 0), (MARGIN, MARGIN), (MARGIN, MARGIN)), constant_values=True
            )
            looks.append((spread @ (2.0 * turned - 1) @ spread.T).reshape(len(white), -1))
    every = np.stack(looks).reshape(len(BLURS), 4, len(white), -1)
    every -= every.mean(axis=-1, keepdims=True)
    every /= np.linalg.norm(every, axis=-1, keepdims=True)
    every.flags.writeable = False
    return every
