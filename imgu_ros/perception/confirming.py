"""Whether a frame shows a target where an estimate says it is: the share of it that looks as it should.

Agreeing keypoints say that some part of a target is there; a part may also belong to another picture that shares it
(a logo, a header, a texture), and a chance agreement of a few leads nowhere. So the whole of the target is compared,
cell by cell, as far as it is in view.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from imgu_ros.errors import NoConsensus
from imgu_ros.perception.pictures import Pictures
from imgu_ros.perception.targets import Target
from imgu_ros.types import Floats, Image, Mask, Matrix3, Points
from imgu_ros.vision.camera.intrinsics import Camera

#: Cells along the longer side of what is in view, and samples along each side of a cell.
_CELLS, _SAMPLES = 8, 12
#: Correlation (ncc) from which on a cell looks as it should.
_ALIKE = 0.6
#: Standard deviation of a target's cell, grey values, below which it says nothing.
_FLAT = 4.0
_FEWEST_CELLS = 6
#: Of the cells in view, the share that must look as they should: half of what an occlusion of 20 % leaves.
_NEEDED_SHARE = 0.36


def require_confirmed(pictures: Pictures, target: Target, H: Matrix3, camera: Camera | None) -> None:
    """Raise `NoConsensus` when too little of a target looks as it should where an estimate says it is.

    Parameters
    ----------
    pictures : the frame's
    target : the target
    H : H_image_template in ideal px, the target in front of the camera
    camera : intrinsics when the lens distorts; else None
    """
    share = confirmed_share(pictures, target, H, camera)
    if share < _NEEDED_SHARE:
        raise NoConsensus(f"target: {share:.0%} of what is in view looks as it should; need {_NEEDED_SHARE:.0%}")


def confirmed_share(pictures: Pictures, target: Target, H: Matrix3, camera: Camera | None) -> float:
    """Return the share of a target's cells in view that the frame shows, 0 to 1; 0 where too few are in view.

    Parameters
    ----------
    pictures, target, H, camera : as for `require_confirmed`
    """
    width, height = target.size
    window = _window_in_view(pictures, H, camera, width, height)
    if window is None:
        return 0.0
    (left, top), (right, bottom) = window
    step = max(right - left, bottom - top) / (_CELLS * _SAMPLES)
    columns, rows = (max(1, round(extent / step / _SAMPLES)) for extent in (right - left, bottom - top))
    steps = (right - left) / (columns * _SAMPLES), (bottom - top) / (rows * _SAMPLES)
    x = left + (np.arange(columns * _SAMPLES) + 0.5) * steps[0]
    y = top + (np.arange(rows * _SAMPLES) + 0.5) * steps[1]
    template_xy = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    raw_xy = _raw(template_xy, H, camera)
    drawn = _drawn(target, (left, top), steps, (columns * _SAMPLES, rows * _SAMPLES))
    seen = _seen(pictures, raw_xy, drawn.shape)
    in_view = _inside(raw_xy, pictures.shape).reshape(drawn.shape)
    return _alike(drawn, seen, in_view)


def _window_in_view(pictures: Pictures, H: Matrix3, camera: Camera | None, width: int, height: int) -> Points | None:
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


def _drawn(target: Target, origin: Floats, steps: tuple[float, float], size: tuple[int, int]) -> Image:
    """Return the target, sampled from the corner `origin` at every `steps` px."""
    scales = np.array([octave.level.scale for octave in target.alignment])
    level = target.alignment[int(np.argmin(np.abs(np.log(scales / max(math.sqrt(steps[0] * steps[1]), 1.0)))))].level
    first = level.from_full(np.array([[origin[0] + steps[0] / 2, origin[1] + steps[1] / 2]]))[0]
    sx, sy = steps / level.step
    M = np.array([[sx, 0, first[0]], [0, sy, first[1]]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(level.image, M, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)


def _seen(pictures: Pictures, raw_xy: Points, shape: tuple[int, ...]) -> Image:
    """Return the frame at these places, from the picture whose pixels are about as far apart as they are."""
    grid = raw_xy.reshape(*shape, 2)
    along, down = np.diff(grid, axis=1)[:-1], np.diff(grid, axis=0)[:, :-1]
    areas = np.abs(along[..., 0] * down[..., 1] - along[..., 1] * down[..., 0])
    halvings = round(math.log2(max(math.sqrt(float(np.median(areas))), 1.0)))
    halvings = min(halvings, pictures.most_halvings)
    at = ((grid + 0.5) / 2**halvings - 0.5).astype(np.float32)
    return cv2.remap(pictures.halved(halvings), at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _alike(drawn: Image, seen: Image, in_view: Mask) -> float:
    a, b = _cells(drawn.astype(np.float32)), _cells(seen.astype(np.float32))
    a -= a.mean(axis=1, keepdims=True)
    b -= b.mean(axis=1, keepdims=True)
    power_a, power_b = (a * a).sum(axis=1), (b * b).sum(axis=1)
    counted = (power_a >= _FLAT**2 * a.shape[1]) & _cells(in_view).all(axis=1)
    if np.count_nonzero(counted) < _FEWEST_CELLS:
        return 0.0
    product = (a * b).sum(axis=1)
    alike = (product > 0) & (product * product >= _ALIKE**2 * power_a * power_b) & (power_b > 0)
    return float(np.count_nonzero(alike & counted) / np.count_nonzero(counted))


def _cells(picture: Image) -> Image:
    """Return the pixels of each cell in a row."""
    rows, columns = picture.shape[0] // _SAMPLES, picture.shape[1] // _SAMPLES
    return picture.reshape(rows, _SAMPLES, columns, _SAMPLES).swapaxes(1, 2).reshape(rows * columns, -1)
