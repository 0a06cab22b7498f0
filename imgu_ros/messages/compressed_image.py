# SPDX-License-Identifier: Apache-2.0
"""sensor_msgs/CompressedImage <-> pixels: JPEG and PNG."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from imgu_ros.config.parameters import DEFAULT_LIMITS, LimitsParameters
from imgu_ros.errors import EncodingError
from imgu_ros.image_files.checks import is_picture_file
from imgu_ros.image_files.cost import FileKind
from imgu_ros.image_files.decoding import decode_picture_file
from imgu_ros.messages.encodings import Encoding, encoding_named, is_image_encoding
from imgu_ros.messages.factory import MessageFactory
from imgu_ros.messages.header import Header, header_message
from imgu_ros.messages.image import data_bytes
from imgu_ros.shown_text import NAME_CHARACTERS
from imgu_ros.types import Image
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage


def decode_compressed_image(message: Any, encoding: str = "", *, limits: LimitsParameters = DEFAULT_LIMITS) -> RawImage:
    """Decompress a sensor_msgs/CompressedImage: JPEG, or PNG of 8 or 16 bit.

    The data say themselves whether they are JPEG or PNG. The format string says what the picture was made from, as
    compressed_image_transport writes it: "bayer_rggb8; png compressed" is a mosaic, "rgb8; jpeg compressed bgr8" an
    ordinary colour picture, "rgb8; jpeg compressed rgb8" one whose red and blue were swapped before compression;
    plain "jpeg" or "png", or nothing, is a grey or colour picture. Case does not matter. A JPEG that lacks its end
    marker alone is read, which is said in the image's `remark`. An orientation in Exif is not applied: the camera's
    model belongs to the pixels as they were read out.

    Parameters
    ----------
    message : sensor_msgs/CompressedImage
    encoding : what the picture was made from, instead of what the format says; empty: what it says
    limits : what decoding may cost

    Raises
    ------
    EncodingError
        If the data are neither JPEG nor PNG, cut, damaged, beyond the limits, or do not fit the format or `encoding`.
    """
    data = data_bytes(message)
    # Nothing but the start of an endless one is looked at.
    text = str(message.format)[:NAME_CHARACTERS]
    if not is_picture_file(data):
        raise EncodingError(f"compressed image: {_why_no_picture(data, text)}")
    try:
        picture = decode_picture_file(data, limits)
    except EncodingError as error:
        raise EncodingError(f"compressed image: {error}") from None
    pixels = picture.pixels
    if pixels.ndim == 3 and pixels.shape[2] == 1:
        pixels = pixels[:, :, 0]
    said = _parse_format(text)
    layout = _overridden(pixels, said, encoding_named(encoding)) if encoding else _layout(pixels, said)
    pixels.flags.writeable = False
    return RawImage(pixels, layout, picture.remark)


def compressed_image_message(
    make: MessageFactory,
    header: Header,
    pixels: Image,
    encoding: str,
    *,
    file_format: FileKind | str = FileKind.JPEG,
    jpeg_quality: int = 95,
    png_level: int = 3,
) -> Any:
    """Return a sensor_msgs/CompressedImage, with the format string of compressed_image_transport.

    Parameters
    ----------
    pixels : (H, W) or (H, W, 3), of the encoding's data type
    encoding : mono, bayer, rgb or bgr; 8 bit for JPEG, 8 or 16 for PNG
    file_format : jpeg or png
    jpeg_quality : 0 to 100
    png_level : 0 (fast) to 9 (small)

    Raises
    ------
    EncodingError
        If the pixels do not fit the encoding, or the encoding the file format.
    """
    known = encoding_named(encoding)
    kind = _file_kind(file_format)
    picture = _as_opencv_picture(pixels, known, kind)
    if kind is FileKind.JPEG:
        options = [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality]
    else:
        options = [cv2.IMWRITE_PNG_COMPRESSION, png_level]
    try:
        done, data = cv2.imencode(f".{kind}", picture, options)
    except cv2.error:
        done = False  # OpenCV 5 says no, OpenCV 4 raises
    if not done:
        raise EncodingError(
            f"pixels: {picture.shape} {picture.dtype} cannot be written as {kind}; need a smaller picture"
        )
    inside = f" bgr{known.dtype.itemsize * 8}" if picture.ndim == 3 else ""
    return make(
        "sensor_msgs/msg/CompressedImage",
        header=header_message(make, header),
        format=f"{encoding}; {kind} compressed{inside}",
        data=np.asarray(data, np.uint8).reshape(-1),
    )


@dataclass(frozen=True, slots=True)
class _Format:
    """The parsed format string: the original encoding ("" when not given), and whether red and blue are swapped."""

    original: str
    rgb_inside: bool


_NEED = "JPEG (ff d8 ff) or PNG (89 50 4e 47)"
_VIDEO = ("h264", "h265", "hevc", "avc", "av1", "vp8", "vp9", "theora", "x264", "x265")


def _file_kind(name: str) -> FileKind:
    try:
        return FileKind(name)
    except ValueError:
        raise EncodingError(f"file_format: {name!r}; need {' or '.join(FileKind)}") from None


def _why_no_picture(data: NDArray[np.uint8], text: str) -> str:
    """Return the format that the data have, where it is recognised, and the formats that are accepted."""
    folded = text.lower()
    need = f"need {_NEED}"
    if "compresseddepth" in folded:
        return f"format {text[:40]!r} is a depth picture of compressed_depth_image_transport; {need} of the scene"
    if any(name in folded for name in _VIDEO):
        return f"format {text[:40]!r} is video, whose frames are no pictures by themselves; {need} for each frame"
    original = folded.partition(";")[0].strip()
    if original and is_image_encoding(original) and "compressed" not in folded:
        return f"format {text[:40]!r} names pixels that are not compressed; {need}, or a sensor_msgs/Image"
    start = data[:8].tobytes().hex(" ") or "nothing"
    return f"{len(data)} bytes that begin with {start}; {need}"


def _parse_format(text: str) -> _Format:
    original, separator, rest = text.lower().partition(";")
    return _Format(original.strip() if separator else "", "compressed rgb" in rest)


def _layout(pixels: Image, said: _Format) -> PixelLayout:
    channels = 1 if pixels.ndim == 2 else pixels.shape[2]
    if channels == 1 and said.original.startswith("bayer"):
        return encoding_named(said.original).layout
    if said.original and _is_generic(said.original, channels):
        return PixelLayout(ColorModel.BANDS)
    # A mosaic that was compressed in colour was demosaicked before; what is left is a colour picture.
    colors = {
        1: ColorModel.MONO,
        3: ColorModel.RGB if said.rgb_inside else ColorModel.BGR,
        4: ColorModel.RGBA if said.rgb_inside else ColorModel.BGRA,
    }
    if channels not in colors:
        raise EncodingError(f"compressed image: {channels} channels; need 1, 3 or 4")
    return PixelLayout(colors[channels])


def _overridden(pixels: Image, said: _Format, wanted: Encoding) -> PixelLayout:
    """Return the layout of an image that was made from another encoding than its format says."""
    channels = 1 if pixels.ndim == 2 else pixels.shape[2]
    color = wanted.layout.color
    packed = wanted.planar_rows or color in (ColorModel.UYVY, ColorModel.YUYV, ColorModel.ARGB)
    if packed or (wanted.channels, wanted.dtype) != (channels, pixels.dtype):
        bits = 8 * pixels.dtype.itemsize
        raise EncodingError(
            f"raw.encoding: {wanted.name} cannot be in a picture file with {channels} "
            f"channel{'s' * (channels > 1)} of {bits} bits; need an encoding of that kind"
        )
    if color not in _ORDERS:
        return wanted.layout
    # The format's order was made that of the file; if it was the wrong one, the file's is wrong in the same way.
    claimed = said.original if said.original[:3] in ("rgb", "bgr") else "rgb"
    swapped = (claimed[:3] == "rgb") != (color in (ColorModel.RGB, ColorModel.RGBA))
    layout = _layout(pixels, _Format("", said.rgb_inside))
    return PixelLayout(_ORDERS[layout.color]) if swapped else layout


#: Colour models with the other order of red and blue.
_ORDERS = {
    ColorModel.RGB: ColorModel.BGR,
    ColorModel.BGR: ColorModel.RGB,
    ColorModel.RGBA: ColorModel.BGRA,
    ColorModel.BGRA: ColorModel.RGBA,
}


def _is_generic(name: str, channels: int) -> bool:
    try:
        known = encoding_named(name)
    except EncodingError:
        return False  # the picture speaks for itself
    return known.layout.color is ColorModel.BANDS and known.channels == channels


def _as_opencv_picture(pixels: Image, encoding: Encoding, kind: FileKind) -> Image:
    """Check the pixels, and bring them to OpenCV's channel order."""
    pixels = np.asarray(pixels)
    color = encoding.layout.color
    if color not in (ColorModel.MONO, ColorModel.BAYER, ColorModel.RGB, ColorModel.BGR):
        raise EncodingError(f"encoding: {encoding.name!r}; need mono, bayer, rgb or bgr for a compressed image")
    if kind is FileKind.JPEG and encoding.dtype.itemsize != 1:
        raise EncodingError(f"encoding: {encoding.name!r}; need 8 bit for jpeg (png takes 16)")
    need = "(H, W)" if encoding.channels == 1 else "(H, W, 3)"
    if pixels.ndim != (2 if encoding.channels == 1 else 3) or pixels.size == 0 or pixels.shape[2:] not in ((), (3,)):
        raise EncodingError(f"pixels: shape {pixels.shape}; need {need} with H, W >= 1 for {encoding.name}")
    if pixels.dtype.newbyteorder("=") != encoding.dtype:
        raise EncodingError(f"pixels: data type {pixels.dtype}; need {encoding.dtype} for {encoding.name}")
    ordered = pixels[:, :, ::-1] if color is ColorModel.RGB else pixels
    return np.ascontiguousarray(ordered, encoding.dtype)
