"""Keypoints, as a structure of arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imgu_ros.types import Floats, Points


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
