# SPDX-License-Identifier: Apache-2.0
"""The image of a frame: from raw pixels to grey, at full resolution and halved, and to colour on demand."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np
from numpy.typing import NDArray

from imgu_ros.config.components import DevelopmentParameters
from imgu_ros.config.parameters import DemosaicParameters, RawParameters
from imgu_ros.errors import ImguError, ShapeError
from imgu_ros.frame import Frame
from imgu_ros.image.raw_samples import Mosaic
from imgu_ros.image.screen_picture import screen_picture
from imgu_ros.image.transfer_fit import SRGB_CURVE, TransferCurve, TransferKind
from imgu_ros.types import Image, as_image
from imgu_ros.vision.formation.bands import BandMode, grey_from_bands
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.demosaic import GREY_OF_MOSAIC, DemosaicMethod, demosaic, grey_from_mosaic
from imgu_ros.vision.formation.layout import ColorModel, RawImage
from imgu_ros.vision.formation.levels import stretched_to_8_bit, with_levels
from imgu_ros.vision.matching.patch_atlas import PatchAtlas
from imgu_ros.vision.processing.points import REC601, grey_from_rgb

_TO_RGB = {
    ColorModel.MONO: cv2.COLOR_GRAY2RGB,
    ColorModel.LUMA: cv2.COLOR_GRAY2RGB,
    ColorModel.BGR: cv2.COLOR_BGR2RGB,
    ColorModel.RGBA: cv2.COLOR_RGBA2RGB,
    ColorModel.BGRA: cv2.COLOR_BGRA2RGB,
    ColorModel.UYVY: cv2.COLOR_YUV2RGB_UYVY,
    ColorModel.YUYV: cv2.COLOR_YUV2RGB_YUY2,
}
_TO_GREY = {
    ColorModel.RGB: cv2.COLOR_RGB2GRAY,
    ColorModel.BGR: cv2.COLOR_BGR2GRAY,
    ColorModel.RGBA: cv2.COLOR_RGBA2GRAY,
    ColorModel.BGRA: cv2.COLOR_BGRA2GRAY,
    ColorModel.UYVY: cv2.COLOR_YUV2GRAY_UYVY,
    ColorModel.YUYV: cv2.COLOR_YUV2GRAY_YUY2,
}

#: Channels of a pixel; 1 stands for a two-dimensional array.
_CHANNELS = {
    ColorModel.BAYER: 1,
    ColorModel.MONO: 1,
    ColorModel.RGB: 3,
    ColorModel.BGR: 3,
    ColorModel.RGBA: 4,
    ColorModel.BGRA: 4,
    ColorModel.ARGB: 4,
    ColorModel.UYVY: 2,
    ColorModel.YUYV: 2,
    ColorModel.LUMA: 1,
}

#: A level whose shorter side is below this shows nothing that patches could be aligned with: they are 11 px wide by
#: default.
_SMALLEST_SIDE_PX = 8

#: Of the four sites of a quad, in reading order: 0 for red, 1 for green, 2 for blue.
_CHANNELS_OF = {
    BayerPattern.RGGB: (0, 1, 1, 2),
    BayerPattern.BGGR: (2, 1, 1, 0),
    BayerPattern.GRBG: (1, 0, 2, 1),
    BayerPattern.GBRG: (1, 2, 0, 1),
}
#: All sites of a quad see the same.
_ONE_CHANNEL = (0, 0, 0, 0)

_METHODS = frozenset(str(method) for method in DemosaicMethod)


class LightKind(StrEnum):
    """With what the samples of a frame are compared."""

    COLOR = "color"  #: the linear colours of a target: each site of a mosaic sees one
    GREY = "grey"  #: its grey, linear in the light
    CODED = "coded"  #: its grey as sRGB values


class FrameImage:
    """A frame's grey and colour images, each computed on the first call, then kept."""

    def __init__(self, image: RawImage, raw: RawParameters, method: str) -> None:
        self._layout = image.layout
        self._pixels = _checked_pixels(image)
        self._raw = raw
        self._method = method
        self._grey: Image | None = None
        self._color: Image | None = None
        self._halved: dict[int, Image] = {}
        #: Of the curve with which it was made.
        self._mosaic: tuple[TransferCurve | None, Mosaic | None] | None = None
        #: How the values follow from the light, where earlier frames told; used when `may_have_curve`.
        self.curve: TransferCurve | None = None
        #: From the exposure of one row to that of the next, of a rolling shutter, ns.
        self.row_time_ns = 0.0
        self._white = white = self._white_level()
        #: Whether values of 8 bits stay as they are.
        self._keeps_values = self._pixels.dtype == np.uint8 and raw.black_level == 0 and white == 255
        if white is not None and white <= raw.black_level:
            raise ShapeError(f"raw.black_level: {raw.black_level:g}; need less than the white level, {white:g}")
        #: Whether any part of the grey picture can be made without the rest of the frame.
        self._local = white is not None and (
            image.layout.color in (ColorModel.MONO, ColorModel.LUMA)
            or (
                image.layout.color is ColorModel.BAYER
                and method == DemosaicMethod.BILINEAR
                and raw.grey_weights == REC601
                and all(gain == 1.0 for gain in raw.gains)
            )
        )
        if image.layout.color is ColorModel.BANDS:
            self._grey = self._developed_grey()  # which bands there are is told by the pixels: what is wrong, at once

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width, px."""
        height, width = self._pixels.shape[:2]
        return height, width

    @property
    def is_linear(self) -> bool:
        """Whether the grey values go with the light, as `raw.transfer` says."""
        if self._raw.transfer == "auto":
            return self._layout.color in (ColorModel.BAYER, ColorModel.MONO, ColorModel.BANDS)
        return self._raw.transfer == "linear"

    @property
    def grey(self) -> Image:
        """The grey picture at full resolution, (H, W) uint8."""
        if self._grey is None:
            self._grey = self._developed_grey()
        return self._grey

    @property
    def most_halvings(self) -> int:
        """How often the image can be halved and still shows something."""
        return most_halvings(self.shape)

    def halved(self, times: int) -> Image:
        """Return the grey image halved `times` times, uint8: each pixel is the mean of 2^times x 2^times whole ones.

        Of a mosaic they are the pixels of quads, as many of each colour as there are: green counts a half.

        Raises
        ------
        ShapeError
            If nothing would be left of it.
        """
        if times < 0 or not min(self.shape) >> times:
            raise ShapeError(f"halved: {times} times, of {self.shape} px; need 0 to {self.most_halvings}")
        if times == 0:
            return self.grey
        if times not in self._halved:
            self._halved[times] = self._first_halved() if times == 1 else _half(self.halved(times - 1))
        return self._halved[times]

    def cut(self, sheet: PatchAtlas) -> Image:
        """Return squares of the grey picture as a sheet; those of a mosaic must begin at even pixels.

        In the outermost pixel of a square, where the mosaic's neighbours are missing, it may differ from the picture.

        Raises
        ------
        ShapeError
            If squares of a mosaic begin at odd pixels, or one reaches beyond the picture.
        """
        if self._grey is not None or not self._local:
            return sheet.cut(self.grey)
        squares = sheet.cut(self._pixels)
        if self._layout.color is ColorModel.BAYER and self._layout.pattern is not None:
            if (sheet.side | int(np.bitwise_or.reduce(sheet.origins, axis=None))) & 1:
                raise ShapeError("sheet: squares at odd pixels; need even ones, where a quad begins")
            squares = cv2.cvtColor(squares, GREY_OF_MOSAIC[self._layout.pattern])
        return self._stretched(squares)

    def color(self) -> Image:
        """Return the colour picture, (H, W, 3) RGB, uint8 or uint16; made on the first call, then kept.

        N-band images and greys become a grey RGB picture.
        """
        if self._color is None:
            self._color = self._developed_color()
        return self._color

    def for_screen(self) -> Image:
        """Return the colour picture as a screen shows it, (H, W, 3) RGB uint8, a new array: see `screen_picture`."""
        color, kind = self.color(), self._layout.color
        is_mosaic = kind is ColorModel.BAYER
        # Grey values of 8 bits are seldom a sensor's own.
        is_sensor = is_mosaic or (kind is ColorModel.MONO and color.dtype != np.uint8)
        is_coded = self.curve is not None and self.curve.kind is not TransferKind.LINEAR
        # A mosaic's levels have been stretched to the type's range where they are known.
        is_whole_range = color.dtype == np.uint8 or (is_mosaic and self._white is not None)
        return screen_picture(
            color,
            white=float(np.iinfo(color.dtype).max) if is_whole_range else self._white,
            is_light=is_sensor and self.is_linear and not is_coded,
            is_balanced=not is_mosaic or any(gain != 1.0 for gain in self._raw.gains),
        )

    @property
    def light_kind(self) -> LightKind:
        """With what `mosaic` is to be compared."""
        if self._layout.color is ColorModel.BAYER:
            return LightKind.COLOR
        return LightKind.GREY if self.is_linear else LightKind.CODED

    @property
    def mosaic(self) -> Mosaic | None:
        """The samples as they came, or those of the grey image where a pixel has several; None: they mean no light."""
        if self._mosaic is None or self._mosaic[0] is not self.curve:
            self._mosaic = self.curve, self._made_mosaic()
        return self._mosaic[1]

    def _made_mosaic(self) -> Mosaic | None:
        color, black, white = self._layout.color, self._raw.black_level, self._white or 0.0
        if color is ColorModel.BANDS:
            return None
        if color is ColorModel.BAYER and self._layout.pattern is not None:
            return Mosaic(self._pixels, _CHANNELS_OF[self._layout.pattern], black, white, self._light)
        if color is ColorModel.MONO and self.is_linear:
            return Mosaic(self._pixels, _ONE_CHANNEL, black, white, self._light)
        return Mosaic(self.grey, _ONE_CHANNEL, 0.0, 255.0)

    @property
    def may_have_curve(self) -> bool:
        """Whether the values are a sensor's, and `raw.transfer` leaves open how they follow from the light."""
        is_sensor = self._layout.color in (ColorModel.BAYER, ColorModel.MONO)
        return is_sensor and self._raw.transfer == "auto" and self._white is not None

    @property
    def _light(self) -> NDArray[np.float32] | None:
        """The light of each raw value, when it is not proportional."""
        curve = SRGB_CURVE if self._raw.transfer == "srgb" else self.curve
        if curve is None or curve.kind is TransferKind.LINEAR or self._white is None:
            return None
        return curve.table(self._raw.black_level, self._white, int(np.iinfo(self._pixels.dtype).max) + 1)

    def _first_halved(self) -> Image:
        if self._grey is not None or not self._local:
            return _half(self.grey)
        # Without developing the rest of the frame.
        return self._stretched(_half(self._pixels))

    def _stretched(self, grey: Image) -> Image:
        if self._keeps_values:
            return grey
        return stretched_to_8_bit(grey, self._raw.black_level, self._white)

    def _developed_grey(self) -> Image:
        pixels, layout = self._pixels, self._layout
        black, white = self._raw.black_level, self._white_level()
        if layout.color is ColorModel.BAYER and layout.pattern is not None:
            balanced = pixels
            if any(gain != 1.0 for gain in self._raw.gains):
                # Gains hold for what lies above black; a range as wide as the data type's scales nothing else.
                top = float(np.iinfo(pixels.dtype).max)
                balanced = with_levels(pixels, layout.pattern, black, black + top, self._raw.gains)
                black, white = 0.0, None if white is None else white - black
            if self._method == DemosaicMethod.BILINEAR and self._raw.grey_weights == REC601:
                grey = grey_from_mosaic(balanced, layout.pattern)
            else:
                grey = grey_of(demosaic(balanced, layout.pattern, self._method), self._raw.grey_weights)
        elif layout.color is ColorModel.BANDS:
            grey = self._grey_from_bands()
            if self._raw.band_mode in (BandMode.PRINCIPAL_COMPONENT, BandMode.SPECTRAL_ANGLE):
                black, white = 0.0, None  # no raw values: the levels of raw data mean nothing to them
        elif layout.color in (ColorModel.MONO, ColorModel.LUMA):
            grey = pixels
        elif layout.color in _TO_GREY and self._raw.grey_weights == REC601:
            grey = cv2.cvtColor(pixels, _TO_GREY[layout.color])
        else:
            grey = grey_of(self._rgb(), self._raw.grey_weights)
        return stretched_to_8_bit(grey, black, white)

    def _developed_color(self) -> Image:
        pixels, layout = self._pixels, self._layout
        if layout.color is ColorModel.BAYER and layout.pattern is not None:
            # Black and white level are applied only where they are known: colours keep the input's depth.
            leveled = with_levels(
                pixels, layout.pattern, self._raw.black_level, self._white_level() or 0.0, self._raw.gains
            )
            return demosaic(leveled, layout.pattern, self._method)
        if layout.color is ColorModel.BANDS:
            return cv2.cvtColor(self.grey, cv2.COLOR_GRAY2RGB)
        return self._rgb()

    def _rgb(self) -> Image:
        """Return the pixels of a layout that is neither a mosaic nor of bands as RGB."""
        pixels, color = self._pixels, self._layout.color
        if color is ColorModel.RGB:
            return pixels
        if color is ColorModel.ARGB:
            return np.ascontiguousarray(pixels[..., 1:])
        return cv2.cvtColor(pixels, _TO_RGB[color])

    def _grey_from_bands(self) -> Image:
        raw, pixels = self._raw, self._pixels
        available = 1 if pixels.ndim == 2 else pixels.shape[2]
        if raw.bands and max(raw.bands) >= available:
            raise ShapeError(f"raw.bands: {max(raw.bands)}; need 0 to {available - 1} (the image's bands)")
        count, mode = len(raw.bands) or available, BandMode(raw.band_mode)
        weights, reference = raw.band_weights, raw.reference_spectrum
        if mode is BandMode.WEIGHTED and len(weights) != count:
            raise ShapeError(f"raw.band_weights: {len(weights)} values; need {count}, one for each band")
        if mode is BandMode.SPECTRAL_ANGLE:
            if len(reference) != count:
                raise ShapeError(f"raw.reference_spectrum: {len(reference)} values; need {count}, one for each band")
            if raw.black_level:
                pixels = pixels - np.asarray(raw.black_level, np.float64)  # an angle is about the spectrum of no light
        return grey_from_bands(pixels, mode, raw.bands, weights, reference)

    def _white_level(self) -> float | None:
        """The raw value of full scale, or None when the data are to tell."""
        if self._raw.white_level > 0:
            return self._raw.white_level
        if self._pixels.dtype == np.uint16 and self._raw.significant_bits > 0:
            return float(2**self._raw.significant_bits - 1)
        return 255.0 if self._pixels.dtype == np.uint8 else None


