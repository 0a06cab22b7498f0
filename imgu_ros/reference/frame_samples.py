# SPDX-License-Identifier: Apache-2.0
"""A frame at the samples of a target's octave, where a homography puts the target: what verification compares."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from imgu_ros.image.frame_image import FrameImage
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.template_cells import CELL, CellMoments, TemplateCells
from imgu_ros.reference.templates import TemplateOctave
from imgu_ros.types import Floats, Image, Mask, Matrix3, Points
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.scale_space.pyramid import PixelScaling

#: Smallest distance of two samples, raw px. Measured: benchmarks/thresholds.py, study confirmation.
_FINEST_PX = 1.5
#: The same in a closer look. Measured: benchmarks/thresholds.py, study contradictions.
_FINEST_CLOSE_PX = 1.1
#: Most samples that are compared. Measured: benchmarks/thresholds.py, study confirmation.
_MOST_SAMPLES = 16000
#: Samples along each side of one of a closer look, and the blur of their mean, samples: that of a template's octave.
#: Measured: benchmarks/thresholds.py, study contradictions.
_DENSER, _SMOOTHED = 2, 0.5
#: Samples of a frame from those of a closer look.
_FROM_DENSER = PixelScaling(1 / _DENSER).full_from_reduced
#: Scaling of a frame halved so many times; no frame can be halved more often.
_HALVED = tuple(PixelScaling(2.0**times) for times in range(16))
#: Points along each side of a target by which the part in view is found.
_GRID = 9


@dataclass(frozen=True, slots=True, eq=False)
class PartInView:
    """The part of a target in view: (2, 2) its rectangle, template px, its share, and raw px in a template px."""

    window: Points
    share: float
    scale: float


@dataclass(frozen=True, slots=True, eq=False)
class FrameSamples:
    """A frame at the samples of the cells of an octave that may be in view.

    Attributes
    ----------
    image : (CELL * rows, CELL * columns) float32
    in_view : (rows, columns) cells that lie in the frame
    where : rows and columns of these cells among those of the octave
    cells : of the octave
    cell_area : of a cell in the frame, raw px
    """

    image: Image
    in_view: Mask
    where: tuple[slice, slice]
    cells: TemplateCells
    cell_area: float


@dataclass(frozen=True, slots=True, eq=False)
class SeenCells:
    """The cells of a frame that are compared with a target.

    Attributes
    ----------
    image : (CELL * rows, CELL * columns) float32, their samples
    mean, variance : (rows, columns) of each
    covariance : with the target's
    in_view : which lie in the frame
    known, where : the template's cells, and which of them are compared
    gain, offset : grey values of the frame are about gain * those of the template + offset
    """

    image: Image
    mean: Image
    variance: Image
    covariance: Image
    in_view: Mask
    known: CellMoments
    where: tuple[slice, slice]
    gain: float
    offset: float


def part_in_view(frame: FrameImage, target: Reference, H: Matrix3, camera: Camera | None) -> PartInView | None:
    """Return the part of a target in view; None where too little is.

    Parameters
    ----------
    frame, target, H, camera : as for `imgu_ros.reference.verification.require_confirmed`
    """
    width, height = target.size
    grid = _grid(width, height)
    mapped = H @ grid
    w = mapped[2]
    xy = mapped[:2] / w
    x, y = xy if camera is None else camera.raw_pixels(xy.T).T
    rows, columns = frame.shape
    inside = (x >= 0) & (x <= columns - 1) & (y >= 0) & (y <= rows - 1) & (w > 0)
    count = int(np.count_nonzero(inside))
    if count < 4:
        return None
    low, high = (-0.5, -0.5), (width - 0.5, height - 0.5)
    centre = grid[:, _GRID * _GRID // 2]
    if count < len(inside):
        shown = grid[:, inside]
        centre = shown.mean(axis=1)
        spacing = width / (_GRID - 1), height / (_GRID - 1)
        left, top, _ = shown.min(axis=1)
        right, bottom, _ = shown.max(axis=1)
        low = max(left - spacing[0], -0.5), max(top - spacing[1], -0.5)
        high = min(right + spacing[0], width - 0.5), min(bottom + spacing[1], height - 0.5)
    # The determinant of the local Jacobian is the scale of areas.
    area = abs(cv2.determinant(H) / float(H[2] @ centre) ** 3)
    if not 0 < area < math.inf:
        return None
    return PartInView(np.array((low, high)), count / len(inside), math.sqrt(area))


@lru_cache(maxsize=256)
def _grid(width: int, height: int) -> Floats:
    """Return points on a target, homogeneous template px, one a column."""
    x, y = np.meshgrid(np.linspace(-0.5, width - 0.5, _GRID), np.linspace(-0.5, height - 0.5, _GRID))
    grid = np.stack((x.ravel(), y.ravel(), np.ones(x.size)))
    grid.flags.writeable = False
    return grid


def octave_of(octaves: Sequence[TemplateOctave], size: tuple[int, int], part: PartInView, is_close: bool) -> int:
    """Return the finest octave whose samples are far enough apart in the frame, and not too many."""
    finest_px = _FINEST_CLOSE_PX if is_close else _FINEST_PX
    for index, octave in enumerate(octaves):
        samples = size[0] * size[1] * part.share / octave.scale**2
        if octave.scale * part.scale >= finest_px and samples <= _MOST_SAMPLES:
            return index
    return len(octaves) - 1


def frame_samples(
    frame: FrameImage, octave: TemplateOctave, H: Matrix3, camera: Camera | None, part: PartInView, is_close: bool
) -> FrameSamples | None:
    """Return a frame at the samples of an octave; None where they are too few.

    Parameters
    ----------
    frame, H, camera : as for `imgu_ros.reference.verification.require_confirmed`
    octave : of the target
    part : of it in view
    is_close : each sample is the mean over its area: fine patterns (screens of dots, bars) do not alias
    """
    cells: TemplateCells = octave.cells
    window = octave.scaling.from_full_unchecked(part.window)
    first = np.clip(np.floor((window[0] - (cells.x, cells.y)) / CELL), 0, None).astype(int)
    last = np.minimum(np.ceil((window[1] - (cells.x, cells.y)) / CELL), (cells.columns, cells.rows)).astype(int)
    columns, rows = (last - first).tolist()
    if columns < 2 or rows < 2:
        return None
    x, y = cells.x + CELL * first[0], cells.y + CELL * first[1]
    frame_from_samples = H @ octave.scaling.full_from_reduced @ np.array([[1, 0, x], [0, 1, y], [0, 0, 1.0]])
    spacing = octave.scale * part.scale
    image, in_view = _seen(frame, frame_from_samples, camera, (columns, rows), spacing, part.share, is_close)
    where = np.s_[first[1] : last[1], first[0] : last[0]]
    return FrameSamples(image, in_view, where, cells, (CELL * spacing) ** 2)


def _seen(
    frame: FrameImage,
    H: Matrix3,
    camera: Camera | None,
    cells: tuple[int, int],
    spacing: float,
    share: float,
    is_close: bool,
) -> tuple[Image, Mask]:
    """Return the frame at the samples of (columns, rows) cells, float32, and which cells are in view.

    It is taken from the level whose pixels are about as far apart as the samples, `spacing` raw px, or closer.
    """
    columns, rows = cells
    halvings = math.log2(max(spacing, 1.0))
    halvings = min(math.floor(halvings) if is_close else round(halvings), frame.most_halvings)
    picture, scaling = frame.halved(halvings), _HALVED[halvings]
    denser = _DENSER if is_close else 1
    size = denser * CELL * columns, denser * CELL * rows
    if camera is None:
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        M = scaling.reduced_from_full @ H
        if is_close:
            M = M @ _FROM_DENSER
        seen = cv2.warpPerspective(picture, M, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
        if share == 1.0:
            return _smoothed(seen, is_close), np.ones((rows, columns), bool)
    x, y = (CELL * np.arange(count + 1) - 0.5 for count in cells)
    places = np.empty((rows + 1, columns + 1, 2))
    places[..., 0], places[..., 1] = x, y[:, None]
    corners = _raw(places.reshape(-1, 2), H, camera)
    inside = _inside(corners, frame.shape).reshape(rows + 1, columns + 1)
    in_view = inside[:-1, :-1] & inside[1:, :-1] & inside[:-1, 1:] & inside[1:, 1:]
    if camera is None:
        return _smoothed(seen, is_close), in_view
    # A lens distorts hardly within a cell.
    reduced = scaling.from_full_unchecked(corners).astype(np.float32).reshape(rows + 1, columns + 1, 2)
    step = 1 / (denser * CELL)
    at = cv2.warpAffine(
        np.clip(reduced, -30000, 30000),
        np.array([[step, 0, step / 2], [0, step, step / 2]]),
        size,
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    seen = cv2.remap(picture, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return _smoothed(seen, is_close), in_view


def _smoothed(seen: Image, is_close: bool) -> Image:
    samples: Image = seen.astype(np.float32)
    if not is_close:
        return samples
    size = seen.shape[1] // _DENSER, seen.shape[0] // _DENSER
    return cv2.GaussianBlur(cv2.resize(samples, size, interpolation=cv2.INTER_AREA), (0, 0), _SMOOTHED)


def _raw(template_xy: Points, H: Matrix3, camera: Camera | None) -> Points:
    mapped = template_xy @ H[:, :2].T + H[:, 2]
    ideal = mapped[:, :2] / mapped[:, 2:]
    return ideal if camera is None else camera.raw_pixels(ideal)


def _inside(raw_xy: Points, shape: tuple[int, int]) -> Mask:
    inside: Mask = ((raw_xy >= 0) & (raw_xy <= (shape[1] - 1, shape[0] - 1))).all(axis=1)
    return inside
