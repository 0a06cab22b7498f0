# SPDX-License-Identifier: Apache-2.0
"""Which of a target's patches a picture should show, and where: octave, view, and the squares that hold them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imgu_ros.errors import NoConsensus
from imgu_ros.reference.reference import Reference
from imgu_ros.types import Floats, Indices, Matrix3, Points
from imgu_ros.vision.camera.distortion import bend
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.matching.alignment import LocalDistortion, Patches
from imgu_ros.vision.matching.patch_atlas import TALLEST_PX, PatchAtlas
from imgu_ros.vision.matching.patch_bank import PatchBank
from imgu_ros.vision.projective.transform import area_factor

#: Margin around the patches of an atlas, px: for their motion, for interpolation, and for demosaicking. Measured:
#: benchmarks/thresholds.py, study tracking.
_SHEET_ROOM_PX = 4
#: Largest area of an atlas, as a share of the frame: a larger one saves nothing. Measured: benchmarks/thresholds.py,
#: study tracking.
_SHEET_SHARE = 0.4
#: Side of a square, px, that is too large for any atlas.
_NO_SIDE = 1_000_000
#: Factor by which lens distortion may enlarge patches. Measured: benchmarks/thresholds.py, study tracking.
_MOST_STRETCHED = 1.3


class Bank:
    """A target's patches at one of its octaves, and the way to and from them; `step`: template px in one of its."""

    def __init__(self, patches: PatchBank, step: Floats) -> None:
        self.patches = patches
        sx, sy = step
        self.template_from_bank = np.array([[sx, 0, (sx - 1) / 2], [0, sy, (sy - 1) / 2], [0, 0, 1]])
        self.bank_from_template = np.array([[1 / sx, 0, 0.5 / sx - 0.5], [0, 1 / sy, 0.5 / sy - 0.5], [0, 0, 1]])
        self._step = step

    def template_xy(self, xy: Points) -> Points:
        """Map the bank's px to the template's."""
        return np.asarray((xy + 0.5) * self._step - 0.5)


class Reduction:
    """Full-resolution px to px of a picture reduced by `scale`, 1 or less; pixel areas are aligned."""

    def __init__(self, scale: float) -> None:
        self.scale = scale
        shift = (scale - 1) / 2
        self.matrix = np.array([[scale, 0, shift], [0, scale, shift], [0, 0, 1]])
        self.inverse = np.array([[1 / scale, 0, -shift / scale], [0, 1 / scale, -shift / scale], [0, 0, 1]])

    def to_full(self, xy: Points) -> Points:
        """Map px of the picture to full resolution."""
        return np.asarray((xy + 0.5) / self.scale - 0.5)

    def to_picture(self, xy: Points) -> Points:
        """Map full-resolution px to the picture."""
        return np.asarray((xy + 0.5) * self.scale - 0.5)

    def bend(self, camera: Camera, picture_from_bank: Matrix3, centres: Points) -> LocalDistortion:
        """Return how a camera's lens bends the picture about patches' centres, px of the bank."""
        straight = mapped(picture_from_bank, centres)
        return LocalDistortion(straight, *self._bent(camera, straight))

    def bent(self, camera: Camera, straight: Points) -> Points:
        """Return where ideal px of the picture are seen through a camera's lens."""
        return self._bent(camera, straight)[0]

    def _bent(self, camera: Camera, straight: Points) -> tuple[Points, Floats]:
        K = camera.K
        square = K[:2, :2]
        inverse = np.linalg.inv(square)
        normalised = (self.to_full(straight) - K[:2, 2]) @ inverse.T
        xy, by_xy = bend(camera.model, camera.distortion, normalised)
        return self.to_picture(xy @ square.T + K[:2, 2]), square @ by_xy @ inverse


def fitting_bank(target: Reference, linear: bool, H: Matrix3, scale: float, window_px: int) -> Bank:
    """Return the patches of the octave whose pixels come out nearest in size to the picture's.

    Parameters
    ----------
    target : the target
    linear : whether the picture's values go with the light
    H : H_image_template
    scale : of the picture, 1: full resolution
    window_px : side of a patch

    Raises
    ------
    NoConsensus
        If no octave has a patch.
    """
    width, height = target.size
    pixels = math.sqrt(area_factor(H, ((width - 1) / 2, (height - 1) / 2))) * scale
    nearest = sorted(target.templates[linear], key=lambda octave: abs(math.log(octave.level.scale * max(pixels, 1e-9))))
    best = next((octave for octave in nearest if len(octave.corners)), None)
    if best is None:
        raise NoConsensus("patches: the target has none; need texture")
    return Bank(best.patches(window_px), best.level.step)