@dataclass(frozen=True, slots=True, eq=False)
class Development:
    """What became of a frame's pixels; it may be computed ahead of the rest of the pipeline, in another thread.

    Attributes
    ----------
    image : None when the frame cannot be developed
    reason : why it cannot; empty when it was
    took_ns : time that it took
    """

    image: FrameImage | None
    reason: str
    took_ns: int


def develop_frame(frame: Frame, parameters: DevelopmentParameters) -> Development:
    """Develop a frame; what is wrong with it is said in the result. It depends on no other frame."""
    start = time.perf_counter_ns()
    try:
        image = develop(frame.image, parameters.raw, parameters.demosaic)
    except ImguError as error:
        return Development(None, str(error), time.perf_counter_ns() - start)
    return Development(image, "", time.perf_counter_ns() - start)


def develop(image: RawImage, raw: RawParameters, demosaicking: DemosaicParameters) -> FrameImage:
    """Check a raw image; its grey picture and its colours are made on demand.

    8-bit input keeps its values unless black or white level are set. Deeper input is brought to 8 bits between
    black and white level where they are known, else between percentiles of this frame, which also is the
    automatic gain of infrared pictures (IU 1.2.4).

    Raises
    ------
    ShapeError
        If the pixels do not fit their layout, `raw.bands` names a band that the image lacks, or the black level is
        not below the white level.
    """
    if demosaicking.method not in _METHODS:
        DemosaicMethod(demosaicking.method)  # raises, with the choices
    return FrameImage(image, raw, demosaicking.method)


