# SPDX-License-Identifier: Apache-2.0
"""What answers about printed targets are judged by: exact truth, and the usual recipes with OpenCV beside them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from print_canvas import Pixels
from print_drawing import Print
from print_views import HEIGHT, WIDTH, corners_of, mapped

Floats = NDArray[np.floating]

#: Corners within this, rms over the four, are found.
FOUND_PX = 10.0
#: 95 % point and median of chi-squared with 6 degrees of freedom.
NEES_95, NEES_MEDIAN = 12.59, 5.35
#: Error of the rotation beyond which a pose whose corners are right is the other planar solution.
FLIPPED_DEG = 10.0
#: A wrong place is a copy when this share of the print in view is compared and its grey values correlate as much: an
#: exact symmetry gives 0.999 and more, a poor print that is off by ten px up to 0.992.
_COPY_SHARE, _COPY_CORRELATION = 0.8, 0.995
#: The recipes: features, ratio of distances, threshold of RANSAC, and fewest inliers of an answer.
RECIPE_FEATURES, RECIPE_RATIO, RECIPE_PX, RECIPE_INLIERS = 1000, 0.75, 3.0, 10
RECIPES = ("SIFT", "ORB")


def corner_rms(H: Floats, true_H: Floats, shown: Print) -> float:
    """Return the rms distance of the four outer corners from their true places, px; infinite behind the camera."""
    corners = corners_of(shown)
    with np.errstate(all="ignore"):
        error = mapped(H, corners) - mapped(true_H, corners)
    if not np.isfinite(error).all() or (np.column_stack((corners, np.ones(4))) @ H[2] * np.sign(H[2, 2]) <= 0).any():
        return math.inf
    return float(np.sqrt((error**2).sum(axis=1).mean()))


def squared_error(R: Floats, t: Floats, covariance: Floats, true_R: Floats, true_t: Floats) -> float:
    """Return e^T C^-1 e of a pose, e = (t_true - t, log(R_true R^T)); chi-squared of 6 degrees of freedom."""
    e = np.concatenate((true_t - t, rotation_vector(true_R @ R.T)))
    return float(e @ np.linalg.solve(covariance, e))


def rotation_vector(R: Floats) -> Floats:
    """Return the logarithm of a rotation, (3,) rad."""
    return cv2.Rodrigues(np.asarray(R, np.float64))[0].ravel()


def is_copy(H: Floats, true_H: Floats, shown: Print) -> bool:
    """Return whether the print looks the same where H puts it as where it is.

    So it does where H differs by a symmetry of the print, or by one period of its pattern. Compared are the grey values
    that both homographies give to the px of the frame on the print, blurred as the frame does.
    """
    height, width = shown.pixels.shape[:2]
    size = np.array((width, height))
    grey = cv2.cvtColor(shown.pixels, cv2.COLOR_RGB2GRAY).astype(np.float32)
    seen = mapped(true_H, corners_of(shown)).astype(np.float32)
    scale = math.sqrt(width * height / max(abs(cv2.contourArea(seen)), 1.0))
    grey = cv2.GaussianBlur(grey, None, max(1.5 * scale, 0.3))
    y, x = np.mgrid[0:HEIGHT:2, 0:WIDTH:2]
    at = np.column_stack((x.ravel(), y.ravel())).astype(float)
    with np.errstate(all="ignore"):
        here, there = (mapped(np.linalg.inv(G), at) for G in (true_H, H))
        on_print = ((here > 0) & (here < size - 1)).all(axis=1)
        both = on_print & ((there > 0) & (there < size - 1)).all(axis=1)
    if both.sum() < max(_COPY_SHARE * on_print.sum(), 20):
        return False
    # As maps of the frame's shape: `cv2.remap` takes no side over 32767.
    grids = [np.where(both[:, None], uv, 0).astype(np.float32).reshape(*x.shape, 2) for uv in (here, there)]
    samples = [cv2.remap(grey, grid, None, cv2.INTER_LINEAR).ravel()[both] for grid in grids]
    if min(float(values.std()) for values in samples) < 1:
        return False
    return bool(np.corrcoef(*samples)[0, 1] >= _COPY_CORRELATION)


@dataclass(frozen=True, eq=False)
class Recipe:
    """Features of OpenCV, brute-force matching with the ratio test, and RANSAC.

    Attributes
    ----------
    detector : `cv2.SIFT` or `cv2.ORB`
    matcher : of its descriptors
    xy, descriptors : of the print
    """

    detector: cv2.Feature2D
    matcher: cv2.BFMatcher
    xy: Floats
    descriptors: Pixels | None

    @classmethod
    def of(cls, name: str, shown: Print) -> Recipe:
        """Return the recipe of one of `RECIPES` that knows a print."""
        is_sift = name == "SIFT"
        detector = cv2.SIFT_create(RECIPE_FEATURES) if is_sift else cv2.ORB_create(RECIPE_FEATURES)
        matcher = cv2.BFMatcher(cv2.NORM_L2 if is_sift else cv2.NORM_HAMMING)
        keypoints, descriptors = detector.detectAndCompute(cv2.cvtColor(shown.pixels, cv2.COLOR_RGB2GRAY), None)
        return cls(detector, matcher, np.array([k.pt for k in keypoints]).reshape(-1, 2), descriptors)

    def homography(self, grey: Pixels) -> Floats | None:
        """Return H_image_print; None where fewer than `RECIPE_INLIERS` agree."""
        keypoints, descriptors = self.detector.detectAndCompute(grey, None)
        if self.descriptors is None or descriptors is None or len(self.descriptors) < 2 or len(descriptors) < 2:
            return None
        # From the print to the frame, as the tutorials do.
        pairs = self.matcher.knnMatch(self.descriptors, descriptors, k=2)
        good = [m for m, n in (p for p in pairs if len(p) == 2) if m.distance < RECIPE_RATIO * n.distance]
        if len(good) < RECIPE_INLIERS:
            return None
        src = self.xy[[m.queryIdx for m in good]]
        dst = np.array([keypoints[m.trainIdx].pt for m in good])
        H, inliers = cv2.findHomography(src, dst, cv2.RANSAC, RECIPE_PX)
        return H if H is not None and np.count_nonzero(inliers) >= RECIPE_INLIERS else None
