# SPDX-License-Identifier: Apache-2.0
"""The adaptive methods beside their definitions, evaluated on whole pictures in double precision, one colour a mask."""

from __future__ import annotations

import numpy as np
import pytest

from imgu_ros.vision.formation.cfa import BayerPattern, site_mask
from imgu_ros.vision.formation.demosaic import demosaic

PATTERNS = list(BayerPattern)
PAD = 40


def random_raw(shape, dtype, kind="noise", seed=0):
    rng = np.random.default_rng(seed)
    top = np.iinfo(dtype).max
    if kind == "extremes":
        return (rng.integers(0, 2, shape) * top).astype(dtype)
    if kind == "smooth":
        y, x = np.mgrid[: shape[0], : shape[1]]
        values = 0.5 + 0.4 * np.sin(x * 0.7 + 0.1 * y) * np.cos(y * 0.5 - 0.02 * x * y) + 0.03 * rng.normal(size=shape)
        return np.clip(values * top, 0, top).astype(dtype)
    return rng.integers(0, top, shape, dtype, endpoint=True)


class Padded:
    """A mosaic with its mirror images about it, and the masks of its colours."""

    def __init__(self, raw, pattern):
        self.raw = np.pad(raw.astype(float), PAD, mode="reflect")
        self.r, self.g, self.b = (site_mask(self.raw.shape, pattern, c) for c in "rgb")  # PAD is even
        self.red_row = np.repeat(self.r.any(axis=1)[:, None], self.raw.shape[1], axis=1)
        self.inner = (slice(PAD, -PAD), slice(PAD, -PAD))
        self.top = float(np.iinfo(raw.dtype).max)

    def result(self, r, g, b):
        rgb = np.stack([np.where(mask, self.raw, c) for mask, c in ((self.r, r), (self.g, g), (self.b, b))], axis=2)
        return np.clip(rgb[self.inner], 0, self.top)


def at(image, down, right):
    """The value so many rows and columns away, at every pixel (what comes around the edge is cut away later)."""
    return np.roll(image, (-down, -right), (0, 1))


def mean(image, *places):
    return np.mean([at(image, *place) for place in places], axis=0)


HORIZONTAL, VERTICAL = ((0, -1), (0, 1)), ((-1, 0), (1, 0))
FALLING, RISING = ((-1, -1), (1, 1)), ((-1, 1), (1, -1))


def doubled(pair):
    return tuple((2 * y, 2 * x) for y, x in pair)


def hamilton_adams(raw, pattern):
    p = Padded(raw, pattern)
    along = []
    for pair in (HORIZONTAL, VERTICAL):
        bend = p.raw - mean(p.raw, *doubled(pair))
        gradient = abs(at(p.raw, *pair[0]) - at(p.raw, *pair[1])) + 2 * abs(bend)
        along.append((mean(p.raw, *pair) + bend / 2, gradient))
    (row, in_row), (column, in_column) = along
    green = np.where(in_row < in_column, row, np.where(in_column < in_row, column, (row + column) / 2))
    green = np.where(p.g, p.raw, green)
    colors = []
    for own_row in (p.red_row, ~p.red_row):
        difference = p.raw - green
        beside = green + np.where(own_row, mean(difference, *HORIZONTAL), mean(difference, *VERTICAL))
        values, gradients = [], []
        for pair in (FALLING, RISING):
            values.append(green + mean(difference, *pair))
            first = abs(at(p.raw, *pair[0]) - at(p.raw, *pair[1]))
            gradients.append(first + 2 * abs(green - mean(green, *pair)))
        chosen = np.where(2 * gradients[0] < gradients[1], values[0], np.mean(values, axis=0))
        chosen = np.where(2 * gradients[1] < gradients[0], values[1], chosen)
        colors.append(np.where(p.g, beside, chosen))
    return p.result(colors[0], green, colors[1])


def menon(raw, pattern):
    p = Padded(raw, pattern)
    greens = [mean(p.raw, *pair) + (p.raw - mean(p.raw, *doubled(pair))) / 2 for pair in (HORIZONTAL, VERTICAL)]
    variations = []
    for green, pair in zip(greens, (HORIZONTAL, VERTICAL), strict=True):
        difference = np.where(p.g, 0, p.raw - green)
        ahead = abs(difference - at(difference, *doubled(pair)[1]))
        kernel = np.array([[0, 0, 1, 0, 1], [0, 0, 0, 1, 0], [0, 0, 3, 0, 3], [0, 0, 0, 1, 0], [0, 0, 1, 0, 1]])
        kernel = kernel if pair is HORIZONTAL else kernel.T
        # Figure 3 with the differences to the next site, of this one and of the one before.
        variations.append(sum(w * at(ahead, 2 - y, 2 - x) for (y, x), w in np.ndenumerate(kernel) if w))
    in_row = variations[0] <= variations[1]
    green = np.where(p.g, p.raw, np.where(in_row, *greens))

    def in_direction(image, *more):
        return np.where(in_row, mean(image, *HORIZONTAL, *more), mean(image, *VERTICAL, *more))

    def beside(green, red, blue):
        out = []
        for color, own_row in ((red, p.red_row), (blue, ~p.red_row)):
            difference = color - green
            near = np.where(own_row, mean(difference, *HORIZONTAL), mean(difference, *VERTICAL))
            out.append(np.where(p.g, green + near, color))
        return out

    red, blue = beside(green, p.raw, p.raw)
    red, blue = (
        np.where(p.b, p.raw + in_direction(red - blue), red),
        np.where(p.r, p.raw + in_direction(blue - red), blue),
    )
    own = np.where(p.r, red, blue)
    green = np.where(
        p.g, p.raw, own - np.where(p.r, in_direction(red - green, (0, 0)), in_direction(blue - green, (0, 0)))
    )
    red, blue = beside(green, red, blue)
    red, blue = (
        np.where(p.b, p.raw + in_direction(red - blue, (0, 0)), red),
        np.where(p.r, p.raw + in_direction(blue - red, (0, 0)), blue),
    )
    return p.result(red, green, blue)


