# SPDX-License-Identifier: Apache-2.0
"""A frame's picture of a target, as if seen straight on: drawn onto the pixel grid of the target's own picture."""

from __future__ import annotations

import math

import numpy as np

from imgu_ros.types import Floats, Image, Indices, Matrix3
from imgu_ros.vision.camera.distortion import fold_radius
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.processing.interpolation import MOST_SIDE_PX, Interpolation, resized
from imgu_ros.vision.processing.remapping import remapped

#: Looked-up points at a time: bounds the memory, some 50 bytes each.
_STRIP = 2**20
#: Most points looked up for a pixel, along each side.
_MOST_SAMPLES = 16
#: Stands for places outside the picture: no interpolation reaches back into it.
_OUTSIDE_PX = -100.0
#: Every 16th point is mapped exactly and the others are interpolated: 256 times fewer evaluations of the lens model.
_KNOT_EVERY = 16
#: Largest error of that interpolation; where it is exceeded, every point is mapped exactly.
_PRECISION_PX = 0.01
#: Farther out, a lens model's powers would overflow.
_FAR_PX = 1e9


def rectified(
    scene: Image,
    H: Matrix3,
    size: tuple[int, int],
    camera: Camera | None = None,
    interpolation: Interpolation | str = Interpolation.AREA,
) -> Image:
    """Draw what a frame shows of a target onto the target's own pixel grid: out(x) = scene(H x).

    Parameters
    ----------
    scene : (H, W) or (H, W, 3), the frame
    H : (3, 3) H_image_template, in ideal px when the camera's lens distorts, else in raw px
    size : (width, height) of the target's picture
    camera : that took the frame; None: a lens without distortion
    interpolation : nearest, linear, cubic, or area: the mean over the pixel's area, where the frame shows more of the
        target than its own picture; the same as linear elsewhere

    Returns
    -------
    (height, width) or (height, width, 3), the scene's data type; 0 where the target lies outside the frame.
    """
    interpolation = Interpolation(interpolation)
    width, height = size
    samples = _magnification(H, size) if interpolation is Interpolation.AREA else 1
    lookup = Interpolation.LINEAR if interpolation is Interpolation.AREA else interpolation
    rows = max(1, _STRIP // (width * samples**2))
    out = np.zeros((height, width, *scene.shape[2:]), scene.dtype)
    for top in range(0, height, rows):
        count = min(rows, height - top)
        x = (np.arange(width * samples) + 0.5) / samples - 0.5
        y = top + (np.arange(count * samples) + 0.5) / samples - 0.5
        part = remapped(scene, _places(x, y, H, camera, scene), lookup)
        out[top : top + count] = part if samples == 1 else resized(part, (width, count), Interpolation.AREA)
    return out


def _places(x: Floats, y: Floats, H: Matrix3, camera: Camera | None, scene: Image) -> Floats:
    """Return where the template's points (x[i], y[j]) lie in the raw frame, (len(y), len(x), 2) px."""
    places = _interpolated_places(x, y, H, camera)
    if places is None:
        places = np.nan_to_num(_exact_places(x, y, H, camera), nan=_OUTSIDE_PX)
    for axis, side in ((0, scene.shape[1]), (1, scene.shape[0])):
        np.clip(places[..., axis], _OUTSIDE_PX, min(side - _OUTSIDE_PX, MOST_SIDE_PX), out=places[..., axis])
    return places


def _interpolated_places(x: Floats, y: Floats, H: Matrix3, camera: Camera | None) -> Floats | None:
    """Return the places by interpolation between exact ones; None when that is not precise enough."""
    knots_x, knots_y = _knots(len(x)), _knots(len(y))
    coarse = _exact_places(x[knots_x], y[knots_y], H, camera)
    if not np.isfinite(coarse).all():
        return None
    between = _exact_places(_middles(x[knots_x]), _middles(y[knots_y]), H, camera)
    means = (coarse[:-1, :-1] + coarse[:-1, 1:] + coarse[1:, :-1] + coarse[1:, 1:]) / 4
    if not np.abs(between - means).max(initial=0.0) <= _PRECISION_PX:
        return None
    return _between(_between(coarse.astype(np.float32), knots_x, 1), knots_y, 0)


def _knots(count: int) -> Indices:
    return np.unique(np.append(np.arange(0, count, _KNOT_EVERY), count - 1))


def _middles(knots: Floats) -> Floats:
    return (knots[:-1] + knots[1:]) / 2


def _between(values: Image, knots: Indices, axis: int) -> Image:
    """Interpolate linearly along an axis, from the knots to every index."""
    every = np.arange(knots[-1] + 1)
    left = np.minimum(every // _KNOT_EVERY, max(len(knots) - 2, 0))
    right = np.minimum(left + 1, len(knots) - 1)
    share = (every - knots[left]) / np.maximum(knots[right] - knots[left], 1)
    share = np.expand_dims(share.astype(np.float32), tuple(a for a in range(3) if a != axis))
    first = np.take(values, left, axis)
    return np.asarray(first + share * (np.take(values, right, axis) - first))


def _exact_places(x: Floats, y: Floats, H: Matrix3, camera: Camera | None) -> Floats:
    """Return the places point by point; NaN behind the camera and beyond the range of the lens model."""
    grid = np.stack(np.broadcast_arrays(x[None, :], y[:, None], 1.0), axis=-1).reshape(-1, 3)
    mapped = grid @ H.T
    visible = mapped[:, 2] > 0
    with np.errstate(over="ignore"):
        ideal = np.clip(mapped[visible, :2] / mapped[visible, 2:], -_FAR_PX, _FAR_PX)
    raw = ideal
    if camera is not None and camera.is_distorted:
        normalized = np.linalg.solve(camera.K[:2, :2], (ideal - camera.K[:2, 2]).T).T
        # Beyond its range a lens model folds what lies outside back into the picture.
        inside = np.hypot(normalized[:, 0], normalized[:, 1]) < fold_radius(camera.model, camera.distortion)
        raw = np.full_like(ideal, np.nan)
        raw[inside] = camera.distort(normalized[inside])
    places = np.full((len(grid), 2), np.nan)
    places[visible] = raw
    return places.reshape(len(y), len(x), 2)


def _magnification(H: Matrix3, size: tuple[int, int]) -> int:
    """Return how many pixels of the frame, along each side, a pixel of the template covers at most; at least 1."""
    width, height = size
    largest = 1.0
    for x in np.linspace(0, width - 1, 5):
        for y in np.linspace(0, height - 1, 5):
            u, v, w = H @ (x, y, 1.0)
            if w > 0:
                slope = (H[:2, :2] - np.outer((u, v), H[2, :2]) / w) / w
                largest = max(largest, float(np.linalg.norm(slope, 2)))
    return max(1, min(math.ceil(largest - 0.05), _MOST_SAMPLES, MOST_SIDE_PX // max(size)))
