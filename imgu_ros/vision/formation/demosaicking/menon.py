# SPDX-License-Identifier: Apache-2.0
"""Directional filtering with a posteriori decision, and refining (Menon, Andriani & Calvagno 2007)."""

from __future__ import annotations

import cv2
import numpy as np

from imgu_ros.types import Image
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.demosaicking.quads import Field, Missing, Quads, Values
from imgu_ros.vision.formation.demosaicking.strips import StripMethod, demosaic_in_strips

_HALF, _THIRD = np.float32(1 / 2), np.float32(1 / 3)
_RIGHT, _DOWN = (0, 1), (1, 0)


def demosaic_menon(raw: Image, pattern: BayerPattern) -> Image:
    """Reconstruct colour in the direction in which colour differences vary less (DDFAPD), with refining.

    Green is interpolated along rows and along columns; of the two, each red or blue site takes that whose colour
    differences vary less about it. Red and blue follow from the colour differences in that direction; then the high
    frequencies of each colour are replaced by those of the colour that was measured.

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
    D. Menon, S. Andriani, G. Calvagno: Demosaicing with directional filtering and a posteriori decision, IEEE
    Transactions on Image Processing 16 (2007), sections II to IV. Best where colours change together.

    Examples
    --------
    >>> import numpy as np
    >>> from imgu_ros.vision.formation import BayerPattern
    >>> raw = np.tile(np.array([[90, 60], [60, 30]], np.uint8), (4, 4))
    >>> demosaic_menon(raw, BayerPattern.RGGB)[3, 4].tolist()
    [90, 60, 30]
    """
    return demosaic_in_strips(raw, pattern, _RECIPE)


def _missing(q: Quads) -> Missing:
    red, green, verde, blue = q.red, q.green_by_red, q.green_by_blue, q.blue
    (red_less, in_row_at_red), (blue_less, in_row_at_blue) = _decided(q)
    # Red less blue at every site, from that at the nearest greens.
    by_red, by_blue = _by_greens(q, red_less, blue_less)
    opponent, verdant = q.difference(by_red[0].at(), by_red[1].at()), q.difference(by_blue[0].at(), by_blue[1].at())
    at_red = _mean(q, (opponent.at(0, -1), opponent.at()), (verdant.at(-1), verdant.at()), in_row_at_red)
    at_blue = _mean(q, (verdant.at(), verdant.at(0, 1)), (opponent.at(), opponent.at(1)), in_row_at_blue)

    # Refining: differences lose their high frequencies, first at red and blue, then at green, then across.
    values = by_red[0], by_blue[0], red_less.at()
    red_less = _mean(
        q,
        (values[0].at(0, -1), values[2], values[0].at()),
        (values[1].at(-1), values[2], values[1].at()),
        in_row_at_red,
    )
    values = by_red[1], by_blue[1], blue_less.at()
    blue_less = _mean(
        q,
        (values[1].at(), values[2], values[1].at(0, 1)),
        (values[0].at(), values[2], values[0].at(1)),
        in_row_at_blue,
    )
    by_red, by_blue = _by_greens(q, red_less, blue_less)
    opponent, verdant = q.difference(by_red[0].at(), by_red[1].at()), q.difference(by_blue[0].at(), by_blue[1].at())
    at_red = _mean(
        q, (opponent.at(0, -1), at_red.at(), opponent.at()), (verdant.at(-1), at_red.at(), verdant.at()), in_row_at_red
    )
    at_blue = _mean(
        q, (verdant.at(), at_blue.at(), verdant.at(0, 1)), (opponent.at(), at_blue.at(), opponent.at(1)), in_row_at_blue
    )
    return Missing(
        green_at_red=q.difference(red.at(), red_less.at()),
        blue_at_red=q.difference(red.at(), at_red.at()),
        red_by_red=q.sum(green.at(), by_red[0].at()),
        blue_by_red=q.sum(green.at(), by_red[1].at()),
        red_by_blue=q.sum(verde.at(), by_blue[0].at()),
        blue_by_blue=q.sum(verde.at(), by_blue[1].at()),
        red_at_blue=q.sum(blue.at(), at_blue.at()),
        green_at_blue=q.difference(blue.at(), blue_less.at()),
    )