def grey_of(color: Image, weights: Sequence[float]) -> Image:
    """Return the weighted mean of red, green and blue: of frames and of targets alike.

    Parameters
    ----------
    color : (H, W, 3) RGB, uint8 or uint16
    weights : of red, green and blue, >= 0, not all 0
    """
    if tuple(weights) == REC601:
        return cv2.cvtColor(color, cv2.COLOR_RGB2GRAY)
    return grey_from_rgb(color, np.divide(weights, sum(weights)))


def most_halvings(shape: tuple[int, int]) -> int:
    """Return how often an image of `shape`, (height, width) px, can be halved and still shows something."""
    return max(0, (min(shape) // _SMALLEST_SIDE_PX).bit_length() - 1)


def _half(image: Image) -> Image:
    height, width = image.shape[0] // 2, image.shape[1] // 2
    return cv2.resize(image[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA)


def _checked_pixels(image: RawImage) -> Image:
    """Return the pixels in native byte order and without gaps between rows, when they fit their layout."""
    pixels, layout = image.pixels, image.layout
    if layout.color is ColorModel.BANDS:
        if not isinstance(pixels, np.ndarray) or pixels.ndim not in (2, 3) or not pixels.size:
            shape = getattr(pixels, "shape", type(pixels).__name__)
            raise ShapeError(f"pixels: {shape}; need (H, W) or (H, W, N) with at least one pixel")
        if pixels.dtype.kind not in "uif":
            raise ShapeError(f"pixels: data type {pixels.dtype}; need real numbers")
        return np.ascontiguousarray(pixels, dtype=pixels.dtype.newbyteorder("="))
    if layout.color is ColorModel.BAYER and layout.pattern is None:
        raise ShapeError("layout: a Bayer image without a pattern; need one")
    packed = layout.color in (ColorModel.UYVY, ColorModel.YUYV)
    dtypes = (np.uint8,) if packed else (np.uint8, np.uint16)
    channels = _CHANNELS[layout.color]
    is_array = isinstance(pixels, np.ndarray) and pixels.dtype in dtypes and pixels.dtype.isnative and pixels.size > 0
    if not (
        is_array and pixels.flags.c_contiguous and pixels.shape[2:] == (channels,) * (channels > 1) and pixels.ndim > 1
    ):
        pixels = as_image(pixels, "pixels", (channels,), dtypes, rescaled=False)
    if image.pixels.dtype.type not in dtypes:
        need = ", ".join(np.dtype(d).name for d in dtypes)
        raise ShapeError(f"pixels: data type {image.pixels.dtype}; need {need}")
    if layout.color is ColorModel.BAYER and min(pixels.shape) < 2:
        raise ShapeError(f"pixels: shape {pixels.shape}; need at least one 2x2 quad")
    if packed and pixels.shape[1] % 2:
        raise ShapeError(f"pixels: shape {pixels.shape}; need an even width for {layout.color}")
    return pixels
