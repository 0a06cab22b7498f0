# SPDX-License-Identifier: Apache-2.0
"""Descriptors at keypoints of a pyramid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from imgu_ros.arguments import require_type
from imgu_ros.errors import ShapeError
from imgu_ros.types import Image, Indices, as_matrix, as_points
from imgu_ros.vision.keypoints.keypoints import Keypoints, on_level
from imgu_ros.vision.methods import DESCRIPTORS, DescriptorMethod, method_named
from imgu_ros.vision.scale_space.pyramid import Pyramid


@dataclass(frozen=True, slots=True, eq=False)
class Descriptions:
    """Descriptors with the keypoints that they describe.

    Attributes
    ----------
    keypoints : those that could be described, N of them
    descriptors : (N, D); (N, 32) uint8 for orb and brief, (N, 128) float32 for sift and rootsift, (N, 169) float32 for
        patch
    """

    keypoints: Keypoints
    descriptors: Image


def describe(
    pyramid: Pyramid, keypoints: Keypoints, kind: DescriptorMethod | str = "orb", parameters: Any = None
) -> Descriptions:
    """Describe keypoints, each on the level of the pyramid that fits its scale; those too near a border are dropped.

    Parameters
    ----------
    pyramid : of the (H, W) uint8 image that the keypoints were found on
    keypoints : in full-resolution coordinates
    kind : orb, sift, rootsift, brief, patch, or the row of another one (see `imgu_ros.vision.methods`)
    parameters : the descriptor's own; None: its defaults

    Raises
    ------
    ShapeError
        If a keypoint names a level that the pyramid lacks, their arrays do not fit each other or are not finite, or the
        descriptor is unknown or finds its own keypoints.

    Examples
    --------
    >>> import numpy as np
    >>> from imgu_ros.vision.scale_space import build_pyramid
    >>> pyramid = build_pyramid(np.random.default_rng(0).integers(0, 256, (90, 90), np.uint8), levels=1)
    >>> one = np.ones(1)
    >>> point = Keypoints(np.array([[45.0, 45.0]]), 2 * one, 0 * one, one, np.zeros(1, np.int32))
    >>> describe(pyramid, point, "rootsift").descriptors.shape
    (1, 128)
    """
    require_type(pyramid, Pyramid, "pyramid")
    require_type(keypoints, Keypoints, "keypoints")
    row = kind if isinstance(kind, DescriptorMethod) else method_named(DESCRIPTORS, kind, "kind")
    if row.detects:
        raise ShapeError(f"kind: {row.name!r} finds its own keypoints; need a descriptor of given ones")
    keypoints = _checked(keypoints)
    if len(keypoints) and not 0 <= int(keypoints.octave.min()) <= int(keypoints.octave.max()) < len(pyramid.levels):
        raise ShapeError(f"keypoints.octave: up to {keypoints.octave.max()}; need 0 to {len(pyramid.levels) - 1}")
    rows: list[Image] = []
    kept: list[Indices] = []
    function = row.made(parameters)
    for index, level in enumerate(pyramid.levels):
        chosen = np.flatnonzero(keypoints.octave == index)
        if not len(chosen):
            continue
        described = function(level.image, on_level(keypoints.chosen(chosen), level))
        rows.append(described.descriptors)
        kept.append(chosen[described.index])
    if not rows:
        return Descriptions(keypoints.chosen(np.zeros(0, np.intp)), empty_descriptors(row))
    return Descriptions(keypoints.chosen(np.concatenate(kept)), np.concatenate(rows))


def empty_descriptors(kind: DescriptorMethod | str) -> Image:
    """Return no descriptors of a kind, (0, D) uint8 or float32.

    Examples
    --------
    >>> empty_descriptors("patch").shape
    (0, 169)
    """
    row = kind if isinstance(kind, DescriptorMethod) else method_named(DESCRIPTORS, kind, "kind")
    return np.zeros((0, row.columns), np.uint8 if row.is_binary else np.float32)


def _checked(keypoints: Keypoints) -> Keypoints:
    xy = as_points(keypoints.xy, "keypoints.xy")
    scale, angle, response, octave = (
        as_matrix(getattr(keypoints, name), (len(xy),), f"keypoints.{name}")
        for name in ("scale", "angle", "response", "octave")
    )
    if not (np.abs(octave) < _LARGEST_OCTAVE).all() or (octave != np.rint(octave)).any():
        raise ShapeError("keypoints.octave: fractions or out of range; need the numbers of levels")
    return Keypoints(xy, scale, angle, response, octave.astype(np.int32))


_LARGEST_OCTAVE = 2**31