def _decided(q: Quads) -> tuple[tuple[Field, Values], tuple[Field, Values]]:
    """Return red, and blue, less green at their own sites, each with where (0 or 255) green came from the row."""
    red, green, verde, blue = q.red, q.green_by_red, q.green_by_blue, q.blue
    # Colour less green with green along rows and along columns, and the direction in which it varies less.
    red_row = _less_green(q, red, green.at(0, -1), green.at(), _RIGHT)
    red_column = _less_green(q, red, verde.at(-1), verde.at(), _DOWN)
    blue_row = _less_green(q, blue, verde.at(), verde.at(0, 1), _RIGHT)
    blue_column = _less_green(q, blue, green.at(), green.at(1), _DOWN)
    red_across, red_along = _variation(q, red_row, _RIGHT), _variation(q, red_column, _DOWN)
    blue_across, blue_along = _variation(q, blue_row, _RIGHT), _variation(q, blue_column, _DOWN)
    in_row_at_red = cv2.compare(
        _about(q, red_across, _RIGHT, blue_across.at(-1, -1), blue_across.at(0, -1)),
        _about(q, red_along, _DOWN, blue_along.at(-1, -1), blue_along.at(-1, 0)),
        cv2.CMP_LE,
    )
    in_row_at_blue = cv2.compare(
        _about(q, blue_across, _RIGHT, red_across.at(), red_across.at(1)),
        _about(q, blue_along, _DOWN, red_along.at(), red_along.at(0, 1)),
        cv2.CMP_LE,
    )
    red_less, blue_less = red_column, blue_column
    red_less.take(red_row.at(), in_row_at_red)
    blue_less.take(blue_row.at(), in_row_at_blue)
    return (red_less, in_row_at_red), (blue_less, in_row_at_blue)


def _less_green(q: Quads, color: Field, first: Values, second: Values, step: tuple[int, int]) -> Field:
    """Return colour less green; green by the filter (-1 2 2 2 -1) / 4 (equation 2)."""
    out = q.sum(color.at(-step[0], -step[1]), color.at(*step))
    values = out.at()
    values *= _HALF
    values += color.at()
    values -= first
    values -= second
    values *= _HALF
    return out


def _variation(q: Quads, difference: Field, step: tuple[int, int]) -> Field:
    """Return the absolute difference from each site to the next (equations 5 and 6)."""
    out = q.difference(difference.at(), difference.at(*step))
    np.abs(out.at(), out=out.at())
    return out


def _about(q: Quads, own: Field, step: tuple[int, int], *other: Values) -> Values:
    """Return the weighted sum of the variations about a site: its own colour's, and the two next to it (figure 3)."""
    across = step[1], step[0]
    lines = q.sum(own.at(-across[0], -across[1]), own.at(*across))
    values = lines.at()
    values += own.at() * 3
    out = values + lines.at(-step[0], -step[1])
    out += other[0]
    out += other[1]
    return out


def _by_greens(q: Quads, red_less: Field, blue_less: Field) -> tuple[tuple[Field, Field], tuple[Field, Field]]:
    """Return red and blue less green at the greens of red rows, and at those of blue rows."""
    pairs = (
        (red_less.at(), red_less.at(0, 1)),
        (blue_less.at(-1), blue_less.at()),
        (red_less.at(), red_less.at(1)),
        (blue_less.at(0, -1), blue_less.at()),
    )
    fields = [q.sum(*pair) for pair in pairs]
    for field in fields:
        values = field.at()
        values *= _HALF
    return (fields[0], fields[1]), (fields[2], fields[3])


def _mean(q: Quads, in_row: tuple[Values, ...], in_column: tuple[Values, ...], where_row: Values) -> Field:
    """Return the mean of two or three values in the row where that was chosen, else in the column."""
    out, row = q.sum(in_column[0], in_column[1]), in_row[0] + in_row[1]
    values = out.at()
    if len(in_row) == 3:
        values += in_column[2]
        row += in_row[2]
    out.take(row, where_row)
    values *= _HALF if len(in_row) == 2 else _THIRD
    return out


_RECIPE = StripMethod(_missing, reach=6, shift=1, scale=1, integer=False)
