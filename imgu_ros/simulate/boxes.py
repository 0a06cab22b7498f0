# SPDX-License-Identifier: Apache-2.0
"""Which blocks of an image a printed plane can reach."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from imgu_ros.types import Floats, Matrix3
from imgu_ros.vision.camera.intrinsics import Camera

_STRIP_ROWS = 128
_EDGE_POINTS = 48


def boxes(H_image_template: Floats, size: tuple[int, int], camera: Camera) -> Iterator[tuple[slice, slice]]:
    """Yield (rows, columns), from even coordinates, that together hold the plane's inside.

    Parameters
    ----------
    H_image_template : (3, 3); or (height, 3, 3), one for each row of the image
    size : width, height of the template, px
    camera : for the image size and the lens
    """
    if H_image_template.ndim == 2:
        yield from _boxes(_outline_in_image(H_image_template, size, camera), camera)
        return
    for rows in strips(0, camera.height):
        # The plane moves little while a strip is read: what its ends and its middle show bounds the rest.
        chosen = {rows.start, (rows.start + rows.stop) // 2, rows.stop - 1}
        outlines = [_outline_in_image(H_image_template[row], size, camera) for row in sorted(chosen)]
        spans = [_span(outline, rows, camera) if outline is not None else (0, camera.width) for outline in outlines]
        ends = [span for span in spans if span is not None]
        if ends and len(ends) < len(spans):
            yield rows, slice(0, camera.width)  # it comes or goes meanwhile
        elif ends:
            left, right = min(a for a, _ in ends), max(b for _, b in ends)
            room = max(max(a for a, _ in ends) - left, right - min(b for _, b in ends))
            left, right = max(0, left - room), min(camera.width, right + room)
            yield rows, slice(left - left % 2, right)


def strips(start: int, stop: int) -> Iterator[slice]:
    """Yield slices of rows, each from an even row."""
    for row in range(start - start % 2, stop, _STRIP_ROWS):
        yield slice(row, min(row + _STRIP_ROWS, stop))


def _outline_in_image(H: Matrix3, size: tuple[int, int], camera: Camera) -> Floats | None:
    """Return the closed outline, (N, 2) raw px, with points along each edge; None when a part is behind the camera."""
    left, top, right, bottom = -0.5, -0.5, size[0] - 0.5, size[1] - 0.5
    corners = np.array([[left, top], [right, top], [right, bottom], [left, bottom], [left, top]])
    s = np.linspace(0, 1, _EDGE_POINTS, endpoint=False)[:, None]
    edges = np.concatenate([a + s * (b - a) for a, b in pairwise(corners)] + [corners[:1]])
    ideal = np.column_stack((edges, np.ones(len(edges)))) @ H.T
    if not (ideal[:, 2] > 1e-3 * ideal[:, 2].max()).all():
        return None
    points: Floats = ideal[:, :2] / ideal[:, 2:]
    if not camera.is_distorted:
        return points
    # Far outside the image a polynomial lens may fold back: only an outline near the image is trusted.
    near = (
        np.abs(points - (camera.width / 2, camera.height / 2)) < 1.5 * np.array([camera.width, camera.height])
    ).all()
    return camera.raw_pixels(points) if near else None


def _boxes(outline: Floats | None, camera: Camera) -> Iterator[tuple[slice, slice]]:
    if outline is None:
        for rows in strips(0, camera.height):
            yield rows, slice(0, camera.width)
        return
    top, bottom = max(0, math.floor(outline[:, 1].min()) - 2), min(camera.height, math.ceil(outline[:, 1].max()) + 3)
    for rows in strips(top, bottom):
        span = _span(outline, rows, camera)
        if span is not None:
            yield rows, slice(span[0] - span[0] % 2, span[1])


def _span(outline: Floats, rows: slice, camera: Camera) -> tuple[int, int] | None:
    """Return the first and the end of the columns that an outline takes in a strip of rows, widened by 2 px."""
    a, b = outline[:-1], outline[1:]
    low, high = np.minimum(a[:, 1], b[:, 1]), np.maximum(a[:, 1], b[:, 1])
    run = np.where(b[:, 1] == a[:, 1], 1.0, b[:, 1] - a[:, 1])
    first, last = rows.start - 2.0, rows.stop + 2.0
    crosses = (low <= last) & (high >= first)
    if not crosses.any():
        return None
    # Where each edge enters and leaves the strip.
    level = a[:, 1] == b[:, 1]
    ends = []
    for y in (first, last):
        t = np.clip((y - a[:, 1]) / run, 0, 1)
        ends.append(np.where(level, a[:, 0], a[:, 0] + t * (b[:, 0] - a[:, 0]))[crosses])
    ends += [b[:, 0][crosses & level]]
    x = np.concatenate(ends)
    left, right = max(0, math.floor(x.min()) - 2), min(camera.width, math.ceil(x.max()) + 3)
    return (left, right) if left < right else None
