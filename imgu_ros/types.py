# SPDX-License-Identifier: Apache-2.0
"""Array aliases, and the checks and conversions that every public function of `vision/` starts with."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import EnumMeta, StrEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from imgu_ros.arguments import shown_value
from imgu_ros.errors import ShapeError

#: An image, (H, W) or (H, W, C); uint8, uint16 or float32 in [0, 1]; `as_image` says what else is taken, and as what.
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


class _ChoiceMeta(EnumMeta):
    """What finds a member by its value; an array, which no member can be compared with, is no value."""

    def __call__(cls, value: Any, *arguments: Any, **options: Any) -> Any:
        return super().__call__(shown_value(value) if isinstance(value, np.ndarray) else value, *arguments, **options)


class Choice(StrEnum, metaclass=_ChoiceMeta):
    """Base of the enumerations that callers name by strings: another string raises ShapeError and lists the choices."""

    @classmethod
    def _missing_(cls, value: object) -> None:
        raise ShapeError(f"{cls.__name__}: {shown_value(value)}; need one of {', '.join(cls)}")


def as_points(points: ArrayLike, name: str = "points", minimum: int = 0) -> Points:
    """Return `points` as a finite float64 array of shape (N, 2) with N >= `minimum`.

    Lists and tuples of pairs are taken as well, (N, 1, 2) as OpenCV returns it, a list of cv2.KeyPoint, and an empty
    list as no points.

    Raises
    ------
    ShapeError
        If the shape is not (N, 2), N < `minimum`, or a value is not finite.
    """
    try:
        return as_rows(points, 2, name, minimum)
    except ShapeError:
        positions = _keypoint_positions(points)
        if positions is None:
            raise
    return as_rows(positions, 2, name, minimum)


def as_plane_points(points: ArrayLike, name: str = "points", minimum: int = 0) -> Points:
    """Return points of a plane as `as_points` does; (N, 3) with z = 0, as OpenCV has a board's, is taken as well.

    Raises
    ------
    ShapeError
        If the shape is neither, N < `minimum`, a z is not 0, or a value is not finite.
    """
    try:
        rows = as_rows(points, 3, name, minimum)
    except ShapeError:
        return as_points(points, name, minimum)
    if rows[:, 2].any():
        raise ShapeError(f"{name}: z up to {np.abs(rows[:, 2]).max():g}; need points of the plane z = 0")
    return rows[:, :2].copy()


def as_rows(rows: ArrayLike, columns: int, name: str, minimum: int = 0) -> Floats:
    """Return `rows` as a finite float64 array of shape (N, columns) with N >= `minimum`.

    (N, 1, columns), as OpenCV returns it, is taken as well, and an empty list as no rows.

    Raises
    ------
    ShapeError
        If it cannot be converted, has another shape, or holds NaN or infinity.
    """
    array = as_floats(rows, name)
    if array.ndim == 3 and array.shape[1:] == (1, columns):
        array = array[:, 0]
    elif array.shape == (0,):
        array = array.reshape(0, columns)
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
    if type(values) is not np.ndarray:
        values = _as_array(values, name)
    if values.dtype.kind not in "biufO":
        raise ShapeError(f"{name}: data type {values.dtype}; need real numbers")
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ShapeError(f"{name}: {_one_line(error)}; need numbers") from None


def as_image(
    image: Image,
    name: str = "image",
    channels: Sequence[int] = (1,),
    dtypes: Sequence[type] = IMAGE_DTYPES,
    rescaled: bool = True,
) -> Image:
    """Check an image and return it in one of `dtypes`, C-contiguous and in native byte order.

    An image of another type is converted where there is one way to understand it; what a function returns then has
    the converted type:

    - float64 and float16 are taken as float32;
    - bool is 0 and 1 in float32, or black and white (0 and 255) where only integers are taken;
    - other integers are taken as uint8 when all values lie in 0 to 255, else as uint16 when they lie in 0 to 65535;
    - where only integers are taken, floats in [0, 1] are scaled to uint16, or uint8 where that alone is taken.
      `require_unit_range` tells which floats are refused.

    Parameters
    ----------
    image : (H, W) or (H, W, C)
    name : what the error calls it
    channels : allowed channel counts; 1 stands for a two-dimensional array.
    dtypes : data types that come out.
    rescaled : False: floats and bools are refused where only integers are taken, as in raw data

    Raises
    ------
    ShapeError
        If it is not an array, is masked or empty, has another data type or channel count, or holds NaN or infinity.
    """
    if type(image) is not np.ndarray:
        image = as_plain(image, name)
    count = 1 if image.ndim == 2 else image.shape[2] if image.ndim == 3 else 0
    if count not in channels or (image.ndim == 3 and count == 1):
        allowed = " or ".join("(H, W)" if c == 1 else f"(H, W, {c})" for c in channels)
        raise ShapeError(f"{name}: shape {image.shape}; need {allowed}")
    if image.size == 0:
        raise ShapeError(f"{name}: shape {image.shape}; need at least one pixel")
    if image.dtype.type not in dtypes:
        image = _converted(image, name, dtypes, rescaled)
    # OpenCV reads a big-endian array as if it were native, and says nothing.
    if not (image.dtype.isnative and image.flags.c_contiguous):
        image = np.ascontiguousarray(image, dtype=image.dtype.newbyteorder("="))
    return require_finite(image, name) if image.dtype.kind == "f" else image


def as_plain(array: NDArray[Any], name: str) -> NDArray[Any]:
    """Return an array, and one of a subclass (np.matrix, np.memmap) as a plain one.

    Raises
    ------
    ShapeError
        If it is no array, or a masked one, whose mask would be lost.
    """
    if not isinstance(array, np.ndarray):
        raise ShapeError(f"{name}: {type(array).__name__}; need a numpy array")
    if isinstance(array, np.ma.MaskedArray):
        raise ShapeError(f"{name}: a masked array; need a plain one, from its method filled() for example")
    return np.asarray(array)


def as_mask(mask: ArrayLike, count: int, name: str) -> Mask:
    """Return `mask` as an array of `count` bools.

    Raises
    ------
    ShapeError
        If it is something else.
    """
    array = _as_array(mask, name)
    if array.dtype != bool or array.shape != (count,):
        raise ShapeError(f"{name}: shape {array.shape}, {array.dtype}; need ({count},) bool")
    return array


def require_unit_range(image: Image, name: str = "image") -> None:
    """Refuse a float image that is not in [0, 1], as one in 0 to 255 is not; an overshoot of filters, -1 to 2, passes.

    Raises
    ------
    ShapeError
        If a value lies outside -1 to 2.
    """
    if image.dtype.kind != "f":
        return
    lowest, highest = float(image.min()), float(image.max())
    if not (lowest >= -1 and highest <= 2):
        raise ShapeError(
            f"{name}: {image.dtype} from {lowest:g} to {highest:g}; need floats in [0, 1]: divide by white"
        )


def require_finite(array: NDArray[Any], name: str) -> NDArray[Any]:
    """Return an array of floats if all are finite, else raise `ShapeError`."""
    # One number tells it in half the time, unless it overflows.
    if not math.isfinite(np.vdot(array, array)) and not np.isfinite(array).all():
        raise ShapeError(f"{name}: {np.count_nonzero(~np.isfinite(array))} values are not finite; need finite numbers")
    return array


def _as_array(values: Any, name: str) -> NDArray[Any]:
    """Return what is not an array, or more than one, as a plain array."""
    if isinstance(values, np.ndarray):
        return as_plain(values, name)
    try:
        array = np.asarray(values)
    except (TypeError, ValueError, OverflowError) as error:
        raise ShapeError(f"{name}: {_one_line(error)}; need numbers") from None
    if array.dtype.kind == "O" and array.ndim == 0:
        raise ShapeError(f"{name}: {shown_value(values)}; need numbers")
    return array


def _converted(image: Image, name: str, dtypes: Sequence[type], rescaled: bool) -> Image:
    """Return an image of another type in one of `dtypes`; `as_image` says which types, and how."""
    kind, integers = image.dtype.kind, [d for d in (np.uint8, np.uint16) if d in dtypes]
    if kind in "bf" and np.float32 in dtypes:
        with np.errstate(over="ignore"):
            single = image.astype(np.float32)
        if not np.isfinite(single).all():
            require_finite(image, name)
            raise ShapeError(f"{name}: beyond {np.finfo(np.float32).max:g}; need numbers that float32 holds")
        return single
    if kind == "b" and rescaled and integers:
        return image.astype(np.uint8) * np.uint8(255) if np.uint8 in integers else image.astype(np.uint16) * 65535
    if kind == "f" and rescaled and integers:
        require_unit_range(require_finite(image, name), name)
        top = np.iinfo(integers[-1]).max
        return np.rint(np.clip(image.astype(np.float64), 0, 1) * top).astype(integers[-1])
    if kind in "iu" and image.dtype.type is not np.uint16 and integers:
        lowest, highest = int(image.min()), int(image.max())
        for dtype in integers:
            if lowest >= 0 and highest <= np.iinfo(dtype).max:
                return image.astype(dtype)
        top = np.iinfo(integers[-1]).max
        raise ShapeError(f"{name}: {image.dtype} from {lowest} to {highest}; need 0 to {top}")
    allowed = ", ".join(np.dtype(d).name for d in dtypes)
    hint = " (stretched_to_8_bit makes it of others)" if image.dtype == np.uint16 and integers == [np.uint8] else ""
    raise ShapeError(f"{name}: data type {image.dtype}; need {allowed}{hint}")


def _keypoint_positions(points: Any) -> list[tuple[float, float]] | None:
    """Return where cv2.KeyPoint objects lie, without knowing cv2; None: they are none."""
    if not isinstance(points, list | tuple) or not all(hasattr(point, "pt") for point in points):
        return None
    return [point.pt for point in points]


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
