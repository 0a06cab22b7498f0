# SPDX-License-Identifier: Apache-2.0
"""Linear interpolation, corrected by the gradient of the measured colour (Malvar, He & Cutler 2004)."""

from __future__ import annotations

import numpy as np

from imgu_ros.types import Image
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.demosaicking.quads import Field, Missing, Quads, Values
from imgu_ros.vision.formation.demosaicking.strips import StripMethod, demosaic_in_strips


def demosaic_malvar(raw: Image, pattern: BayerPattern) -> Image:
    """Reconstruct colour by linear 5x5 filters.

    A missing colour is the mean of its nearest sites plus a share (1/2 for green, 5/8 for red and blue at green, 3/4
    for red at blue and blue at red) of the Laplacian of the colour that was measured there. Fast, and good where
    colours change together.

    Parameters
    ----------
    raw : (H, W) uint8 or uint16, H and W at least 2
    pattern : colours of the top-left quad

    Returns
    -------
    (H, W, 3) RGB of the same data type; measured values are kept, linear ramps are exact away from the border.

    Raises
    ------
    ShapeError
        If `raw` is not such an image or the pattern is unknown.

    Notes
    -----
    H. S. Malvar, L. He, R. Cutler: High-quality linear interpolation for demosaicing of Bayer-patterned color images,
    ICASSP 2004, figure 2. 8-bit data are worked on in 16-bit integers; the results are those of real numbers, rounded
    once.

    Examples
    --------
    >>> import numpy as np
    >>> from imgu_ros.vision.formation import BayerPattern
    >>> raw = np.tile(np.array([[90, 60], [60, 30]], np.uint8), (4, 4))
    >>> demosaic_malvar(raw, BayerPattern.RGGB)[3, 4].tolist()
    [90, 60, 30]
    """
    return demosaic_in_strips(raw, pattern, _RECIPE)


def _missing(q: Quads) -> Missing:
    red, green, verde, blue = q.red, q.green_by_red, q.green_by_blue, q.blue
    # Pairs of neighbours in a row and in a column; pairs of pairs are the corners of a site.
    reds_in_row, reds_in_column = q.sum(red.at(), red.at(0, 1)), red.at() + red.at(1)
    blues_in_row, blues_in_column = q.sum(blue.at(0, -1), blue.at()), blue.at(-1) + blue.at()
    greens_by_red, greens_by_blue = q.sum(green.at(0, -1), green.at()), q.sum(verde.at(), verde.at(0, 1))

    corners = greens_by_blue.at(-1) + greens_by_blue.at()
    red_by_red, blue_by_red = _at_green(q, green, corners, reds_in_row.at(), blues_in_column)
    corners = greens_by_red.at() + greens_by_red.at(1)
    blue_by_blue, red_by_blue = _at_green(q, verde, corners, blues_in_row.at(), reds_in_column)

    greens_by_red.at()[:] += verde.at(-1)
    greens_by_red.at()[:] += verde.at()
    corners = blues_in_row.at(-1) + blues_in_row.at()
    green_at_red, blue_at_red = _at_color(q, red, greens_by_red.at(), corners)
    greens_by_blue.at()[:] += green.at()
    greens_by_blue.at()[:] += green.at(1)
    corners = reds_in_row.at() + reds_in_row.at(1)
    green_at_blue, red_at_blue = _at_color(q, blue, greens_by_blue.at(), corners)
    return Missing(
        green_at_red, blue_at_red, red_by_red, blue_by_red, red_by_blue, blue_by_blue, red_at_blue, green_at_blue
    )


def _at_green(q: Quads, green: Field, corners: Values, in_row: Values, in_column: Values) -> tuple[Field, Field]:
    """Return the colour of the row, 10 G - 2 corners - 2 row + column + 8 in_row, and that of the column."""
    row = green.at(0, -1) + green.at(0, 1)
    column = green.at(-1) + green.at(1)
    common = green.at() * 5
    common -= corners
    common *= 2
    common += row
    common += column
    found = []
    for greens, near in ((row, in_row), (column, in_column)):
        out = q.new()
        values = out.at()
        np.multiply(near, 8, out=values)
        greens *= 3
        values -= greens
        values += common
        found.append(out)
    return found[0], found[1]


def _at_color(q: Quads, color: Field, greens: Values, corners: Values) -> tuple[Field, Field]:
    """Return green, 8 C + 4 greens - 2 across, and the third colour, 12 C + 4 corners - 3 across."""
    across = color.at(-1) + color.at(1)
    across += color.at(0, -1)
    across += color.at(0, 1)
    green, other = q.new(), q.new()
    center = color.at() * 2
    values = green.at()
    np.add(center, greens, out=values)
    values += greens
    values += center
    values -= across
    values *= 2
    values = other.at()
    center += color.at()
    np.add(center, corners, out=values)
    values -= across
    values *= 4
    values += across
    return green, other


_RECIPE = StripMethod(_missing, reach=1, shift=1, scale=16, integer=True)
