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
from imgu_ros.vision.camera.intrinsics import Camera

#: Most patches that are compared. Measured: benchmarks/markers.py.
_MOST_PATCHES = 120
#: From this share of the patches on that agree, nothing is hidden.
_NOTHING_HIDDEN = 0.7


def edge_patches(
    reference: Reference, H: Matrix3, camera: Camera | None, shape: tuple[int, int]
) -> AlignedPatches | None:
    """Return the patches in view that hold the edges of a reference; None: it has no such.

    Parameters
    ----------
    reference, H : and H_image_template by which it is seen, ideal px
    camera : intrinsics when the lens distorts; else None
    shape : height and width of the frame
    """
    xy = reference.edge_patches(_scale(reference, H))
    if xy is None:
        return None
    x, y, w = H @ np.vstack((xy.T, np.ones(len(xy))))
    # The lens model is valid near the image only.
    near = np.flatnonzero((w > 0) & (np.maximum(np.abs(x), np.abs(y)) < 2 * max(shape) * w))
    at = np.column_stack((x[near], y[near])) / w[near, None]
    if camera is not None and len(near):
        at = camera.raw_pixels(at)
    in_view = ((at >= 0) & (at <= (shape[1] - 1, shape[0] - 1))).all(axis=1)
    chosen = xy[near[in_view][:_MOST_PATCHES]]
    return AlignedPatches(H, chosen, 0, len(chosen))


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
