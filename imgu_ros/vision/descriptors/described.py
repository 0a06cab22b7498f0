# SPDX-License-Identifier: Apache-2.0
"""What a descriptor returns for one image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imgu_ros.types import Image, Indices
from imgu_ros.vision.keypoints.keypoints import Corners
from imgu_ros.vision.keypoints.opencv import require_describable


@dataclass(frozen=True, slots=True, eq=False)
class Described:
    """Descriptors of some of the corners of one image.

    Attributes
    ----------
    index : (N,) which corners they describe, ascending
    descriptors : (N, D), a row for each
    """

    index: Indices
    descriptors: Image


def checked_corners(corners: Corners) -> Corners:
    """Return corners with float64 arrays, when they fit each other and are neither absurdly large nor far away.

    Raises
    ------
    ShapeError
        If they are.
    """
    require_describable(corners)
    return Corners(
        np.asarray(corners.xy, np.float64),
        np.asarray(corners.scale, np.float64),
        np.asarray(corners.angle, np.float64),
        np.asarray(corners.response, np.float64),
    )
