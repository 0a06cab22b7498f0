# SPDX-License-Identifier: Apache-2.0
"""Quadrilaterals in an image, by their sides: outlines of flat things, parts of which may be hidden."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from imgu_ros.arguments import as_integer, as_sequence
from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Image, Mask, Points, as_image

#: Shortest segment, px, and most of them after joining: the longest.
_SHORTEST_PX, _MOST_SEGMENTS = 5.0, 100
#: Two segments are of one line when the ends of one are so near to the other, px, and their directions differ by so
#: much, rad, beside the error of a short one, whose ends are known to a px.
_BESIDE_PX, _TURNED_RAD = 1.0, 0.06
#: The gap between them, as a share of what is known of the line.
_LARGEST_GAP = 0.7
#: Smallest sine of the angle at a corner.
_SHARPEST = 0.35
#: A corner is so near to ends of its sides, px, and as a share of a side: ends are hidden or washed out.
_FROM_END_PX, _FROM_END = 6.0, 0.25
#: Most corners: those of the longest sides. Bounds time and memory.
_MOST_CORNERS = 500
#: Shortest side, px, smallest area, px, and how far a corner may be outside the image, as a share of its sides.
_SHORTEST_SIDE_PX, _LEAST_AREA_PX, _OUTSIDE = 6.0, 120.0, 0.3
#: Thresholds of the edges that a side should show, grey values a px, and how near it is to them, px.
_EDGE_LOW, _EDGE_HIGH, _NEAR_PX = 20, 60, 1
#: Places of a side where an edge is looked for.
_PLACES = 16


def find_quadrilaterals(channels: Sequence[Image], most: int = 600) -> Floats:
    """Return quadrilaterals whose sides are edges of an image, those with the most edges first.

    Two opposite corners and the directions of the sides that meet there are enough: the others may be hidden or outside
    the image. Line segments (von Gioi et al. 2010) of one line are joined; where two lines meet near their ends is a
    corner; two corners whose sides meet make a quadrilateral. Whether there is anything is for the caller to say: in an
    image with many lines most are of several things.

    Parameters
    ----------
    channels : (H, W) uint8 each, of one size: an edge may show in any of them, brightness or colour
    most : of them, at most

    Returns
    -------
    corners : (N, 4, 2) px, clockwise as seen, convex; which corner comes first says nothing

    Raises
    ------
    ShapeError
        If the channels are no such arrays, or `most` is less than 1.

    References
    ----------
    R. Grompone von Gioi et al., LSD: A Fast Line Segment Detector with a False Detection Control, PAMI 32(4), 2010.
    """
    images = [as_image(each, "channels", dtypes=(np.uint8,)) for each in as_sequence(channels, "channels")]
    most = as_integer(most, "most")
    if not images or images[0].ndim != 2 or any(each.shape != images[0].shape for each in images):
        shapes = ", ".join(str(each.shape) for each in images)
        raise ShapeError(f"channels: {shapes or 'none'}; need images (H, W) of one size")
    if most < 1:
        raise ShapeError(f"most: {most}; need at least 1")
    images = [np.ascontiguousarray(each) for each in images]
    corners = _from_corners(*_corners(_joined(np.concatenate([_segments(each) for each in images]))), images[0].shape)
    if not len(corners):
        return np.zeros((0, 4, 2))
    shares = np.stack([_edge_share(each, corners) for each in images]).max(axis=0)
    kept: Floats = corners[np.argsort(-shares, kind="stable")[:most]]
    return kept


def _segments(image: Image) -> Floats:
    """Return line segments (N, 2, 2) px."""
    found = cv2.createLineSegmentDetector(cv2.LSD_REFINE_NONE).detect(image)[0]
    ends = np.zeros((0, 2, 2)) if found is None else found.reshape(-1, 2, 2).astype(np.float64)
    long: Floats = ends[np.hypot(*(ends[:, 1] - ends[:, 0]).T) > _SHORTEST_PX]
    return long


def _joined(ends: Floats) -> Floats:
    """Return segments (N, 2, 2), the longest first, those of one line as one."""
    lengths = np.hypot(*(ends[:, 1] - ends[:, 0]).T)
    order = np.argsort(-lengths, kind="stable")
    ends, lengths = ends[order], lengths[order]
    directions = (ends[:, 1] - ends[:, 0]) / lengths[:, None]
    used = np.zeros(len(ends), bool)
    joined: list[tuple[Floats, Floats]] = []
    for index in range(len(ends)):
        if used[index]:
            continue
        if len(joined) == _MOST_SEGMENTS:
            break
        used[index] = True
        middle, along = ends[index].mean(axis=0), directions[index]
        across = np.array((-along[1], along[0]))
        low, high = -lengths[index] / 2, lengths[index] / 2
        turned = np.abs(directions @ across) < _TURNED_RAD + 1 / lengths
        away = ends - middle
        beside, at = np.abs(away @ across).max(axis=1), np.sort(away @ along, axis=1)
        while True:
            length = high - low
            gap = np.maximum(at[:, 0] - high, low - at[:, 1])
            more = ~used & turned & (beside < _BESIDE_PX + length / 100) & (gap < _LARGEST_GAP * length)
            if not more.any():
                break
            used |= more
            low, high = min(low, at[more, 0].min()), max(high, at[more, 1].max())
        joined.append((middle + low * along, middle + high * along))
    return np.array(joined).reshape(-1, 2, 2)


def _corners(segments: Floats) -> tuple[Points, Floats]:
    """Return where two lines meet near their ends, (N, 2) px, and the directions of the sides from there, (N, 2, 2).

    The first side of a corner is the one that a quadrilateral goes on by, clockwise; the second one leads to it.
    """
    start = segments[:, 0]
    lengths = np.hypot(*(segments[:, 1] - start).T)
    along = (segments[:, 1] - start) / lengths[:, None]
    first, second = np.triu_indices(len(segments), 1)
    sine = _cross(along[first], along[second])
    wide = np.abs(sine) > _SHARPEST
    first, second, sine = first[wide], second[wide], sine[wide]
    apart = start[second] - start[first]
    on_first, on_second = _cross(apart, along[second]) / sine, _cross(apart, along[first]) / sine
    near = _is_near_end(on_first, lengths[first]) & _is_near_end(on_second, lengths[second])
    near[near] &= _longest(lengths[first[near]] + lengths[second[near]])
    first, second, on_first, on_second = first[near], second[near], on_first[near], on_second[near]
    at: Points = start[first] + on_first[:, None] * along[first]
    sides = np.stack(
        (
            along[first] * np.where(2 * on_first < lengths[first], 1, -1)[:, None],
            along[second] * np.where(2 * on_second < lengths[second], 1, -1)[:, None],
        ),
        axis=1,
    )
    turned = _cross(sides[:, 0], sides[:, 1]) < 0
    sides[turned] = sides[turned, ::-1]
    return at, sides


def _is_near_end(at: Floats, lengths: Floats) -> Mask:
    near: Mask = np.minimum(np.abs(at), np.abs(at - lengths)) < _FROM_END_PX + _FROM_END * lengths
    return near


def _longest(lengths: Floats) -> Mask:
    chosen = np.zeros(len(lengths), bool)
    chosen[np.argsort(-lengths, kind="stable")[:_MOST_CORNERS]] = True
    return chosen


def _from_corners(at: Points, sides: Floats, shape: tuple[int, ...]) -> Floats:
    """Return the quadrilaterals of two opposite corners each, (N, 4, 2)."""
    first, second = np.triu_indices(len(at), 1)
    apart = at[second] - at[first]
    size = np.array((shape[1], shape[0]), np.float64)
    longest = 2 * float(size.max())
    ahead, back = _meeting(apart, sides[first, 0], sides[second, 1]), _meeting(apart, sides[first, 1], sides[second, 0])
    lengths = np.stack((*ahead, *back))
    whole = (lengths > _SHORTEST_SIDE_PX).all(axis=0) & (lengths < longest).all(axis=0)
    first, second, ahead_px, back_px = first[whole], second[whole], ahead[0][whole], back[0][whole]
    corners = np.stack(
        (
            at[first],
            at[first] + ahead_px[:, None] * sides[first, 0],
            at[second],
            at[first] + back_px[:, None] * sides[first, 1],
        ),
        axis=1,
    )
    edges = np.roll(corners, -1, axis=1) - corners
    is_convex = (_cross(edges, np.roll(edges, -1, axis=1)) > 0).all(axis=1)
    area = _cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]) / 2
    is_near = ((corners > -_OUTSIDE * size) & (corners < (1 + _OUTSIDE) * size)).all(axis=(1, 2))
    kept: Floats = corners[is_convex & is_near & (area > _LEAST_AREA_PX)]
    return kept


def _meeting(apart: Floats, first: Floats, second: Floats) -> tuple[Floats, Floats]:
    """Return how far along two rays from places `apart` their lines meet; infinite where they are parallel."""
    sine = _cross(first, second)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.nan_to_num(_cross(apart, second) / sine, nan=math.inf), np.nan_to_num(
            _cross(apart, first) / sine, nan=math.inf
        )


def _edge_share(image: Image, corners: Floats) -> Floats:
    """Return the share of the sides that are edges of the image."""
    height, width = image.shape
    reach = np.ones((2 * _NEAR_PX + 1,) * 2, np.uint8)
    edges = cv2.dilate(cv2.Canny(np.ascontiguousarray(image), _EDGE_LOW, _EDGE_HIGH), reach)
    places = ((np.arange(_PLACES) + 0.5) / _PLACES)[:, None]
    on_sides = corners[:, :, None] + places * (np.roll(corners, -1, axis=1) - corners)[:, :, None]
    x, y = np.moveaxis(np.rint(on_sides).astype(np.intp), -1, 0)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    seen = inside & (edges[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)] > 0)
    share: Floats = np.count_nonzero(seen, axis=(1, 2)) / seen[0].size
    return share


def _cross(a: Floats, b: Floats) -> Floats:
    crossed: Floats = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return crossed
