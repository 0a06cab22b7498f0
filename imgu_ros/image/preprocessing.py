# SPDX-License-Identifier: Apache-2.0
"""Changes to the grey picture before keypoints are sought: off by default.

Targets and frames go through the same steps before keypoints are sought and described. Alignment of patches does not:
it matches brightness and contrast itself, and its precision lives in grey ramps that clamping, tile-wise equalisation
and thresholds destroy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2

from imgu_ros.config.parameters import PreprocessParameters
from imgu_ros.types import Image
from imgu_ros.vision.processing.derivatives import gradient
from imgu_ros.vision.processing.histograms import equalised, equalised_locally
from imgu_ros.vision.processing.points import adjust, gamma_corrected
from imgu_ros.vision.processing.thresholding import otsu_threshold, thresholded
from imgu_ros.vision.scale_space.gaussian import GaussianKernel, smooth
from imgu_ros.vision.scale_space.pyramid import Level, Pyramid

#: A slope of so many grey values per px becomes white: a step from black to mid-grey.
_WHITE_SLOPE = 64.0


def preprocessed(
    grey: Image, parameters: PreprocessParameters, kernel: GaussianKernel | str = GaussianKernel.SAMPLED
) -> Image:
    """Apply the wanted steps: smoothing, contrast and brightness, gamma, equalisation, threshold, in this order.

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
    return _THRESHOLDS[p.threshold](_EQUALISATIONS[p.equalisation](grey), p)


def for_targets(parameters: PreprocessParameters) -> PreprocessParameters:
    """Return the steps for pictures of targets: a fixed threshold becomes Otsu's.

    A fixed value speaks of the camera's exposure, which a target's picture does not know. Values that no step reads
    are at their defaults: equal steps treat a picture alike.
    """
    none = PreprocessParameters()
    otsu, edges = parameters.threshold != "none", parameters.edges != "none"
    return replace(
        parameters,
        derivative=(parameters if edges else none).derivative,
        threshold="otsu" if otsu else "none",
        threshold_value=none.threshold_value,
        threshold_bins=(parameters if otsu else none).threshold_bins,
    )


def with_edges(pyramid: Pyramid, parameters: PreprocessParameters) -> Pyramid:
    """Replace each level by the strength of its edges, when that is wanted.

    On every level, not before the pyramid is built: the gradient's length is no linear function of the picture, and a
    small view of a target shows the edges of that scale.

    Parameters
    ----------
    pyramid : of (H, W) uint8 images
    parameters : the steps

    Returns
    -------
    Levels min(255, 4 |gradient|), uint8; `pyramid` itself when nothing is wanted.
    """
    if parameters.edges == "none":
        return pyramid
    return Pyramid(tuple(Level(_strength(level.image, parameters.derivative), level.step) for level in pyramid.levels))


def _strength(grey: Image, derivative: str) -> Image:
    return cv2.convertScaleAbs(gradient(grey, derivative).magnitude, alpha=256 / _WHITE_SLOPE)


_EQUALISATIONS: dict[str, Callable[[Image], Image]] = {
    "none": lambda grey: grey,
    "global": equalised,
    "clahe": equalised_locally,
}
_THRESHOLDS: dict[str, Callable[[Image, PreprocessParameters], Image]] = {
    "none": lambda grey, _: grey,
    "fixed": lambda grey, p: thresholded(grey, p.threshold_value),
    "otsu": lambda grey, p: thresholded(grey, otsu_threshold(grey, p.threshold_bins)),
}
