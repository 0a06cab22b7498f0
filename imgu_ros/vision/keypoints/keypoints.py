"""Keypoints, as a structure of arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imgu_ros.types import Floats, Indices, Mask, Points
from imgu_ros.vision.scale_space.pyramid import Level


@dataclass(frozen=True, slots=True, eq=False)
class Corners:
    """N keypoints of one picture, as a detector finds them.

    Attributes
    ----------
    xy : (N, 2) px of that picture
    scale : (N,) px, sigma of the structure
    angle : (N,) rad in [-pi, pi), from x towards y; 0 where the detector gives none
    response : (N,) larger is stronger
    """

    xy: Points
    scale: Floats
    angle: Floats
    response: Floats

    def chosen(self, which: Indices | Mask) -> Corners:
        """Return the keypoints of the given indices or mask."""
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
        """Return the keypoints of the given indices or mask."""
        return Keypoints(self.xy[which], self.scale[which], self.angle[which], self.response[which], self.octave[which])


def on_level(keypoints: Keypoints, level: Level) -> Corners:
    """Return the keypoints in the coordinates of a pyramid level."""
    return Corners(level.from_full(keypoints.xy), keypoints.scale / level.scale, keypoints.angle, keypoints.response)
