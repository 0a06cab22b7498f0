"""Changes to the grey picture before keypoints are sought: off by default."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from imgu_ros.params import PreprocessParameters
from imgu_ros.types import Image
from imgu_ros.vision.processing.derivatives import gradient
from imgu_ros.vision.processing.edges import canny
from imgu_ros.vision.processing.histograms import equalised, equalised_locally
from imgu_ros.vision.processing.points import adjust, gamma_corrected
from imgu_ros.vision.processing.thresholding import otsu_threshold, thresholded
from imgu_ros.vision.scale_space.gaussian import GaussianKernel, smooth

#: A slope of so many grey values per px becomes white: a step edge between black and mid-grey.
_WHITE_SLOPE = 63.75
#: Canny's thresholds, grey values per px.
_CANNY = (4.0, 10.0)


def preprocessed(
    grey: Image, parameters: PreprocessParameters, kernel: GaussianKernel | str = GaussianKernel.SAMPLED
) -> Image:
    """Apply the wanted steps: smoothing, contrast and brightness, gamma, equalisation, edges, threshold, in this order.

    Targets and frames go through the same steps before keypoints are sought and described. Alignment of patches does
    not: it matches brightness and contrast itself, and its precision lives in grey ramps that clamping, tile-wise
    equalisation and thresholds destroy.

    Parameters
    ----------
    grey : (H, W) uint8
    parameters : the steps
    kernel : Gaussian of the smoothing

    Returns
    -------
    (H, W) uint8; `grey` itself when nothing is wanted.

    Raises
    ------
    DegenerateConfiguration
        If Otsu's threshold is wanted of a picture of one value.
    """
    p = parameters
    if p.smoothing_px > 0:
        grey = smooth(grey, p.smoothing_px, kernel)
    if p.contrast != 1.0 or p.brightness != 0.0:
        grey = adjust(grey, p.contrast, p.brightness)
    if p.gamma != 1.0:
        grey = gamma_corrected(grey, p.gamma)
    grey = _EQUALISATIONS[p.equalisation](grey)
    grey = _EDGES[p.edges](grey)
    return _THRESHOLDS[p.threshold](grey, p.threshold_value)


def _strength(grey: Image) -> Image:
    return cv2.convertScaleAbs(gradient(grey).magnitude, alpha=255 / _WHITE_SLOPE)


def _canny(grey: Image) -> Image:
    # Lines of one pixel have no corners to hold on to: they are given a width.
    lines = canny(grey, *_CANNY).astype(np.uint8) * np.uint8(255)
    return smooth(cv2.dilate(lines, np.ones((3, 3), np.uint8)), 1.0)


_EQUALISATIONS: dict[str, Callable[[Image], Image]] = {
    "none": lambda grey: grey,
    "global": equalised,
    "clahe": equalised_locally,
}
_EDGES: dict[str, Callable[[Image], Image]] = {"none": lambda grey: grey, "strength": _strength, "canny": _canny}
_THRESHOLDS: dict[str, Callable[[Image, float], Image]] = {
    "none": lambda grey, _: grey,
    "fixed": thresholded,
    "otsu": lambda grey, _: thresholded(grey, otsu_threshold(grey)),
}
