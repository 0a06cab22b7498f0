# SPDX-License-Identifier: Apache-2.0
"""Whether a frame shows a target where an estimate says it is: the share of it that looks as it should.

Agreeing keypoints say that some part of a target is there; a part may also belong to another picture that shares it
(a logo, a header, a texture), and a chance agreement of a few leads nowhere. So the whole of the target is compared,
cell by cell, as far as it is in view.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from imgu_ros.errors import NotConfirmed
from imgu_ros.image.frame_image import FrameImage
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.templates import TemplateOctave
from imgu_ros.types import Floats, Image, Mask, Matrix3, Points
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.scale_space.pyramid import PixelScaling

#: Standard deviation of a cell of the reference, grey values, below which it has too little contrast to count.
#: Measured: benchmarks/thresholds.py, study confirmation.
_FLAT = 4.0


@dataclass(frozen=True, slots=True)
class Comparison:
    """A way to compare a target with a frame, cell by cell.

    Attributes
    ----------
    cells, samples : cells along the longer side of what is in view, samples along each side of a cell
    alike : correlation (ncc) from which on a cell looks as it should, if half of those beside it do too
    fewest : cells in view without which nothing can be said
    needed : share of the cells in view that must look as they should
    """

    cells: int
    samples: int
    alike: float
    fewest: int
    needed: float


#: The four cells beside one.
_BESIDE = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], np.uint8)

#: Small cells: an occluder spoils every cell that it touches. Between the shares of references that are 60 % hidden and
#: those of an image that has the upper 30 % of the reference and nothing else of it. Measured:
#: benchmarks/thresholds.py, study confirmation.
FINE = Comparison(cells=32, samples=5, alike=0.75, fewest=24, needed=0.325)
#: Large cells still correlate in a blurred frame. Measured: benchmarks/thresholds.py, study confirmation.
COARSE = Comparison(cells=16, samples=8, alike=0.6, fewest=12, needed=0.45)


def require_confirmed(pictures: FrameImage, target: Reference, H: Matrix3, camera: Camera | None) -> float:
    """Return the share of a target in view that looks as it should where an estimate says it is.

    Parameters
    ----------
    pictures : the frame's
    target : the target
    H : H_image_template in ideal px, the target in front of the camera
    camera : intrinsics when the lens distorts; else None

    Raises
    ------
    NotConfirmed
        If it is too little.
    """
    share = confirmed_share(pictures, target, H, camera)
    if share >= FINE.needed:
        return share
    coarse = confirmed_share(pictures, target, H, camera, COARSE)
    if coarse < COARSE.needed:
        raise NotConfirmed(f"{share:.0%} of what is in view looks as it should, {FINE.needed:.0%} needed", share)
    return coarse


def confirmed_share(
    pictures: FrameImage, target: Reference, H: Matrix3, camera: Camera | None, comparison: Comparison = FINE
) -> float:
    """Return the share of a target's cells in view that the frame shows, 0 to 1; 0 where too few are in view.

    Parameters
    ----------
    pictures, target, H, camera : as for `require_confirmed`
    comparison : how
    """
    width, height = target.size
    window = _window_in_view(pictures, H, camera, width, height)
    if window is None:
        return 0.0
    extent = window[1] - window[0]
    n = comparison.samples
    columns, rows = np.maximum(np.rint(extent * comparison.cells / extent.max()).astype(int), 1).tolist()
    size = columns * n, rows * n
    step = extent / size
    # Template px from samples.
    A = np.array([[step[0], 0, window[0, 0] + step[0] / 2], [0, step[1], window[0, 1] + step[1] / 2], [0, 0, 1]])
    x, y = (np.arange(count + 1) * n - 0.5 for count in (columns, rows))
    corners = _raw(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2), H @ A, camera)
    inside = _inside(corners, pictures.shape).reshape(rows + 1, columns + 1)
    in_view = inside[:-1, :-1] & inside[1:, :-1] & inside[:-1, 1:] & inside[1:, 1:]
    area = _median_area(corners.reshape(rows + 1, columns + 1, 2)) / n**2
    seen = _seen(pictures, H @ A, camera, size, area)
    octaves = target.templates[pictures.is_linear]
    return _alike(_drawn(octaves, A, size), seen, in_view.ravel(), comparison)


def _window_in_view(pictures: FrameImage, H: Matrix3, camera: Camera | None, width: int, height: int) -> Points | None:
    """Return the smallest rectangle of the template, (2, 2) px, that holds what is in view; None when nothing is."""
    count = 25
    x, y = (np.linspace(-0.5, side - 0.5, count) for side in (width, height))
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    seen = grid[_inside(_raw(grid, H, camera), pictures.shape)]
    if len(seen) < 4:
        return None
    spacing = np.array((width, height)) / (count - 1)
    low = np.maximum(seen.min(axis=0) - spacing, -0.5)
    high = np.minimum(seen.max(axis=0) + spacing, (width - 0.5, height - 0.5))
    return np.stack((low, high))


def _raw(template_xy: Points, H: Matrix3, camera: Camera | None) -> Points:
    mapped = template_xy @ H[:, :2].T + H[:, 2]
    ideal = mapped[:, :2] / mapped[:, 2:]
    return ideal if camera is None else camera.raw_pixels(ideal)


def _inside(raw_xy: Points, shape: tuple[int, int]) -> Mask:
    inside: Mask = ((raw_xy >= 0) & (raw_xy <= (shape[1] - 1, shape[0] - 1))).all(axis=1)
    return inside


def _median_area(corners: Floats) -> float:
    """Return the median area of the cells, px, from their corners (rows, columns, 2)."""
    along, down = np.diff(corners, axis=1)[:-1], np.diff(corners, axis=0)[:, :-1]
    return float(np.median(np.abs(along[..., 0] * down[..., 1] - along[..., 1] * down[..., 0])))


def _drawn(octaves: Sequence[TemplateOctave], A: Matrix3, size: tuple[int, int]) -> Image:
    """Return the target at the samples, from the level whose pixels are about as far apart."""
    scales = np.array([octave.level.scale for octave in octaves])
    level = octaves[int(np.argmin(np.abs(np.log(scales / math.sqrt(A[0, 0] * A[1, 1])))))].level
    M = PixelScaling(level.step).reduced_from_full @ A
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(level.image, M[:2], size, flags=flags, borderMode=cv2.BORDER_REPLICATE)


def _seen(pictures: FrameImage, H: Matrix3, camera: Camera | None, size: tuple[int, int], area: float) -> Image:
    """Return the frame at the samples, from the picture whose pixels are about as far apart."""
    halvings = min(round(math.log2(max(math.sqrt(area), 1.0))), pictures.most_halvings)
    picture, scaling = pictures.halved(halvings), PixelScaling(2.0**halvings)
    if camera is None:
        M = scaling.reduced_from_full @ H
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return cv2.warpPerspective(picture, M, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    x, y = (np.arange(count, dtype=np.float64) for count in size)
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    at = scaling.from_full_unchecked(_raw(grid, H, camera)).astype(np.float32).reshape(size[1], size[0], 2)
    map_x, map_y = (np.ascontiguousarray(at[..., axis]) for axis in (0, 1))
    return cv2.remap(picture, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _alike(drawn: Image, seen: Image, in_view: Mask, comparison: Comparison) -> float:
    a, b = (_cells(picture.astype(np.float32), comparison.samples) for picture in (drawn, seen))
    power_a, power_b = np.einsum("ij,ij->i", a, a), np.einsum("ij,ij->i", b, b)
    counted = (power_a >= _FLAT**2 * a.shape[1]) & in_view
    if np.count_nonzero(counted) < comparison.fewest:
        return 0.0
    product = np.einsum("ij,ij->i", a, b)
    alike = (product > 0) & (product * product >= comparison.alike**2 * power_a * power_b) & (power_b > 0)
    shape = drawn.shape[0] // comparison.samples, drawn.shape[1] // comparison.samples
    supported = _supported((alike & counted).reshape(shape), counted.reshape(shape))
    return float(np.count_nonzero(supported) / np.count_nonzero(counted))


def _supported(alike: Mask, counted: Mask) -> Mask:
    """Return which alike cells (rows, columns) have as many alike as other cells beside them: few are so by chance."""
    beside_alike, beside = (
        cv2.filter2D(cells.astype(np.uint8), -1, _BESIDE, borderType=cv2.BORDER_CONSTANT) for cells in (alike, counted)
    )
    supported: Mask = alike & (2 * beside_alike >= beside)
    return supported


def _cells(picture: Image, n: int) -> Image:
    """Return the pixels of each cell of n x n, less their mean, in a row."""
    rows, columns = picture.shape[0] // n, picture.shape[1] // n
    cells = picture.reshape(rows, n, columns, n).swapaxes(1, 2).reshape(rows * columns, -1)
    return cells - cells.mean(axis=1, keepdims=True)
