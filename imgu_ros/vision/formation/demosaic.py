# SPDX-License-Identifier: Apache-2.0
"""Demosaicking: a colour at every site of a Bayer mosaic (IU 1.2.3)."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from imgu_ros.arguments import as_flag
from imgu_ros.types import Choice, Image
from imgu_ros.vision.formation.cfa import BayerPattern, as_mosaic
from imgu_ros.vision.formation.demosaicking.hamilton_adams import demosaic_hamilton_adams
from imgu_ros.vision.formation.demosaicking.malvar import demosaic_malvar
from imgu_ros.vision.formation.demosaicking.menon import demosaic_menon
from imgu_ros.vision.formation.demosaicking.opencv import demosaic_bilinear, demosaic_edge_aware
from imgu_ros.vision.formation.demosaicking.residual import demosaic_residual


class DemosaicMethod(Choice):
    """Demosaicking methods, from fast to good; `demosaic.method` of the pipeline."""

    BILINEAR = "bilinear"
    EDGE_AWARE = "edge_aware"
    MALVAR = "malvar"
    HAMILTON_ADAMS = "hamilton_adams"
    MENON = "menon"
    RESIDUAL = "residual"


def demosaic(raw: Image, pattern: BayerPattern, method: DemosaicMethod | str = DemosaicMethod.BILINEAR) -> Image:
    """Reconstruct colour from a Bayer mosaic.

    Parameters
    ----------
    raw : (H, W) uint8 or uint16, H and W at least 2
    pattern : colours of the top-left quad
    method : bilinear, edge_aware, malvar, hamilton_adams, menon or residual

    Returns
    -------
    (H, W, 3) RGB of the same data type. Measured values are kept; the mosaic continues beyond its border as its mirror
    image; results do not depend on the number of threads.

    Raises
    ------
    ShapeError
        If `raw` is not such an image, or the pattern or the method is unknown.

    Examples
    --------
    >>> import numpy as np
    >>> from imgu_ros.vision.formation import BayerPattern, mosaic
    >>> picture = np.full((6, 8, 3), (200, 120, 40), np.uint8)
    >>> raw = mosaic(picture, BayerPattern.GRBG)
    >>> raw[0, :4].tolist()
    [120, 200, 120, 200]
    >>> bool((demosaic(raw, BayerPattern.GRBG, "menon") == picture).all())
    True
    """
    return _METHODS[DemosaicMethod(method)](raw, pattern)


def grey_from_mosaic(raw: Image, pattern: BayerPattern, exact_border: bool = True) -> Image:
    """Reconstruct luma (0.299 R + 0.587 G + 0.114 B) by bilinear interpolation, without a colour picture between.

    Parameters
    ----------
    raw : (H, W) uint8 or uint16, H and W at least 2
    pattern : colours of the top-left quad
    exact_border : interpolate the outermost two pixels too; else the outermost one repeats its neighbour

    Returns
    -------
    (H, W) of the same data type

    Raises
    ------
    ShapeError
        If `raw` is not such an image or the pattern is unknown.

    Examples
    --------
    >>> import numpy as np
    >>> from imgu_ros.vision.formation import BayerPattern
    >>> grey_from_mosaic(np.full((4, 6), 77, np.uint8), BayerPattern.BGGR)[0].tolist()
    [77, 77, 77, 77, 77, 77]
    """
    exact_border = as_flag(exact_border, "exact_border")
    raw, pattern = as_mosaic(raw), BayerPattern(pattern)
    if min(raw.shape) < 3:
        return cv2.cvtColor(demosaic_bilinear(raw, pattern), cv2.COLOR_RGB2GRAY)
    grey = cv2.cvtColor(raw, GREY_OF_MOSAIC[pattern])
    return _repaired_border(grey, raw, pattern) if exact_border else grey


def _repaired_border(grey: Image, raw: Image, pattern: BayerPattern) -> Image:
    """Replace the one-pixel border, which OpenCV copies from its neighbours, by interpolation."""
    height, width = raw.shape
    grey[:, :2] = _strip(raw[:, : min(6, width)], pattern)[:, :2]
    grey[:2] = _strip(raw[: min(6, height)], pattern)[:2]
    bottom = max(0, height - 6)
    right = max(0, width - 6)
    grey[-2:] = _strip(raw[bottom:], pattern.shifted(bottom, 0))[-2:]
    grey[:, -2:] = _strip(raw[:, right:], pattern.shifted(0, right))[:, -2:]
    return grey


def _strip(raw: Image, pattern: BayerPattern) -> Image:
    # Mirror images about the outermost row or column keep the Bayer phase.
    extended = cv2.copyMakeBorder(np.ascontiguousarray(raw), 2, 2, 2, 2, cv2.BORDER_REFLECT_101)
    return cv2.cvtColor(extended, GREY_OF_MOSAIC[pattern])[2:-2, 2:-2]


# OpenCV names a Bayer pattern by the second row's second and third site: what ROS calls rggb is its "BG".
GREY_OF_MOSAIC = {
    BayerPattern.RGGB: cv2.COLOR_BayerBG2GRAY,
    BayerPattern.BGGR: cv2.COLOR_BayerRG2GRAY,
    BayerPattern.GRBG: cv2.COLOR_BayerGB2GRAY,
    BayerPattern.GBRG: cv2.COLOR_BayerGR2GRAY,
}
_METHODS: dict[DemosaicMethod, Callable[[Image, BayerPattern], Image]] = {
    DemosaicMethod.BILINEAR: demosaic_bilinear,
    DemosaicMethod.EDGE_AWARE: demosaic_edge_aware,
    DemosaicMethod.MALVAR: demosaic_malvar,
    DemosaicMethod.HAMILTON_ADAMS: demosaic_hamilton_adams,
    DemosaicMethod.MENON: demosaic_menon,
    DemosaicMethod.RESIDUAL: demosaic_residual,
}
