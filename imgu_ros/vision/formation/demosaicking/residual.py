# SPDX-License-Identifier: Apache-2.0
"""Residual interpolation (Kiku, Monno, Tanaka & Okutomi 2013 to 2016), by guided upsampling."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from imgu_ros.types import Image
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.demosaicking.quads import Field, Missing, Quads, Values
from imgu_ros.vision.formation.demosaicking.strips import StripMethod, demosaic_in_strips

_RIGHT, _DOWN = (0, 1), (1, 0)
_HALF = np.float32(1 / 2)
#: Noise that the slope of one colour over another allows for, as a share of the full range: it draws slopes to 1.
_NOISE = 1 / 80
#: Smallest variation by which a direction is weighted, as a share of the full range.
_LEAST_VARIATION = 1 / 510
#: Weights of the colour differences 0 to 3 px away on one side: a Gaussian of sigma 1 px.
_SIDE = [math.exp(-k * k / 2) for k in range(4)]
_TAPS = [np.float32(tap / sum(_SIDE)) for tap in _SIDE]


def demosaic_residual(raw: Image, pattern: BayerPattern) -> Image:
    """Reconstruct colour by residual interpolation: slower than the others, and good on vivid and dull colours alike.

    One colour is upsampled under the guidance of another: about each site a straight line is fitted through both
    colours' values, the lines are averaged, and what they leave at the measured sites, the residual, is
    interpolated linearly. Residuals are smoother than the colour differences that other methods interpolate, and no
    fixed relation of the colours is assumed; only patterns near the finest that a mosaic can hold are better left
    to Menon's method. First green and the other colour guide each other along rows and along columns; the resulting
    colour differences to all four sides are averaged, weighted by how little they vary. Then green guides red and
    blue, by the lines between their Laplacians.

    Parameters
    ----------
    raw : (H, W) uint8 or uint16, H and W at least 2
    pattern : colours of the top-left quad

    Returns
    -------
    (H, W, 3) RGB of the same data type; measured values are kept.

    Raises
    ------
    ShapeError
        If `raw` is not such an image or the pattern is unknown.

    Notes
    -----
    D. Kiku, Y. Monno, M. Tanaka, M. Okutomi: Beyond color difference: residual interpolation for color image
    demosaicking, IEEE Transactions on Image Processing 25 (2016): the first step is their RI with the directional
    weights of Pekkucuksen & Altunbas 2010 (without thresholds), the second their MLRI. Fits are made about the sites
    of the upsampled colour, over 5x3 of them in the first step and 5x5 in the second, and slopes are drawn to 1 by a
    noise of 1/80 of the full range, which leaves flat windows no division by zero.

    Examples
    --------
    >>> import numpy as np
    >>> from imgu_ros.vision.formation import BayerPattern
    >>> raw = np.tile(np.array([[90, 60], [60, 30]], np.uint8), (4, 4))
    >>> demosaic_residual(raw, BayerPattern.RGGB)[3, 4].tolist()
    [90, 60, 30]
    """
    return demosaic_in_strips(raw, pattern, _RECIPE)


@dataclass(frozen=True, slots=True, eq=False)
class _Sites:
    """A field for each site of the quad."""

    red: Field
    by_red: Field
    by_blue: Field
    blue: Field


def _missing(q: Quads) -> Missing:
    at_red, at_blue = _green_less_color(q)
    green = _Sites(q.sum(q.red.at(), at_red), q.green_by_red, q.green_by_blue, q.sum(q.blue.at(), at_blue))
    in_row, in_column, corner = _guided(q, q.red, green.red, (green.by_red, green.by_blue, green.blue), 1)
    red = _Sites(q.red, in_row, in_column, corner)
    in_row, in_column, corner = _guided(q, q.blue, green.blue, (green.by_blue, green.by_red, green.red), -1)
    blue = _Sites(corner, in_column, in_row, q.blue)
    return Missing(green.red, blue.red, red.by_red, blue.by_red, red.by_blue, blue.by_blue, red.blue, green.blue)


def _green_less_color(q: Quads) -> tuple[Values, Values]:
    """Return green less red at red, and green less blue at blue."""
    red, by_red = _along(q, q.red, q.green_by_red, _RIGHT, 1)
    blue, by_blue = _along(q, q.blue, q.green_by_blue, _RIGHT, -1)
    rows = _Sites(red, by_red, by_blue, blue)
    red, by_blue = _along(q, q.red, q.green_by_blue, _DOWN, 1)
    blue, by_red = _along(q, q.blue, q.green_by_red, _DOWN, -1)
    columns = _Sites(red, by_red, by_blue, blue)

    row_weights = _weights(
        q,
        _Sites(
            _change(q, rows.by_red, (0, -1), (0, 0)),
            _change(q, rows.red, (0, 0), (0, 1)),
            _change(q, rows.blue, (0, -1), (0, 0)),
            _change(q, rows.by_blue, (0, 0), (0, 1)),
        ),
    )
    column_weights = _weights(
        q,
        _Sites(
            _change(q, columns.by_blue, (-1, 0), (0, 0)),
            _change(q, columns.blue, (-1, 0), (0, 0)),
            _change(q, columns.red, (0, 0), (1, 0)),
            _change(q, columns.by_red, (0, 0), (1, 0)),
        ),
    )
    at_red = _weighted(
        _sides(q, rows.red, rows.by_red, _RIGHT, 1, row_weights[0]),
        _sides(q, columns.red, columns.by_blue, _DOWN, 1, column_weights[0]),
    )
    at_blue = _weighted(
        _sides(q, rows.blue, rows.by_blue, _RIGHT, -1, row_weights[1]),
        _sides(q, columns.blue, columns.by_red, _DOWN, -1, column_weights[1]),
    )
    return at_red, at_blue


def _along(q: Quads, color: Field, green: Field, step: tuple[int, int], side: int) -> tuple[Field, Field]:
    """Return green less colour at the colour's sites and at green's, from one row or column.

    Green's site follows the colour's of the same quad when `side` is 1 and precedes it when `side` is -1.
    """
    at_color = _upsampled(q, green, color, step, -side)
    at_green = _upsampled(q, color, green, step, side)
    at_color -= color.at()
    np.subtract(green.at(), at_green, out=at_green)
    return q.keep(at_color), q.keep(at_green)


def _upsampled(q: Quads, own: Field, guide: Field, step: tuple[int, int], side: int) -> Values:
    """Return a colour at the sites of its guide, which lie half a step to that side of its own."""
    across = step[1], step[0]
    at_own = q.sum(guide.at(), guide.at(*_times(step, -side)))
    values = at_own.at()
    values *= _HALF
    count = np.float32(1 / 15)
    sums = []
    for product in (at_own, own, q.keep(values * values), q.keep(values * own.at())):
        total = _run(q, q.keep(_run(q, product, across, -1, 3)), step, -2, 5)
        total *= count
        sums.append(total)
    guide_mean, own_mean, variance, covariance = sums
    variance -= guide_mean * guide_mean
    covariance -= guide_mean * own_mean
    slope, offset = _line(q, covariance, variance, guide_mean, own_mean, (_NOISE * q.top) ** 2)
    slope, offset = (q.keep(_run(q, field, across, -1, 3)) for field in (slope, offset))
    residual = own.at() - _on_line(_run(q, slope, step, -2, 5), values, _run(q, offset, step, -2, 5), 15)
    kept = q.keep(residual)
    first = -1 if side > 0 else -2
    out = _on_line(_run(q, slope, step, first, 4), guide.at(), _run(q, offset, step, first, 4), 12)
    residual += kept.at(*_times(step, side))
    residual *= _HALF
    out += residual
    return out


def _guided(q: Quads, own: Field, guide: Field, guides: tuple[Field, Field, Field], side: int) -> tuple[Field, ...]:
    """Return a colour at the sites beside, below and diagonally to its own (above and left when `side` is -1).

    `guide` is green at the own sites, `guides` at the three others.
    """
    bends = [_laplacian(field) for field in (guide, own)]
    sums = []
    for product in (guide, own, q.keep(bends[0] * bends[0]), q.keep(bends[0] * bends[1])):
        sums.append(_run(q, q.keep(_run(q, product, _RIGHT, -2, 5)), _DOWN, -2, 5))
    guide_mean, own_mean, variance, covariance = sums
    for values in sums:
        values *= np.float32(1 / 25)
    # The Laplacian of white noise of variance 1 has the variance 4^2 + 4 = 20.
    slope, offset = _line(q, covariance, variance, guide_mean, own_mean, 20 * (_NOISE * q.top) ** 2)
    first = -1 if side > 0 else -2
    lines = []
    for field in (slope, offset):
        own_columns, between = q.keep(_run(q, field, _RIGHT, -2, 5)), q.keep(_run(q, field, _RIGHT, first, 4))
        lines.append(
            (
                _run(q, own_columns, _DOWN, -2, 5),
                _run(q, between, _DOWN, -2, 5),
                _run(q, own_columns, _DOWN, first, 4),
                _run(q, between, _DOWN, first, 4),
            )
        )
    slopes, offsets = lines
    residual = q.difference(own.at(), _on_line(slopes[0], guide.at(), offsets[0], 25))
    columns = q.sum(residual.at(), residual.at(side, 0))
    left = (
        (residual.at() + residual.at(0, side)) * _HALF,
        columns.at() * _HALF,
        (columns.at() + columns.at(0, side)) * np.float32(1 / 4),
    )
    out = []
    for k, count in enumerate((20, 20, 16)):
        values = _on_line(slopes[k + 1], guides[k].at(), offsets[k + 1], count)
        values += left[k]
        out.append(q.keep(values))
    return tuple(out)


def _line(
    q: Quads, covariance: Values, variance: Values, guide_mean: Values, own_mean: Values, noise: float
) -> tuple[Field, Field]:
    """Return slope and offset of the line from the guide to the colour."""
    covariance += np.float32(noise)
    variance += np.float32(noise)
    slope = q.new()
    np.divide(covariance, variance, out=slope.at())
    return slope, q.difference(own_mean, slope.at() * guide_mean)


def _on_line(slopes: Values, guide: Values, offsets: Values, count: int) -> Values:
    """Return slope * guide + offset from sums of `count` slopes and offsets, which are overwritten."""
    slopes *= guide
    slopes += offsets
    slopes *= np.float32(1 / count)
    return slopes


def _laplacian(field: Field) -> Values:
    out = field.at() * 4
    for step in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        out -= field.at(*step)
    return out


def _run(q: Quads, field: Field, step: tuple[int, int], first: int, count: int) -> Values:
    """Return the sum of `count` successive values, the first of them `first` steps away; `count` is at least 2."""
    pairs = q.sum(field.at(), field.at(*step))
    if count == 2:
        return pairs.at(*_times(step, first))
    last = field if count % 2 else pairs
    out = pairs.at(*_times(step, first)) + last.at(*_times(step, first + (count - 1) // 2 * 2))
    for k in range(2, (count - 1) // 2 * 2, 2):
        out += pairs.at(*_times(step, first + k))
    return out


def _change(q: Quads, field: Field, before: tuple[int, int], after: tuple[int, int]) -> Field:
    return q.keep(cv2.absdiff(field.at(*after), field.at(*before)).reshape(-1))


def _weights(q: Quads, change: _Sites) -> tuple[Field, Field]:
    """Return the weights of red and blue sites: the inverse square of the changes in the 3x3 sites about them."""
    red, by_red, by_blue, blue = change.red, change.by_red, change.by_blue, change.blue
    blues, reds = q.sum(blue.at(0, -1), blue.at()), q.sum(red.at(), red.at(0, 1))
    at_red = red.at() + blues.at(-1)
    for part in (by_red.at(0, -1), by_red.at(), by_blue.at(-1), by_blue.at(), blues.at()):
        at_red += part
    at_blue = blue.at() + reds.at(1)
    for part in (by_blue.at(), by_blue.at(0, 1), by_red.at(), by_red.at(1), reds.at()):
        at_blue += part
    out = []
    for values in (at_red, at_blue):
        np.maximum(values, np.float32(_LEAST_VARIATION * q.top), out=values)
        # The range is divided out: squares of its inverse would leave float32's good range for 16-bit data.
        np.divide(np.float32(q.top), values, out=values)
        values *= values
        out.append(q.keep(values))
    return out[0], out[1]


def _sides(
    q: Quads, color: Field, green: Field, step: tuple[int, int], side: int, weights: Field
) -> tuple[Values, Values]:
    """Return the weighted sum of the averages to both sides of a colour's site, and the sum of the weights."""
    nearest, second = color.at() * _TAPS[0], q.keep(color.at() * _TAPS[2])
    first, third = q.keep(green.at() * _TAPS[1]), q.keep(green.at() * _TAPS[3])
    total: Values | None = None
    for sign in (-1, 1):
        # Green's sites 1 and 3 px away: those of this quad and the next, or of the two quads before.
        near, far = (0, sign) if sign == side else (sign, 2 * sign)
        average = nearest + first.at(*_times(step, near))
        average += second.at(*_times(step, sign))
        average += third.at(*_times(step, far))
        average *= weights.at(*_times(step, sign))
        total = average if total is None else np.add(total, average, out=total)
    assert total is not None
    return total, weights.at(*_times(step, -1)) + weights.at(*step)


def _weighted(rows: tuple[Values, Values], columns: tuple[Values, Values]) -> Values:
    total, weight = rows[0] + columns[0], rows[1] + columns[1]
    # Never 0: weights have a least value, given by the largest change, except beyond the strip's ends.
    np.maximum(weight, np.float32(1e-12), out=weight)
    total /= weight
    return total


def _times(step: tuple[int, int], count: int) -> tuple[int, int]:
    return step[0] * count, step[1] * count


_RECIPE = StripMethod(_missing, reach=15, shift=2, scale=1, integer=False)
