# SPDX-License-Identifier: Apache-2.0
"""Patches that hold every edge of a reference: for those that are small, or whose edges are known exactly."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np

from imgu_ros.reference.reference import Reference
from imgu_ros.track.sample_refinement import AlignedPatches
from imgu_ros.types import Matrix3

#: From this share of the patches on that agree, nothing is hidden.
_NOTHING_HIDDEN = 0.7


def edge_patches(reference: Reference, H: Matrix3) -> AlignedPatches | None:
    """Return the patches that hold every edge of a reference that is seen by H_image_template; None: it has no such."""
    xy = reference.edge_patches(_scale(reference, H))
    return None if xy is None else AlignedPatches(H, xy, 0, len(xy))


def edge_patches_near(
    reference: Reference, edges: AlignedPatches, agreeing: AlignedPatches, window_px: int
) -> AlignedPatches:
    """Return such patches where a reference was aligned: where a part is hidden, without those that lie there.

    Parameters
    ----------
    reference, edges : the reference, and all of them
    agreeing : patches that agree
    window_px : side of these
    """
    xy = edges.template_xy
    if len(agreeing.template_xy) < _NOTHING_HIDDEN * agreeing.sought:
        apart = np.abs(xy[:, None] - agreeing.template_xy).max(axis=2).min(axis=1)
        xy = xy[apart * _scale(reference, agreeing.H) <= window_px / 2]
    return replace(edges, H=agreeing.H, template_xy=xy, sought=len(xy))


def _scale(reference: Reference, H: Matrix3) -> float:
    """Return the px of the frame in one px of the template, in the middle; 0 behind the camera."""
    width, height = reference.size
    w = float(H[2] @ (width / 2, height / 2, 1))
    return math.sqrt(abs(cv2.determinant(H) / w**3)) if w > 0 else 0.0
