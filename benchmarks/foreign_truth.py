# SPDX-License-Identifier: Apache-2.0
"""Is the truth of benchmarks/foreign_frames.py true? Dots of a test print, found by their centroids."""

from __future__ import annotations

import cv2
import numpy as np
from foreign_prints import DOT_RADIUS_PX, DOT_STEP_PX, dot_centres
from foreign_rows import ForeignTake
from foreign_scenes import homography, on_print, projected

from imgu_ros.types import Floats

#: Frames are judged only when dots are where the truth has them to this, rms px.
MOST_PX = 0.02
_FEWEST_DOTS = 12
_MARGIN_PX = 20.0


def dot_errors(shown: ForeignTake, light: Floats, time_s: float) -> Floats:
    """Return by how much the centroids of dots are off, (N, 2) px.

    A centroid is compared with that of the disc's edge as the truth projects it: perspective and lens move it away from
    the projection of the disc's middle.

    Parameters
    ----------
    shown : with the test print
    light : (height, width, 3) linear light
    time_s : of the frame
    """
    optics = shown.optics
    picture = light.sum(axis=2)
    pixels = np.stack(np.meshgrid(np.arange(optics.width), np.arange(optics.height)), axis=-1).reshape(-1, 1, 2)
    ideal = cv2.undistortPoints(pixels.astype(np.float64), optics.K, np.array(optics.distortion), P=optics.K)
    # For this, the pose of the middle row is near enough: which pixels are a dot's.
    to_print = np.linalg.inv(homography(optics.K, *shown.path(time_s), shown.size))
    xyw = cv2.convertPointsToHomogeneous(ideal).reshape(-1, 3) @ to_print.T
    place = (xyw[:, :2] / xyw[:, 2:]).reshape(optics.height, optics.width, 2)
    circle = _circle()
    errors = []
    for centre in dot_centres():
        edge = projected(optics, shown.path, time_s, on_print(centre + circle, shown.size))
        expected = polygon_centroid(edge)
        limit = (optics.width - 1 - _MARGIN_PX, optics.height - 1 - _MARGIN_PX)
        if not ((expected > _MARGIN_PX) & (expected < limit)).all():
            continue
        found = _centroid(picture, np.linalg.norm(place - centre, axis=2))
        errors.append(found - expected)
    if len(errors) < _FEWEST_DOTS:
        raise SystemExit(f"truth: {len(errors)} dots in the frame; need {_FEWEST_DOTS}")
    return np.array(errors)


def _circle() -> Floats:
    angles = np.arange(180) * 2 * np.pi / 180
    return DOT_RADIUS_PX * np.column_stack((np.cos(angles), np.sin(angles)))


def polygon_centroid(xy: Floats) -> Floats:
    """Return the centroid of a polygon's area, (2,), of its corners, (N, 2)."""
    following = np.roll(xy, -1, axis=0)
    cross = xy[:, 0] * following[:, 1] - following[:, 0] * xy[:, 1]
    return np.asarray((xy + following).T @ cross / (3 * cross.sum()))


def _centroid(picture: Floats, distance: Floats) -> Floats:
    """Return the centroid of a dot's darkness below a plane through the white about it."""
    near = distance < 0.5 * DOT_STEP_PX
    y, x = np.nonzero(near)
    values, away = picture[near], distance[near]
    white = away > 1.55 * DOT_RADIUS_PX
    design = np.column_stack((np.ones(len(x)), x - x.mean(), y - y.mean()))
    plane = design @ np.linalg.lstsq(design[white], values[white], rcond=None)[0]
    # Shading multiplies.
    darkness = np.where(white, 0.0, 1 - values / plane)
    return np.array([(darkness * x).sum(), (darkness * y).sum()]) / darkness.sum()
