# SPDX-License-Identifier: Apache-2.0
"""Bilinear and edge-aware interpolation by OpenCV, with the border interpolated as well."""

from __future__ import annotations

import cv2

from imgu_ros.types import Image
from imgu_ros.vision.formation.cfa import BayerPattern, as_mosaic


def demosaic_bilinear(raw: Image, pattern: BayerPattern) -> Image:
    """Reconstruct colour by the mean of each colour's nearest sites (OpenCV): the fastest, with coloured edges.

    Parameters
    ----------
    raw : (H, W) uint8 or uint16, H and W at least 2
    pattern : colours of the top-left quad

    Returns
    -------
    (H, W, 3) RGB of the same data type; measured values are kept, linear ramps are exact away from the border.

    Raises
    ------
    ShapeError
        If `raw` is not such an image or the pattern is unknown.

    Examples
    --------
    >>> import numpy as np
    >>> from imgu_ros.vision.formation import BayerPattern
    >>> raw = np.array([[100, 10, 100], [20, 70, 30], [100, 12, 100]], np.uint8)
    >>> demosaic_bilinear(raw, BayerPattern.RGGB)[1, 1].tolist()
    [100, 18, 70]
    """
    return _converted(raw, _BILINEAR[BayerPattern(pattern)])


def demosaic_edge_aware(raw: Image, pattern: BayerPattern) -> Image:
    """Reconstruct colour bilinearly, green along the row or the column in which it changes less (OpenCV).

    Parameters
    ----------
    raw : (H, W) uint8 or uint16, H and W at least 2
    pattern : colours of the top-left quad

    Returns
    -------
    (H, W, 3) RGB of the same data type; measured values are kept.

    Raises
    ------
    ShapeError
        If `raw` is not such an image or the pattern is unknown.

    Examples
    --------
    >>> import numpy as np
    >>> from imgu_ros.vision.formation import BayerPattern
    >>> raw = np.array([[100, 10, 100], [20, 70, 20], [100, 90, 100]], np.uint8)
    >>> demosaic_edge_aware(raw, BayerPattern.RGGB)[1, 1].tolist()
    [100, 20, 70]
    """
    return _converted(raw, _EDGE_AWARE[BayerPattern(pattern)])


def _converted(raw: Image, code: int) -> Image:
    # OpenCV copies the outermost rows and columns from their neighbours instead of interpolating them: on a mosaic
    # extended by mirror images about its outermost sites, which keeps the Bayer phase, its border is ours to cut away.
    extended = cv2.copyMakeBorder(as_mosaic(raw), 2, 2, 2, 2, cv2.BORDER_REFLECT_101)
    return cv2.cvtColor(extended, code)[2:-2, 2:-2].copy()


# OpenCV names a Bayer pattern by the second row's second and third site: what ROS calls rggb is its "BG".
_BILINEAR = {
    BayerPattern.RGGB: cv2.COLOR_BayerBG2RGB,
    BayerPattern.BGGR: cv2.COLOR_BayerRG2RGB,
    BayerPattern.GRBG: cv2.COLOR_BayerGB2RGB,
    BayerPattern.GBRG: cv2.COLOR_BayerGR2RGB,
}
_EDGE_AWARE = {
    BayerPattern.RGGB: cv2.COLOR_BayerBG2RGB_EA,
    BayerPattern.BGGR: cv2.COLOR_BayerRG2RGB_EA,
    BayerPattern.GRBG: cv2.COLOR_BayerGB2RGB_EA,
    BayerPattern.GBRG: cv2.COLOR_BayerGR2RGB_EA,
}