@dataclass(frozen=True, slots=True, eq=False)
class InView:
    """Which patches lie in the picture, (N,), and where, (N, 2) px."""

    chosen: Indices
    xy: Points


def in_view(
    patches: PatchBank,
    picture_from_bank: Matrix3,
    shape: tuple[int, int],
    reduced: Reduction,
    camera: Camera | None,
    window_px: int,
    most: int,
) -> InView:
    """Return the best spread of the patches that should lie in a picture.

    Parameters
    ----------
    patches : of one octave
    picture_from_bank : (3, 3) ideal px of the picture from the bank's
    shape : height and width of the picture
    reduced : by how much it is
    camera : intrinsics when the lens distorts; else None
    window_px : side of a patch
    most : no more than this
    """
    height, width = shape
    x, y, w = picture_from_bank @ patches.homogeneous
    inside = w > 0
    w = np.where(inside, w, 1.0)
    x /= w
    y /= w
    if camera is not None:
        # Far outside, the lens model may be anything: near it is what counts.
        inside &= (np.abs(x) < 2 * max(shape)) & (np.abs(y) < 2 * max(shape))
        near = np.flatnonzero(inside)
        if len(near):
            x[near], y[near] = reduced.bent(camera, np.column_stack((x[near], y[near]))).T
    margin = window_px // 2 + 2
    inside &= (x >= margin) & (x < width - margin) & (y >= margin) & (y < height - margin)
    # The centres come best spread first: so do those in view.
    chosen = np.flatnonzero(inside)[:most]
    return InView(chosen, np.column_stack((x[chosen], y[chosen])))


def _square_side(picture_from_bank: Matrix3, bounds: Sequence[float], window_px: float) -> int:
    """Return the side, px of the picture, of a square about a patch that holds it, wherever within `bounds` it is.

    A homography enlarges most at a corner of what holds all centres: left, top, right, bottom.
    """
    (a, b, c), (d, e, f), (g, h, i) = picture_from_bank.tolist()
    left, top, right, bottom = bounds
    by_centre = 0.0
    for x, y in ((left, top), (right, top), (right, bottom), (left, bottom)):
        w = g * x + h * y + i
        if not w > 0:
            return _NO_SIDE
        u, v = (a * x + b * y + c) / w, (d * x + e * y + f) / w
        by_centre = max(by_centre, (abs(a - u * g) + abs(b - u * h)) / w, (abs(d - v * g) + abs(e - v * h)) / w)
    return 2 * math.ceil(min(by_centre * (window_px // 2) + _SHEET_ROOM_PX, _NO_SIDE))


def sheet_of(
    patches: Patches, xy: Points, picture_from_bank: Matrix3, shape: tuple[int, int], window_px: int, bent: bool
) -> PatchAtlas | None:
    """Return the squares of a picture that hold patches; None when that saves little.

    Parameters
    ----------
    patches : N of them
    xy : (N, 2) px of the picture, where they are seen
    picture_from_bank : (3, 3) ideal px of the picture from the bank's
    shape : height and width of the picture
    window_px : side of a patch
    bent : whether a lens bends the picture
    """
    height, width = shape
    side = _square_side(picture_from_bank, patches.bounds, window_px * (_MOST_STRETCHED if bent else 1.0))
    too_large = len(xy) * side**2 > _SHEET_SHARE * height * width or len(xy) * side > TALLEST_PX
    if too_large or side > min(shape) - 2:
        return None
    # Even pixels: there a quad of the mosaic begins.
    origins = (np.rint(xy).astype(np.intp) - side // 2) & -2
    np.minimum(origins, ((width - side) & -2, (height - side) & -2), out=origins)
    return PatchAtlas(np.maximum(origins, 0, out=origins), side)


def mapped(H: Matrix3, points: Points) -> Points:
    """Map points, (N, 2), that a homography is known to leave in front of the camera."""
    at = points @ H[:, :2].T + H[:, 2]
    return np.asarray(at[:, :2] / at[:, 2:])
