# SPDX-License-Identifier: Apache-2.0
"""Image files: PNM, PNG, TIFF and JPEG at their own depth, and headerless raw data."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from imgu_ros.config.parameters import DEFAULT_LIMITS, LimitsParameters
from imgu_ros.errors import EncodingError, FileError, ShapeError
from imgu_ros.file_access.atomic_files import write_whole
from imgu_ros.image_files.checks import is_picture_file
from imgu_ros.image_files.cost import check_cost, check_memory
from imgu_ros.image_files.decoding import decode_checked, decode_picture_file
from imgu_ros.image_files.formats import check_structure
from imgu_ros.image_files.pnm import decode_pnm, encode_pnm, is_pnm
from imgu_ros.image_files.tags import (
    UPRIGHT,
    ExtraSample,
    PictureTags,
    picture_tags,
    turned_upright,
)
from imgu_ros.image_files.tiff import is_tiff
from imgu_ros.image_files.transparency import compose, split_alpha
from imgu_ros.types import Image, as_image

#: What each kind of file can hold: (number of channels, data types).
_WRITABLE: dict[str, tuple[tuple[int, ...], tuple[type, ...]]] = {
    ".png": ((1, 3), (np.uint8, np.uint16)),
    ".tif": ((1, 3), (np.uint8, np.uint16, np.float32)),
    ".tiff": ((1, 3), (np.uint8, np.uint16, np.float32)),
    ".jpg": ((1, 3), (np.uint8,)),
    ".jpeg": ((1, 3), (np.uint8,)),
    ".pbm": ((1,), (np.uint8,)),
    ".pgm": ((1,), (np.uint8, np.uint16)),
    ".ppm": ((3,), (np.uint8, np.uint16)),
    ".pnm": ((1, 3), (np.uint8, np.uint16)),
}
#: Suffixes that `write_image` knows.
RASTER_SUFFIXES = tuple(_WRITABLE)
_PNM = (".pbm", ".pgm", ".ppm", ".pnm")
_READABLE_DTYPES = (np.uint8, np.uint16, np.float32)
#: The note about a picture with transparency.
COMPOSED = "transparent: composed on white"
_LZW = 5  # else OpenCV 4 writes float colours as LogLuv, which loses precision


@dataclass(frozen=True, slots=True, eq=False)
class ImageFile:
    """The pixels of an image file, and what was done to them.

    Attributes
    ----------
    pixels : (H, W) or (H, W, 3) RGB; uint8, uint16, or float32 from a TIFF file
    notes : what the user should know, such as "transparent: composed on white"; without the file's name
    alpha : (H, W) like `pixels`, of a picture that was composed; None: it was opaque
    """

    pixels: Image
    notes: tuple[str, ...] = ()
    alpha: Image | None = None


def read_image(path: Path | str, *, upright: bool = False, limits: LimitsParameters = DEFAULT_LIMITS) -> Image:
    """Return the pixels of an image file; see `read_image_file`."""
    return read_image_file(path, upright=upright, limits=limits).pixels


def read_image_file(
    path: Path | str, *, upright: bool = False, limits: LimitsParameters = DEFAULT_LIMITS, pixel_bytes: int = 0
) -> ImageFile:
    """Read an image file at its own depth.

    Values are those of the file, never scaled: a PGM of maxval 4095 gives 0 to 4095. A bitmap has 0 and 255. A picture
    with transparency is composed on white, in the values of the file.

    Parameters
    ----------
    path : PBM, PGM, PPM (plain or binary), PNG, TIFF, JPEG, BMP or WebP; the content counts, not the suffix
    upright : turn the picture as its orientation tag (Exif, TIFF) says, for pictures to be looked at. False: pixels
        stay as they were read out, for a camera's model or a Bayer pattern belongs to them
    limits : what decoding may cost
    pixel_bytes : bytes that the caller will need for each pixel

    Raises
    ------
    FileError
        If the file is missing, empty, no image, cut, damaged, of another depth, a TIFF of grey and alpha, or beyond
        the limits.
    """
    path = Path(path)
    try:
        file, orientation = _decoded(_content(path, limits), limits, pixel_bytes)
    except EncodingError as error:
        raise FileError(f"{path}: {error}") from None
    return _oriented(file, orientation, upright)


def write_image(path: Path | str, pixels: Image, *, plain: bool = False, quality: int = 95) -> None:
    """Write an image file; the suffix chooses the format. All but JPEG are lossless.

    Parameters
    ----------
    path : .png (8 or 16 bit), .tif or .tiff (8 or 16 bit, float32), .jpg or .jpeg (8 bit), .pgm (grey), .ppm (colour),
        .pnm (either; 8 or 16 bit), .pbm (0 and 255 alone)
    pixels : (H, W) or (H, W, 3) RGB; bool is written as black and white, other types as `as_image` takes them
    plain : write PNM as text
    quality : of a JPEG, 0 to 100

    Raises
    ------
    FileError
        If the format is unknown, cannot hold these pixels, or the file cannot be written.
    ShapeError
        If `pixels` is not an image.
    """
    path = Path(path)
    if isinstance(pixels, np.ndarray) and pixels.dtype == np.bool_:
        pixels = as_image(pixels, "image", (1, 3), (np.uint8,))
    check_image_file(path, pixels)
    pixels = as_image(pixels, "image", (1, 3))
    write_whole(path, _encoded(path, path.suffix.lower(), pixels, plain, quality))


def check_image_file(path: Path | str, pixels: Image | None = None) -> None:
    """Check before the work that `write_image` will know the format, and that it can hold such pixels.

    Parameters
    ----------
    path : of the file to be
    pixels : of the data type and the channels to be, of any size; None: not known yet

    Raises
    ------
    FileError
        If the format is unknown, or cannot hold these pixels.
    ShapeError
        If `pixels` is not an image.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _WRITABLE:
        raise FileError(f"{path}: suffix {path.suffix!r}; need one of {', '.join(_WRITABLE)}")
    if pixels is None:
        return
    pixels = as_image(pixels, "image", (1, 3))
    try:
        as_image(pixels, "image", *_WRITABLE[suffix], rescaled=False)
    except ShapeError as error:
        raise FileError(f"{path}: {error} in a {suffix} file") from None


