# SPDX-License-Identifier: Apache-2.0
"""Keypoints, as a structure of arrays."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from imgu_ros.arguments import require_type
from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Indices, Mask, Points
from imgu_ros.vision.scale_space.pyramid import Level


@dataclass(frozen=True, slots=True, eq=False)
class Corners:
    """N keypoints of one image, as a detector finds them.

    Attributes
    ----------
    xy : (N, 2) px of that image
    scale : (N,) px, sigma of the structure
    angle : (N,) rad in [-pi, pi), from x towards y; 0 where the detector gives none
    response : (N,) larger is stronger
    """

    xy: Points
    scale: Floats
    angle: Floats
    response: Floats

    def chosen(self, which: Indices | Mask) -> Corners:
        """Return the keypoints of the given indices or mask.

        Raises
        ------
        ShapeError
            If `which` is neither indices below N nor a mask of N.
        """
        which = _as_choice(which, len(self.xy))
        return Corners(self.xy[which], self.scale[which], self.angle[which], self.response[which])


@dataclass(frozen=True, slots=True, eq=False)
class Keypoints:
    """N keypoints of one image.

    Attributes
    ----------
    xy : (N, 2) px of the full-resolution image
    scale : (N,) px, sigma of the structure in the full-resolution image
    angle : (N,) rad in [-pi, pi), from x towards y (clockwise as seen); 0 where the detector gives none
    response : (N,) strength; larger is stronger
    octave : (N,) int32, the pyramid level that it was found on
    """

    xy: Points
    scale: Floats
    angle: Floats
    response: Floats
    octave: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.xy)

    def chosen(self, which: Indices | Mask) -> Keypoints:
        """Return the keypoints of the given indices or mask.

        Raises
        ------
        ShapeError
            If `which` is neither indices below N nor a mask of N.
        """
        which = _as_choice(which, len(self.xy))
        return Keypoints(self.xy[which], self.scale[which], self.angle[which], self.response[which], self.octave[which])

    def rounded_to_float32(self) -> Keypoints:
        """Return the keypoints with their positions rounded to float32, as messages carry them.

        A subscriber that estimates a homography from published keypoints then gets the same one, to the last digit.
        """
        return replace(self, xy=self.xy.astype(np.float32).astype(np.float64))


def on_level(keypoints: Keypoints, level: Level) -> Corners:
    """Return the keypoints in the coordinates of a pyramid level."""
    require_type(keypoints, Keypoints, "keypoints")
    require_type(level, Level, "level")
    return Corners(level.from_full(keypoints.xy), keypoints.scale / level.scale, keypoints.angle, keypoints.response)


def _as_choice(which: ArrayLike, count: int) -> Indices | Mask:
    """Return `which` as a mask of `count`, or as indices below it."""
    try:
        chosen = np.asarray(which)
    except (TypeError, ValueError) as error:
        raise ShapeError(f"which: {error}; need numbers") from None
    if chosen.ndim == 1 and chosen.dtype.kind == "b" and len(chosen) == count:
        return np.asarray(chosen, bool)
    if chosen.ndim != 1 or chosen.dtype.kind not in "iu":
        raise ShapeError(f"which: shape {chosen.shape} {chosen.dtype}; need (M,) integers or ({count},) bool")
    if len(chosen) and not -count <= int(chosen.min()) <= int(chosen.max()) < count:
        raise ShapeError(f"which: {chosen.min()} to {chosen.max()}; need 0 to {count - 1}")
    return np.asarray(chosen, np.intp)