def grid(rows, columns):
    return [(y, x) for y in rows for x in columns]


def line(own, guide, window, noise, bend=None):
    """Slope and offset of the line from guide to own over a window."""
    g, o = mean(guide, *window), mean(own, *window)
    if bend is None:
        covariance, variance = mean(guide * own, *window) - g * o, mean(guide * guide, *window) - g * g
    else:
        covariance, variance = mean(bend(guide) * bend(own), *window), mean(bend(guide) ** 2, *window)
    slope = (covariance + noise) / (variance + noise)
    return slope, o - slope * g


def residual(raw, pattern):
    p = Padded(raw, pattern)
    noise = (p.top / 80) ** 2
    differences, weights = [], []
    for pair in (HORIZONTAL, VERTICAL):
        turn = (lambda places: places) if pair is HORIZONTAL else (lambda places: [(x, y) for y, x in places])
        # Every site's own colour by the guidance of the colour beside it, at the sites of that colour.
        guide = mean(p.raw, *pair)
        slope, offset = line(p.raw, guide, turn(grid((-2, 0, 2), (-4, -2, 0, 2, 4))), noise)
        about = turn(grid((-2, 0, 2), (-4, -2, 0, 2, 4)))
        left = p.raw - mean(slope, *about) * guide - mean(offset, *about)
        about = turn(grid((-2, 0, 2), (-3, -1, 1, 3)))
        other = mean(slope, *about) * p.raw + mean(offset, *about) + mean(left, *pair)
        difference = np.where(p.g, p.raw - other, other - p.raw)
        change = abs(at(difference, *pair[1]) - at(difference, *pair[0]))
        change = 9 * mean(change, *grid((-1, 0, 1), (-1, 0, 1)))
        weight = 1 / np.maximum(change, p.top / 510) ** 2
        for step in pair:
            taps = np.exp(-(np.arange(4) ** 2) / 2)
            side = sum(tap * at(difference, k * step[0], k * step[1]) for k, tap in enumerate(taps)) / taps.sum()
            differences.append(side)
            weights.append(at(weight, 2 * step[0], 2 * step[1]))
    combined = sum(w * d for w, d in zip(weights, differences, strict=True)) / sum(weights)
    green = np.where(p.g, p.raw, p.raw + combined)

    def bend(image):
        return 4 * image - sum(at(image, *step) for step in ((-2, 0), (2, 0), (0, -2), (0, 2)))

    def masked_mean(image, mask, places):
        count = sum(at(mask.astype(float), *place) for place in places)
        return sum(at(np.where(mask, image, 0), *place) for place in places) / np.maximum(count, 1)

    colors = []
    for mask in (p.r, p.b):
        slope, offset = line(p.raw, green, grid((-4, -2, 0, 2, 4), (-4, -2, 0, 2, 4)), 20 * noise, bend)
        # The lines of 5 of the colour's sites, or of 4 where the pixel lies between them.
        about = grid(range(-4, 5), range(-4, 5))
        tentative = masked_mean(slope, mask, about) * green + masked_mean(offset, mask, about)
        left = np.where(mask, p.raw - tentative, 0)
        weights = {0: 1, 1: 0.5, -1: 0.5}
        spread = sum(weights[y] * weights[x] * at(left, y, x) for y in weights for x in weights)
        colors.append(tentative + spread)
    return p.result(colors[0], green, colors[1])


DEFINITIONS = {"hamilton_adams": hamilton_adams, "menon": menon, "residual": residual}


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("method", DEFINITIONS)
def test_method_follows_its_definition(method, pattern, dtype):
    for shape, kind in (((21, 24), "noise"), ((18, 23), "extremes"), ((44, 41), "smooth")):
        raw = random_raw(shape, dtype, kind)
        got, expected = demosaic(raw, pattern, method), DEFINITIONS[method](raw, pattern)
        # Rounding, and float32 in long sums.
        np.testing.assert_allclose(got, expected, atol=0.51 if method != "residual" else 0.51 + 3e-5 * expected.max())
