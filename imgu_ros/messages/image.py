# SPDX-License-Identifier: Apache-2.0
"""sensor_msgs/Image <-> pixels."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imgu_ros.errors import EncodingError
from imgu_ros.messages.encodings import Encoding, encoding_named, is_image_encoding
from imgu_ros.messages.factory import MessageFactory
from imgu_ros.messages.header import Header, header_message
from imgu_ros.types import Image
from imgu_ros.vision.formation.layout import ColorModel, RawImage

#: Rows of bytes are padded by less than this.
_MOST_PADDING = 64


def decode_image(message: Any, encoding: str = "") -> RawImage:
    """Read a sensor_msgs/Image without copying its pixels.

    The result is a read-only view of the message's data. A copy is made only where a view would be wrong or slow: of
    multi-byte pixels in the other byte order (OpenCV reads such arrays as if they were native, and says nothing), and
    of pixels that do not lie on multiples of their size.

    Where the row length cannot be what `step` says and the data are exactly rows without padding, they are read as
    such; bytes behind the last row are left. Either is said in the image's `remark`. Of YUV in planes the luma is read.

    Parameters
    ----------
    message : sensor_msgs/Image
    encoding : what the pixels are, instead of what the message says; empty: what it says

    Returns
    -------
    RawImage
        Pixels (H, W) for one channel, (H, W, C) for more.

    Raises
    ------
    EncodingError
        If the encoding is unknown, or the data are too few for size and row length; or if the pixels cannot be what
        `encoding` says.
    """
    known = encoding_named(encoding or str(message.encoding))
    width, height, step = int(message.width), int(message.height), int(message.step)
    data = data_bytes(message)
    if encoding:
        _check_override(known, str(message.encoding), width, step)
    rows = (_plane_rows if known.planar_rows else _rows)(known, width, height, step, len(data))
    dimensions = 2 if known.channels == 1 else 3
    shape = (rows.height, width, known.channels)[:dimensions]
    strides = (rows.step, known.pixel_bytes, known.dtype.itemsize)[:dimensions]
    dtype = known.dtype.newbyteorder(">" if message.is_bigendian else "<")
    # The last row's padding is not part of the view, whose strides end inside the data: see _rows.
    pixels: Image = np.ndarray(shape, dtype, buffer=data, strides=strides)
    if not (pixels.dtype.isnative and pixels.flags.aligned):
        pixels = pixels.astype(known.dtype, order="C")
    pixels.flags.writeable = False
    return RawImage(pixels, known.layout, rows.remark)


def image_message(
    make: MessageFactory,
    header: Header,
    pixels: Image,
    encoding: str,
    *,
    row_padding: int = 0,
    big_endian: bool = sys.byteorder == "big",
) -> Any:
    """Return a sensor_msgs/Image.

    Parameters
    ----------
    pixels : (H, W) or (H, W, C), of the encoding's data type and channels
    encoding : a name that `decode_image` reads
    row_padding : bytes added to every row, >= 0
    big_endian : byte order of multi-byte pixels; the machine's by default

    Raises
    ------
    EncodingError
        If the pixels do not fit the encoding.
    """
    known = encoding_named(encoding)
    if known.planar_rows:
        raise EncodingError(f"encoding: {encoding!r} can be read and not be written; need one whose pixels are whole")
    rows = _checked_pixels(pixels, known)
    height, width = rows.shape[:2]
    order: Any = ">" if big_endian else "<"
    rows = np.ascontiguousarray(rows, known.dtype.newbyteorder(order))
    lines = rows.reshape(height, -1).view(np.uint8)
    if row_padding:
        lines = np.pad(lines, ((0, 0), (0, row_padding)))
    return make(
        "sensor_msgs/msg/Image",
        header=header_message(make, header),
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=int(big_endian),
        step=lines.shape[1],
        data=lines.reshape(-1),
    )


def data_bytes(message: Any) -> NDArray[np.uint8]:
    """Return a message's `data` field as (N,) uint8, without a copy.

    Raises
    ------
    EncodingError
        If it is not a buffer of bytes.
    """
    try:
        # numpy refuses an empty buffer by itself, with another meaning.
        view = memoryview(message.data).cast("B")
        return np.frombuffer(view, np.uint8) if len(view) else np.empty(0, np.uint8)
    except (TypeError, ValueError) as error:
        raise EncodingError(f"data: {type(message.data).__name__} ({error}); need contiguous bytes") from None


def _check_override(wanted: Encoding, claimed: str, width: int, step: int) -> None:
    """Raise unless pixels that a message claims to be of one encoding can be of another."""
    if is_image_encoding(claimed):
        said = encoding_named(claimed)
        if said.pixel_bytes != wanted.pixel_bytes:
            raise EncodingError(
                f"raw.encoding: {wanted.name} has {_bytes(wanted.pixel_bytes)} a pixel, the message's {said.name} "
                f"{said.pixel_bytes}; need an encoding of {_bytes(said.pixel_bytes)} a pixel"
            )
    elif width > 0 and step // width > wanted.pixel_bytes and step - width * wanted.pixel_bytes >= _MOST_PADDING:
        raise EncodingError(
            f"raw.encoding: {wanted.name} has {_bytes(wanted.pixel_bytes)} a pixel, the message's {claimed[:40]!r} "
            f"rows of {step} bytes for {width} px; need an encoding of {_bytes(step // width)} a pixel"
        )


def _bytes(count: int) -> str:
    return f"{count} byte{'s' * (count > 1)}"


@dataclass(frozen=True, slots=True)
class _Rows:
    """Where an image's rows lie in its data: their number, the bytes from one to the next, and a remark."""

    height: int
    step: int
    remark: str = ""


