"""Orientation of a patch by its intensity centroid (notes 5.5; Rosin 1999; Rublee 2011, section 3.2)."""

from __future__ import annotations

import math

import cv2
import numpy as np

from imgu_ros.types import Floats, Image, Points, as_image, as_points

#: Patches gathered at once: bounds the memory.
_CHUNK = 4096


def centroid_orientation(image: Image, xy: Points, radius: int = 15) -> Floats:
    """Return the direction from each point to the centroid of intensity in a disc about it.

    Parameters
    ----------
    image : (H, W) uint8, uint16 or float32; reflected beyond its border
    xy : (N, 2) px, rounded to the nearest pixel
    radius : of the disc, px

    Returns
    -------
    (N,) rad in [-pi, pi), from x towards y; 0 for a patch without contrast.
    """
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
