# SPDX-License-Identifier: Apache-2.0
"""The Laplacian pyramid: what each octave adds, and the picture from it (IU 3.2.3; Burt & Adelson 1983)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imgu_ros.arguments import as_integer, require_type
from imgu_ros.errors import ShapeError
from imgu_ros.types import Image, as_image
from imgu_ros.vision.processing.points import require_range
from imgu_ros.vision.scale_space.gaussian import GaussianKernel
from imgu_ros.vision.scale_space.pyramid import enlarged, reduced

_MOST_LEVELS = 32

#: Data types that hold the differences of an image type.
_SIGNED: dict[str, type] = {"uint8": np.int16, "uint16": np.int32, "float32": np.float32}


@dataclass(frozen=True, slots=True, eq=False)
class LaplacianPyramid:
    """A picture, taken apart by scales.

    Attributes
    ----------
    bands : from fine to coarse, (H_k, W_k) or (H_k, W_k, 3), the difference between a level and the enlarged next:
        int16 for uint8 pictures, int32 for uint16, float32 for float32
    base : what remains, of the picture's data type, half as large as the last band
    """

    bands: tuple[Image, ...]
    base: Image


def laplacian_pyramid(
    image: Image, levels: int = 5, kernel: GaussianKernel | str = GaussianKernel.SAMPLED
) -> LaplacianPyramid:
    """Take a picture apart into octaves.

    Parameters
    ----------
    image : (H, W) or (H, W, 3), uint8, uint16 or float32
    levels : most bands, 0 to 32; fewer when the picture has shrunk to one pixel
    kernel : Gaussian that smooths before subsampling

    Raises
    ------
    ShapeError
        If `image` is not such an image or its values leave float32, the number of levels lies outside its range or
        the kernel is unknown.

    Notes
    -----
    Source: IU 3.2.3; Burt & Adelson 1983. Each difference is taken from what `reconstructed` will have there, not
    from the level itself: roundings do not add up from level to level.

    Examples
    --------
    >>> image = np.arange(64, dtype=np.uint8).reshape(8, 8)
    >>> parts = laplacian_pyramid(image, 2)
    >>> [band.shape for band in parts.bands], parts.base.shape
    ([(8, 8), (4, 4)], (2, 2))
    >>> bool((reconstructed(parts) == image).all())
    True
    """
    levels = as_integer(levels, "levels")
    image = as_image(image, channels=(1, 3))
    if not isinstance(levels, int | np.integer) or not 0 <= levels <= _MOST_LEVELS:
        raise ShapeError(f"levels: {levels!r}; need an integer, 0 to {_MOST_LEVELS}")
    kernel = GaussianKernel(kernel)
    require_range(image, 16.0)
    pictures = [image]
    while len(pictures) <= levels and max(pictures[-1].shape[:2]) > 1:
        pictures.append(reduced(pictures[-1], 2.0, kernel))
    coarse = base = pictures.pop()
    bands = []
    for picture in reversed(pictures):
        expected = enlarged(coarse, picture.shape[1::-1])
        band: Image = picture.astype(_SIGNED[image.dtype.name]) - expected
        bands.append(band)
        coarse = _sum(expected, band, image.dtype)
    return LaplacianPyramid(tuple(reversed(bands)), base)


def reconstructed(pyramid: LaplacianPyramid) -> Image:
    """Put a picture together again.

    Parameters
    ----------
    pyramid : what `laplacian_pyramid` made, bands changed or not

    Bit-exact for integer pictures; to one unit in the last place of the largest value for float32. Bands may have been
    changed in between: what leaves an integer type's range is clamped.

    Raises
    ------
    ShapeError
        If the bands do not fit each other or the base in shape or data type.

    Notes
    -----
    Source: IU 3.2.3; Burt & Adelson 1983.
    """
    require_type(pyramid, LaplacianPyramid, "pyramid")
    picture = as_image(pyramid.base, "base", channels=(1, 3))
    dtype = picture.dtype
    signed = np.dtype(_SIGNED[dtype.name])
    for k in reversed(range(len(pyramid.bands))):
        band = pyramid.bands[k]
        if not isinstance(band, np.ndarray) or band.dtype.newbyteorder("=") != signed:
            got = getattr(band, "dtype", type(band).__name__)
            raise ShapeError(f"bands[{k}]: {got}; need {signed} for a base of {dtype}")
        halves = tuple(max(1, round(n / 2 - 1e-9)) for n in band.shape[:2])
        if band.ndim != picture.ndim or band.shape[2:] != picture.shape[2:] or halves != picture.shape[:2]:
            raise ShapeError(f"bands[{k}]: shape {band.shape}; need twice {picture.shape}, a coarser level's")
        band = np.ascontiguousarray(band, signed)
        if dtype.kind == "f":
            _require_small(band, f"bands[{k}]")
            require_range(picture, 16.0)
        picture = _sum(enlarged(picture, band.shape[1::-1]), band, dtype)
    return picture


def _sum(expected: Image, band: Image, dtype: np.dtype[np.generic]) -> Image:
    if dtype.kind == "f":
        return np.asarray(expected + band)
    total = expected.astype(np.int64) + band
    return np.clip(total, 0, np.iinfo(dtype.name).max).astype(dtype)


def _require_small(band: Image, name: str) -> None:
    largest = float(np.finfo(np.float32).max) / 64
    if not (np.abs(band) <= largest).all():
        raise ShapeError(f"{name}: values not finite or beyond {largest:.3g}; need smaller ones")
