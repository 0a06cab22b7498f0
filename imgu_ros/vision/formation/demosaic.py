"""Demosaicking: a colour at every site of a Bayer mosaic (notes 1.2.3)."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from imgu_ros.errors import ShapeError
from imgu_ros.types import Choice, Image, as_image
from imgu_ros.vision.formation.cfa import BayerPattern, site_mask


class DemosaicMethod(Choice):
    """Demosaicking methods, from fast to good."""

    BILINEAR = "bilinear"
    EDGE_AWARE = "edge_aware"
    MALVAR = "malvar"


def demosaic(raw: Image, pattern: BayerPattern, method: DemosaicMethod | str = DemosaicMethod.BILINEAR) -> Image:
    """Reconstruct colour from a Bayer mosaic.

    Parameters
    ----------
    raw : (H, W) uint8 or uint16, H and W at least 2
    pattern : colours of the top-left quad
    method : bilinear (OpenCV), edge_aware (OpenCV's interpolation along edges), or malvar (gradient-corrected
        linear interpolation, Malvar, He & Cutler 2004)

    Returns
    -------
    (H, W, 3) RGB of the same data type

    Raises
    ------
    ShapeError
        If `raw` is not such an image, or the pattern or the method is unknown.
    """
    raw = _as_mosaic(raw)
    return _METHODS[DemosaicMethod(method)](raw, BayerPattern(pattern))


def grey_from_mosaic(raw: Image, pattern: BayerPattern) -> Image:
    """Reconstruct luma (0.299 R + 0.587 G + 0.114 B) by bilinear interpolation, without a colour picture between.

    Parameters
    ----------
    raw : (H, W) uint8 or uint16, H and W at least 2
    pattern : colours of the top-left quad

    Returns
    -------
    (H, W) of the same data type

    Raises
    ------
    ShapeError
        If `raw` is not such an image or the pattern is unknown.
    """
    raw, pattern = _as_mosaic(raw), BayerPattern(pattern)
    if min(raw.shape) < 3:
        return cv2.cvtColor(_bilinear(raw, pattern), cv2.COLOR_RGB2GRAY)
    return _repaired_border(cv2.cvtColor(raw, _GREY[pattern]), raw, pattern)


def _as_mosaic(raw: Image) -> Image:
    raw = as_image(raw, "raw", dtypes=(np.uint8, np.uint16))
    if min(raw.shape) < 2:
        raise ShapeError(f"raw: shape {raw.shape}; need at least one 2x2 quad")
    return raw


def _reflected(raw: Image, width: int) -> Image:
    """Extend a mosaic by mirror images about the outermost row or column, which keeps the Bayer phase."""
    return np.pad(raw, width, mode="reflect") if min(raw.shape) <= width else _mirrored(raw, width)


def _mirrored(raw: Image, width: int) -> Image:
    return cv2.copyMakeBorder(raw, width, width, width, width, cv2.BORDER_REFLECT_101)


def _bilinear(raw: Image, pattern: BayerPattern) -> Image:
    # OpenCV copies the outermost rows and columns from their neighbours instead of interpolating them;
    # on a picture extended by reflection its border is ours to cut away.
    return cv2.cvtColor(_reflected(raw, 2), _BILINEAR[pattern])[2:-2, 2:-2].copy()


def _edge_aware(raw: Image, pattern: BayerPattern) -> Image:
    return cv2.cvtColor(_reflected(raw, 2), _EDGE_AWARE[pattern])[2:-2, 2:-2].copy()


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
    return cv2.cvtColor(_reflected(np.ascontiguousarray(raw), 2), _GREY[pattern])[2:-2, 2:-2]


# Malvar, He & Cutler 2004, figure 2; the gains are 1/2 (green), 5/8 (same row or column) and 3/4 (diagonal).
_GREEN_AT_COLOR = np.array(
    [[0, 0, -1, 0, 0], [0, 0, 2, 0, 0], [-1, 2, 4, 2, -1], [0, 0, 2, 0, 0], [0, 0, -1, 0, 0]], np.float32
) / np.float32(8)
_COLOR_IN_ROW = np.array(
    [[0, 0, 0.5, 0, 0], [0, -1, 0, -1, 0], [-1, 4, 5, 4, -1], [0, -1, 0, -1, 0], [0, 0, 0.5, 0, 0]], np.float32
) / np.float32(8)
_COLOR_ON_DIAGONAL = np.array(
    [[0, 0, -1.5, 0, 0], [0, 2, 0, 2, 0], [-1.5, 0, 6, 0, -1.5], [0, 2, 0, 2, 0], [0, 0, -1.5, 0, 0]], np.float32
) / np.float32(8)


def _malvar(raw: Image, pattern: BayerPattern) -> Image:
    extended = _reflected(raw, 2).astype(np.float32)
    top = 255.0 if raw.dtype == np.uint8 else 65535.0

    def filtered(kernel: Image) -> Image:
        return np.asarray(cv2.filter2D(extended, cv2.CV_32F, kernel))[2:-2, 2:-2]

    green = filtered(_GREEN_AT_COLOR)
    in_row = filtered(_COLOR_IN_ROW)
    in_column = filtered(np.ascontiguousarray(_COLOR_IN_ROW.T))
    diagonal = filtered(_COLOR_ON_DIAGONAL)
    shape = (raw.shape[0], raw.shape[1])
    planes = []
    for color, other in (("r", "b"), ("g", ""), ("b", "r")):
        if color == "g":
            plane = np.where(site_mask(shape, pattern, "g"), raw, green)
        else:
            plane = raw.astype(np.float32)
            rows = np.asarray(site_mask(shape, pattern, color).any(axis=1))
            own_row = np.broadcast_to(rows[:, None], shape)
            greens = site_mask(shape, pattern, "g")
            plane = np.where(greens & own_row, in_row, plane)
            plane = np.where(greens & ~own_row, in_column, plane)
            plane = np.where(site_mask(shape, pattern, other), diagonal, plane)
        planes.append(np.clip(np.rint(plane), 0, top).astype(raw.dtype))
    return cv2.merge(planes)


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
_GREY = {
    BayerPattern.RGGB: cv2.COLOR_BayerBG2GRAY,
    BayerPattern.BGGR: cv2.COLOR_BayerRG2GRAY,
    BayerPattern.GRBG: cv2.COLOR_BayerGB2GRAY,
    BayerPattern.GBRG: cv2.COLOR_BayerGR2GRAY,
}
_METHODS: dict[DemosaicMethod, Callable[[Image, BayerPattern], Image]] = {
    DemosaicMethod.BILINEAR: _bilinear,
    DemosaicMethod.EDGE_AWARE: _edge_aware,
    DemosaicMethod.MALVAR: _malvar,
}