def _rows(encoding: Encoding, width: int, height: int, step: int, available: int) -> _Rows:
    """Return how to read the data; `available` is their number of bytes."""
    if width <= 0 or height <= 0:
        raise EncodingError(f"image: {width} x {height} px; need positive width and height")
    if encoding.layout.color in (ColorModel.UYVY, ColorModel.YUYV) and width % 2:
        raise EncodingError(f"width: {width} px; need an even width for {encoding.name}")
    row = width * encoding.pixel_bytes
    is_possible = step >= row and available >= step * (height - 1) + row
    if not is_possible and step >= 0 and available == row * height:
        return _Rows(height, row, f"step: {step} bytes; read as {row}, for the data are {height} rows of {row} bytes")
    if step < row:
        raise EncodingError(f"step: {step} bytes; need at least {row} for {width} px of {encoding.name}")
    if not is_possible:
        raise EncodingError(f"data: {available} bytes; need step x height = {step} x {height} = {step * height}")
    extra = available - step * height
    if extra <= 0:
        return _Rows(height, step)
    remark = f"data: {available} bytes, {extra} more than step x height = {step} x {height}; these are ignored"
    if available % height == 0:
        remark += f" (a picture that looks slanted has rows of {available // height} bytes: step is wrong)"
    return _Rows(height, step, remark)


def _plane_rows(encoding: Encoding, width: int, height: int, step: int, available: int) -> _Rows:
    """Return how to read the luma of YUV in planes, in whichever of three ways a driver fills height and step.

    Height is the picture's and step the length of a row of luma (camera_ros); or step counts the bytes of all planes
    for a row (depthai); or height counts the rows of all planes, as OpenCV does.
    """
    if width <= 0 or height <= 0:
        raise EncodingError(f"image: {width} x {height} px; need positive width and height")
    planes = encoding.planar_rows
    if available == math.ceil(planes * height) * width:  # rows of luma without padding, whatever step says
        return _Rows(height, width)
    stacked = round(height / planes)
    if step >= width and available < planes * step * height and stacked * planes == height:
        if available >= step * height:
            return _Rows(stacked, step)
    elif step >= width and available >= planes * step * height:
        return _Rows(height, step)
    need = f"{math.ceil(planes * height)} rows of at least {width} bytes for {width} x {height} px of {encoding.name}"
    raise EncodingError(f"data: {available} bytes, step {step}; need {need}")


def _checked_pixels(pixels: Image, encoding: Encoding) -> Image:
    pixels = np.asarray(pixels)
    count = 1 if pixels.ndim == 2 else pixels.shape[2] if pixels.ndim == 3 else 0
    if count != encoding.channels or pixels.size == 0:
        need = "(H, W)" if encoding.channels == 1 else f"(H, W, {encoding.channels})"
        raise EncodingError(f"pixels: shape {pixels.shape}; need {need} with H, W >= 1 for {encoding.name}")
    if pixels.dtype.newbyteorder("=") != encoding.dtype:
        raise EncodingError(f"pixels: data type {pixels.dtype}; need {encoding.dtype} for {encoding.name}")
    if encoding.layout.color in (ColorModel.UYVY, ColorModel.YUYV) and pixels.shape[1] % 2:
        raise EncodingError(f"pixels: shape {pixels.shape}; need an even width for {encoding.name}")
    return pixels


def described_encoding(message: Any) -> str:
    """Return the encoding of a sensor_msgs/Image, or the format of a CompressedImage, at most 40 characters of it."""
    text = str(getattr(message, "encoding", getattr(message, "format", "")))
    return " ".join(text.split())[:40]
