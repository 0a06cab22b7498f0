"""Array aliases and the shape checks that every public function starts with."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from imgu_ros.errors import ShapeError

#: An image, (H, W) or (H, W, C); uint8, uint16 or float32.
Image = NDArray[Any]
#: A mask, (H, W) or (N,), bool.
Mask = NDArray[np.bool_]
#: Points, (N, 2) float64, x right, y down, pixel centres at integers.
Points = NDArray[np.float64]
#: Any float64 array; the docstring gives its shape.
Floats = NDArray[np.float64]
#: A 3x3 float64 matrix.
Matrix3 = NDArray[np.float64]
#: Indices, (N,) intp.
Indices = NDArray[np.intp]

IMAGE_DTYPES = (np.uint8, np.uint16, np.float32)


class Choice(StrEnum):
    """Base of the enumerations that callers name by strings: another string raises ShapeError and lists the choices."""

    @classmethod
    def _missing_(cls, value: object) -> None:
        raise ShapeError(f"{cls.__name__}: {value!r}; need one of {', '.join(cls)}")


def as_points(points: ArrayLike, name: str = "points", minimum: int = 0) -> Points:
    """Return `points` as a finite float64 array of shape (N, 2) with N >= `minimum`.

    Raises
    ------
    ShapeError
        If the shape is not (N, 2), N < `minimum`, or a value is not finite.
    """
    return as_rows(points, 2, name, minimum)


def as_rows(rows: ArrayLike, columns: int, name: str, minimum: int = 0) -> Floats:
    """Return `rows` as a finite float64 array of shape (N, columns) with N >= `minimum`.

    Raises
    ------
    ShapeError
        If it cannot be converted, has another shape, or holds NaN or infinity.
    """
    array = as_floats(rows, name)
    if array.ndim != 2 or array.shape[1] != columns or len(array) < minimum:
        raise ShapeError(f"{name}: shape {array.shape}; need (N >= {minimum}, {columns})")
    return require_finite(array, name)


def as_matrix(matrix: ArrayLike, shape: Sequence[int], name: str) -> Floats:
    """Return `matrix` as a finite float64 array of exactly `shape`.

    Raises
    ------
    ShapeError
        If it cannot be converted, has another shape, or holds NaN or infinity.
    """
    array = as_floats(matrix, name)
    if array.shape != tuple(shape):
        raise ShapeError(f"{name}: shape {array.shape}; need {tuple(shape)}")
    return require_finite(array, name)


def as_floats(values: ArrayLike, name: str) -> Floats:
    """Return `values` as a float64 array of any shape; NaN and infinities stay.

    Raises
    ------
    ShapeError
        If they are not real numbers.
    """
    if isinstance(values, np.ndarray) and values.dtype.kind not in "biufO":
        raise ShapeError(f"{name}: data type {values.dtype}; need real numbers")
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ShapeError(f"{name}: {error}; need numbers") from None


def as_image(
    image: Image,
    name: str = "image",
    channels: Sequence[int] = (1,),
    dtypes: Sequence[type] = IMAGE_DTYPES,
) -> Image:
    """Check an image and return it, C-contiguous and in native byte order.

    Parameters
    ----------
    image : (H, W) or (H, W, C)
    channels : allowed channel counts; 1 stands for a two-dimensional array.
    dtypes : allowed data types.

    Raises
    ------
    ShapeError
        If it is not an array, is empty, has another data type or channel count, or holds NaN or infinity.
    """
    if not isinstance(image, np.ndarray):
        raise ShapeError(f"{name}: {type(image).__name__}; need a numpy array")
    count = 1 if image.ndim == 2 else image.shape[2] if image.ndim == 3 else 0
    if count not in channels or (image.ndim == 3 and count == 1):
        allowed = " or ".join("(H, W)" if c == 1 else f"(H, W, {c})" for c in channels)
        raise ShapeError(f"{name}: shape {image.shape}; need {allowed}")
    if image.size == 0:
        raise ShapeError(f"{name}: shape {image.shape}; need at least one pixel")
    if image.dtype.type not in dtypes:
        allowed = ", ".join(np.dtype(d).name for d in dtypes)
        raise ShapeError(f"{name}: data type {image.dtype}; need {allowed}")
    # OpenCV reads a big-endian array as if it were native, and says nothing.
    if not (image.dtype.isnative and image.flags.c_contiguous):
        image = np.ascontiguousarray(image, dtype=image.dtype.newbyteorder("="))
    return require_finite(image, name) if image.dtype.kind == "f" else image


def require_finite(array: NDArray[Any], name: str) -> NDArray[Any]:
    """Return an array of floats if all are finite, else raise `ShapeError`."""
    # One number tells it in half the time, unless it overflows.
    if not math.isfinite(np.vdot(array, array)) and not np.isfinite(array).all():
        raise ShapeError(f"{name}: {np.count_nonzero(~np.isfinite(array))} values are not finite; need finite numbers")
    return array