def read_raw_image(
    path: Path | str,
    width: int,
    height: int,
    dtype: str | np.dtype[np.generic],
    *,
    limits: LimitsParameters = DEFAULT_LIMITS,
) -> Image:
    """Read pixels without a header.

    Parameters
    ----------
    path : height rows of width values, one after the other
    width, height : px
    dtype : "uint8", "uint16" (little-endian), ">u2" (big-endian)
    limits : what reading may cost

    Returns
    -------
    (H, W) uint8 or uint16, in the machine's byte order

    Raises
    ------
    FileError
        If the file is missing or has another size than width x height x bytes of a value, or an argument is not as
        above.
    """
    path = Path(path)
    stored = _raw_dtype(path, dtype)
    if width < 1 or height < 1:
        raise FileError(f"{path}: size {width} x {height}; need at least 1 x 1")
    need = width * height * stored.itemsize
    try:
        size = path.stat().st_size
    except OSError as error:
        raise FileError(f"{path}: {error.strerror}; need a raw image file") from None
    if size != need and path.is_file():
        raise FileError(f"{path}: {size} bytes; need {need} ({width} x {height} x {stored.itemsize})")
    values = np.frombuffer(_content(path, limits), stored)
    if values.size != width * height:
        raise FileError(f"{path}: {values.nbytes} bytes; need {need} ({width} x {height} x {stored.itemsize})")
    native: Image = values.reshape(height, width).astype(stored.newbyteorder("="))
    return native


def _decoded(content: bytes, limits: LimitsParameters, pixel_bytes: int) -> tuple[ImageFile, int]:
    """Return the picture of a file, opaque and not turned, and its orientation."""
    if is_pnm(content):
        return ImageFile(decode_pnm(content, limits, pixel_bytes)), UPRIGHT
    encoded, is_of_libtiff = np.frombuffer(content, np.uint8), is_tiff(content)
    if is_picture_file(encoded):
        with _decoder_silenced():
            pixels = decode_picture_file(encoded, limits, pixel_bytes).pixels
        tags = picture_tags(content)
    else:
        checked = check_structure(content, limits)
        check_cost(checked.file, limits, pixel_bytes)
        tags = picture_tags(content)
        del content, encoded  # a TIFF's was copied
        with _decoder_silenced():
            pixels = decode_checked(checked.data, checked.file)
    if pixels.dtype not in [np.dtype(dtype) for dtype in _READABLE_DTYPES]:
        raise EncodingError(f"data type {pixels.dtype}; need uint8, uint16 or float32")
    if pixels.ndim == 3 and pixels.shape[2] not in (3, 4):
        raise EncodingError(f"{pixels.shape[2]} channels; need 1, 3 or 4")
    if is_of_libtiff and pixels.dtype == np.uint8 and tags.extra is ExtraSample.STRAIGHT:
        # libtiff multiplies the colours of 8 bits by an alpha that stands beside them.
        tags = replace(tags, extra=ExtraSample.PREMULTIPLIED)
    return _opaque(pixels, tags), tags.orientation


