"""Orientation of a patch by its intensity centroid (notes 5.5; Rosin 1999; Rublee 2011, section 3.2)."""

from __future__ import annotations

import cv2
import numpy as np

from imgu_ros.types import Floats, Image, Points, as_image, as_points


def centroid_orientation(image: Image, xy: Points, radius: int = 15) -> Floats:
    """Return the direction from each point to the centroid of intensity in a disc about it.

    Parameters
    ----------
    image : (H, W) uint8, uint16 or float32; reflected beyond its border
    xy : (N, 2) px, rounded to the nearest pixel
    radius : of the disc, px

    Returns
    -------
    (N,) rad in [-pi, pi], from x towards y; 0 for a patch without contrast.
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
    columns = np.clip(np.rint(xy[:, 0]).astype(np.intp), 0, image.shape[1] - 1) + radius
    rows = np.clip(np.rint(xy[:, 1]).astype(np.intp), 0, image.shape[0] - 1) + radius
    patches = padded[rows[:, None] + dy, columns[:, None] + dx].astype(np.float64)
    return np.asarray(np.arctan2(patches @ dy, patches @ dx), np.float64)
