# SPDX-License-Identifier: Apache-2.0
"""Orientation of a patch by its intensity centroid (IU 5.5; Rosin 1999; Rublee 2011, section 3.2)."""

from __future__ import annotations

import math

import cv2
import numpy as np

from imgu_ros.arguments import as_integer
from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Image, Points, as_image, as_matrix, as_points

#: Of the disc at the finest scale, px: what ORB looks at.
RADIUS_PX = 15
#: Sigma of a structure for which that disc is right: six sigma.
_SIGMA_PX = RADIUS_PX / 6
_RADII_PER_OCTAVE = 4
_LARGEST_RADIUS_PX = 1000

#: Patches gathered at once: bounds the memory.
_CHUNK = 4096


def centroid_orientation(image: Image, xy: Points, radius: int = RADIUS_PX) -> Floats:
    """Return the direction from each point to the centroid of intensity in a disc about it.

    Parameters
    ----------
    image : (H, W) uint8, uint16 or float32; reflected beyond its border
    xy : (N, 2) px, rounded to the nearest pixel
    radius : of the disc, 1 to 1000 px

    Returns
    -------
    (N,) rad in [-pi, pi), from x towards y; 0 for a patch without contrast.
    """
    radius = as_integer(radius, "radius")
    if not 1 <= radius <= _LARGEST_RADIUS_PX:
        raise ShapeError(f"radius: {radius}; need 1 to {_LARGEST_RADIUS_PX} px")
    image = as_image(image)
    xy = as_points(xy, "xy")
    if not len(xy):
        return np.zeros(0)
    offsets = np.arange(-radius, radius + 1)
    dx, dy = np.meshgrid(offsets, offsets)
    disc = dx**2 + dy**2 <= radius**2
    dx, dy = dx[disc], dy[disc]
    padded = cv2.copyMakeBorder(image, radius, radius, radius, radius, cv2.BORDER_REFLECT)
    columns = np.clip(np.rint(xy[:, 0]), 0, image.shape[1] - 1).astype(np.intp) + radius
    rows = np.clip(np.rint(xy[:, 1]), 0, image.shape[0] - 1).astype(np.intp) + radius
    angle = np.empty(len(xy))
    for start in range(0, len(xy), _CHUNK):
        some = slice(start, start + _CHUNK)
        patches = padded[rows[some, None] + dy, columns[some, None] + dx].astype(np.float64)
        if image.dtype == np.float32:
            # Sums of integers are exact; those of floats leave a rest where there is no contrast.
            patches -= patches[:, :1]
        angle[some] = np.arctan2(patches @ dy, patches @ dx)
    angle[angle >= math.pi] = -math.pi
    return angle


def scaled_orientation(image: Image, xy: Points, scale: Floats) -> Floats:
    """Return the direction from each point to the centroid of intensity in a disc of six times its scale.

    For structures of any size on one image: discs are laid on the image halved so often that their radii stay
    between 15 and 30 px.

    Parameters
    ----------
    image : (H, W) uint8, uint16 or float32; reflected beyond its border
    xy : (N, 2) px
    scale : (N,) px, sigma of the structures, > 0; below 2.5 px the disc's radius is 15 px

    Returns
    -------
    (N,) rad in [-pi, pi), from x towards y; 0 for a patch without contrast.

    Raises
    ------
    ShapeError
        If an argument is not of that kind.

    Examples
    --------
    >>> import numpy as np
    >>> ramp = np.tile(np.arange(200, dtype=np.uint8), (100, 1))
    >>> scaled_orientation(ramp, np.array([[100.0, 50.0]]), np.array([8.0])).round(3).tolist()
    [0.0]
    """
    image = as_image(image)
    xy = as_points(xy, "xy")
    scale = as_matrix(scale, (len(xy),), "scale")
    if len(xy) and not scale.min() > 0:
        raise ShapeError(f"scale: {scale.min():g}; need more than 0")
    # Steps of a quarter octave; no image needs more halvings than it has pixels on a side.
    halvings = math.ceil(math.log2(max(image.shape)))
    steps = np.clip(np.rint(_RADII_PER_OCTAVE * np.log2(scale / _SIGMA_PX)), 0, _RADII_PER_OCTAVE * halvings)
    angle = np.empty(len(xy))
    for step in np.unique(steps):
        some = np.flatnonzero(steps == step)
        octave, part = divmod(int(step), _RADII_PER_OCTAVE)
        size = [max(1, round(side / 2**octave)) for side in image.shape[1::-1]]
        reduced = image if octave == 0 else cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        there = (xy[some] + 0.5) * np.array(size) / np.array(image.shape[1::-1]) - 0.5
        angle[some] = centroid_orientation(reduced, there, round(RADIUS_PX * 2 ** (part / _RADII_PER_OCTAVE)))
    return angle