def _opaque(pixels: Image, tags: PictureTags) -> ImageFile:
    """Return decoded pixels in RGB, composed on white where they are transparent."""
    if pixels.ndim == 3:
        _swap(pixels)
    color, alpha = split_alpha(pixels, tags)
    if alpha is None:
        return ImageFile(color)
    compose(color, alpha, tags.extra)
    return ImageFile(color, (COMPOSED,), alpha)


def _oriented(file: ImageFile, orientation: int, upright: bool) -> ImageFile:
    if orientation == UPRIGHT:
        return file
    if not upright:
        ignored = f"orientation tag {orientation} ignored: pixels stay as the sensor gave them"
        return replace(file, notes=(*file.notes, ignored))
    alpha = None if file.alpha is None else turned_upright(file.alpha, orientation)
    return replace(file, pixels=turned_upright(file.pixels, orientation), alpha=alpha)


@contextlib.contextmanager
def _decoder_silenced() -> Iterator[None]:
    """Keep OpenCV 5 from logging about a damaged file: what is wrong is said by the error."""
    logging: Any = getattr(cv2.utils, "logging", None)
    if logging is None:
        yield
        return
    level = logging.setLogLevel(logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        logging.setLogLevel(level)


def _encoded(path: Path, suffix: str, pixels: Image, plain: bool, quality: int) -> bytes:
    if suffix in _PNM:
        try:
            return encode_pnm(pixels, plain=plain, bitmap=suffix == ".pbm")
        except ShapeError as error:
            raise FileError(f"{path}: {error}") from None
    if plain or not 0 <= quality <= 100:
        need = f"a suffix of {', '.join(_PNM)} for plain text" if plain else "a quality of 0 to 100"
        raise FileError(f"{path}: plain {plain}, quality {quality}; need {need}")
    options = {
        ".jpg": [cv2.IMWRITE_JPEG_QUALITY, quality],
        ".jpeg": [cv2.IMWRITE_JPEG_QUALITY, quality],
        ".tif": [cv2.IMWRITE_TIFF_COMPRESSION, _LZW],
        ".tiff": [cv2.IMWRITE_TIFF_COMPRESSION, _LZW],
    }.get(suffix, [])
    try:
        done, encoded = cv2.imencode(
            suffix, pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR), options
        )
    except cv2.error as error:
        raise FileError(f"{path}: cannot be encoded ({_reason(error)})") from None
    if not done:
        raise FileError(f"{path}: OpenCV cannot encode {pixels.shape} {pixels.dtype}")
    return encoded.tobytes()


def _raw_dtype(path: Path, dtype: str | np.dtype[np.generic]) -> np.dtype[np.generic]:
    try:
        stored: np.dtype[np.generic] = np.dtype(dtype)
    except TypeError:
        raise FileError(f"{path}: data type {dtype!r}; need uint8, uint16 or >u2") from None
    if stored.kind != "u" or stored.itemsize > 2:
        raise FileError(f"{path}: data type {stored}; need uint8, uint16 or >u2")
    # "uint16" says nothing of the order of bytes: files are little-endian unless said otherwise.
    return stored.newbyteorder("<") if stored.byteorder == "=" else stored


def _content(path: Path, limits: LimitsParameters) -> bytes:
    if path.exists() and not path.is_file():  # reading a pipe or a device might never end
        raise FileError(f"{path}: {'a folder' if path.is_dir() else 'no regular file'}; need an image file")
    try:
        check_memory(path.stat().st_size, "its size", limits)
        content = path.read_bytes()
    except EncodingError as error:
        raise FileError(f"{path}: {error}") from None
    except (OSError, ValueError) as error:
        raise FileError(f"{path}: {getattr(error, 'strerror', None) or error}; need an image file") from None
    if not content:
        raise FileError(f"{path}: empty file (0 bytes); need an image")
    return content


def _swap(pixels: Image) -> None:
    """Swap red and blue in place, some rows at a time."""
    code = cv2.COLOR_BGR2RGB if pixels.shape[2] == 3 else cv2.COLOR_BGRA2RGBA
    for top in range(0, len(pixels), _STRIP_ROWS):
        pixels[top : top + _STRIP_ROWS] = cv2.cvtColor(pixels[top : top + _STRIP_ROWS], code)


_STRIP_ROWS = 64


def _reason(error: cv2.error) -> str:
    return " ".join(str(error).split())[:160]
