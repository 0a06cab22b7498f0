# SPDX-License-Identifier: Apache-2.0
"""Geometric warps of images (IU 2.3.3 to 2.3.5, 6.4)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_flag, as_number
from imgu_ros.errors import ShapeError
from imgu_ros.types import Image, Matrix3, Points, as_image, as_matrix
from imgu_ros.vision.processing.borders import CV_BORDERS, Border, border_values
from imgu_ros.vision.processing.interpolation import CV_SAMPLING, MOST_SIDE_PX, Interpolation, checked_size
from imgu_ros.vision.processing.points import require_range

_LARGEST_PX = 1e9
#: A size a hair above a whole number, from rounding, is that number.
_HAIR_PX = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Canvas:
    """Where a warped picture is drawn.

    Attributes
    ----------
    H : (3, 3) H_canvas_image, px to px, pixel centres at integers
    size : (width, height) px
    """

    H: Matrix3
    size: tuple[int, int]


def warped(
    image: Image,
    H: ArrayLike,
    size: Sequence[int] | None = None,
    interpolation: Interpolation | str = Interpolation.LINEAR,
    border: Border | str = Border.CONSTANT,
    value: float = 0.0,
) -> Image:
    """Draw an image as a homography maps it: out(H x) = image(x).

    Parameters
    ----------
    image : (H, W) or (H, W, 3), uint8, uint16 or float32
    H : (3, 3) H_out_image, px to px, pixel centres at integers: any similarity, affine or projective map
    size : (width, height) of the result; None: the image's
    interpolation : nearest, linear or cubic; smooth the image first when H reduces it
    border, value : what stands outside the image

    Returns
    -------
    (height, width) or (height, width, 3), same data type.

    Raises
    ------
    ShapeError
        If an argument is not as said, or H has no inverse.

    Notes
    -----
    Source: IU 2.3.5, 6.4. Every pixel of the result is looked up by the inverse of H, so that none stays empty.
    OpenCV before version 5 rounds the place to 1/32 px, and the cubic's in every version: up to 1/64 px off.
    `interpolation.sampled` is exact at single points.

    Examples
    --------
    >>> image = np.array([[1, 2, 3]], np.uint8)
    >>> warped(image, [[1, 0, 1], [0, 1, 0], [0, 0, 1]], value=9).tolist()
    [[9, 1, 2]]
    """
    value = as_number(value, "value")
    image = as_image(image, channels=(1, 3))
    require_range(image, 4.0)
    out_size = (image.shape[1], image.shape[0]) if size is None else checked_size(size)
    if max(image.shape[:2]) > MOST_SIDE_PX:
        raise ShapeError(f"image: shape {image.shape}; need sides up to {MOST_SIDE_PX} px")
    interpolation, border = Interpolation(interpolation), Border(border)
    if interpolation is Interpolation.AREA:
        raise ShapeError("interpolation: 'area'; need nearest, linear or cubic: `resized` knows areas")
    inverse = _inverse(as_matrix(H, (3, 3), "H"))
    return cv2.warpPerspective(
        image,
        inverse,
        out_size,
        flags=CV_SAMPLING[interpolation] | cv2.WARP_INVERSE_MAP,
        borderMode=CV_BORDERS[border],
        borderValue=border_values(image.dtype, border, value),
    )


def rotated(
    image: Image,
    angle: float,
    centre: ArrayLike | None = None,
    whole: bool = False,
    interpolation: Interpolation | str = Interpolation.LINEAR,
    border: Border | str = Border.CONSTANT,
    value: float = 0.0,
) -> Image:
    """Rotate an image about a point, or so that all of it stays in view.

    Parameters
    ----------
    image : (H, W) or (H, W, 3), uint8, uint16 or float32
    angle : rad, from x towards y: clockwise as seen
    centre : (2,) px, the point that stays; None: the image's centre, ((W - 1) / 2, (H - 1) / 2)
    whole : make the result as large as the rotated picture is; then `centre` does not matter
    interpolation, border, value : as in `warped`

    Returns
    -------
    The image's size, or that of `whole_picture` with `whole`.

    Raises
    ------
    ShapeError
        As `warped`; or if the angle is not finite.

    Notes
    -----
    Source: IU 2.3.3, whose matrix is this one for -angle.

    Examples
    --------
    >>> rotated(np.array([[1, 2, 3]], np.uint8), math.pi / 2, whole=True).tolist()
    [[1], [2], [3]]
    """
    whole = as_flag(whole, "whole")
    angle = as_number(angle, "angle")
    value = as_number(value, "value")
    image = as_image(image, channels=(1, 3))
    size = (image.shape[1], image.shape[0])
    middle = (size[0] - 1) / 2, (size[1] - 1) / 2
    H = rotation_about(angle, middle if centre is None else centre)
    if not whole:
        return warped(image, H, None, interpolation, border, value)
    canvas = whole_picture(H, size)
    return warped(image, canvas.H, canvas.size, interpolation, border, value)


def rotation_about(angle: float, centre: ArrayLike, scale: float = 1.0) -> Matrix3:
    """Return the similarity that turns and scales about a point, (3, 3).

    Parameters
    ----------
    angle : rad, from x towards y
    centre : (2,) px, up to 1e9; the point that stays
    scale : 1e-6 to 1e6

    Raises
    ------
    ShapeError
        If an argument is not as said.

    Notes
    -----
    Source: IU 2.3.3, 2.3.4: x' = s R (x - c) + c.

    Examples
    --------
    >>> (rotation_about(math.pi / 2, (1, 1)) @ [2, 1, 1]).round(9).tolist()
    [1.0, 2.0, 1.0]
    """
    angle = as_number(angle, "angle")
    scale = as_number(scale, "scale")
    if not abs(angle) <= _LARGEST_PX:
        raise ShapeError(f"angle: {angle!r}; need a finite number of rad")
    if not 1e-6 <= scale <= 1e6:
        raise ShapeError(f"scale: {scale!r}; need 1e-6 to 1e6")
    point = as_matrix(centre, (2,), "centre")
    if np.abs(point).max() > _LARGEST_PX:
        raise ShapeError(f"centre: up to {np.abs(point).max():.3g}; need at most {_LARGEST_PX:g} px")
    linear = scale * np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    H = np.eye(3)
    H[:2, :2] = linear
    H[:2, 2] = point - linear @ point
    return H


def whole_picture(H: ArrayLike, size: Sequence[int]) -> Canvas:
    """Return the smallest canvas that shows all of a picture as H maps it.

    The picture's outline, from -0.5 to W - 0.5 and H - 0.5, is mapped; the canvas is its bounding box, rounded up to
    whole pixels, with the picture in the middle. `Canvas.H` says where each pixel lies.

    Parameters
    ----------
    H : (3, 3), px to px
    size : (width, height) of the picture

    Raises
    ------
    ShapeError
        If the size is not two integers in range, H has no inverse or puts the picture's vanishing line across it, or
        the canvas would be larger than 32766 px.

    Notes
    -----
    Source: IU 2.3.3 ("rotated image with all parts"), with corners of pixels, not centres.

    Examples
    --------
    >>> canvas = whole_picture(rotation_about(math.pi / 2, (0, 0)), (3, 2))
    >>> canvas.size, (canvas.H @ [0, 0, 1]).round(9).tolist()
    ((2, 3), [1.0, 0.0, 1.0])
    """
    width, height = checked_size(size)
    matrix = as_matrix(H, (3, 3), "H")
    _inverse(matrix)
    corners = _mapped(matrix, np.array([[x, y] for x in (-0.5, width - 0.5) for y in (-0.5, height - 0.5)]))
    low, extent = corners.min(axis=0), np.ptp(corners, axis=0)
    if extent.max() > MOST_SIDE_PX:
        raise ShapeError(f"H: the picture gets {extent[0]:.4g} x {extent[1]:.4g} px; need at most {MOST_SIDE_PX}")
    whole = np.maximum(np.ceil(extent - _HAIR_PX), 1)
    shift = np.eye(3)
    shift[:2, 2] = (whole - extent) / 2 - 0.5 - low
    out_size = (int(whole[0]), int(whole[1]))
    return Canvas(shift @ matrix, checked_size(out_size))


def _mapped(H: Matrix3, corners: Points) -> Points:
    mapped = (H / np.abs(H).max()) @ np.vstack([corners.T, np.ones(len(corners))])
    w = mapped[2]
    if not ((w > 0).all() or (w < 0).all()):
        raise ShapeError("H: its vanishing line crosses the picture; need all corners on one side")
    with np.errstate(over="ignore"):
        xy = (mapped[:2] / w).T
    if not np.abs(xy).max() <= _LARGEST_PX:
        raise ShapeError("H: maps a corner beyond 1e9 px; need corners nearer")
    return np.asarray(xy)


def _inverse(H: Matrix3) -> Matrix3:
    """Return the inverse, scaled to a largest entry of 1."""
    largest = float(np.abs(H).max())
    if largest > 0:
        H = H / largest
        s = np.linalg.svd(H, compute_uv=False)
        if s[2] > 1e-15 * s[0]:
            inverse = np.linalg.inv(H)
            if np.isfinite(inverse).all():
                return np.asarray(inverse / np.abs(inverse).max())
    raise ShapeError("H: singular; need an invertible matrix")
