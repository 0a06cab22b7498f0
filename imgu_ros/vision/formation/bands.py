# SPDX-License-Identifier: Apache-2.0
"""Pictures of many spectral bands: one grey image out of them, and the spectral angle (IU 1.2.4-1.2.5)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from imgu_ros.arguments import as_integer, as_sequence
from imgu_ros.errors import ShapeError
from imgu_ros.types import Choice, Floats, Image, as_matrix, as_plain

_LARGEST = float(np.finfo(np.float32).max)
_SAMPLES = 1 << 16
#: pi less the angle of a pixel without a direction, in single precision.
_UNLIKE = 1e-6
#: Rows worked on at a time, so that no copy of a whole cube in double precision is made.
_ROWS = 64


class BandMode(Choice):
    """How a spectrum becomes one number."""

    MEAN = "mean"  #: mean of the bands
    WEIGHTED = "weighted"  #: weighted mean
    PRINCIPAL_COMPONENT = "principal_component"  #: along the direction in which the picture varies most
    SPECTRAL_ANGLE = "spectral_angle"  #: likeness to a reference spectrum, whatever the brightness


def grey_from_bands(
    cube: Image,
    mode: BandMode | str = BandMode.MEAN,
    bands: Sequence[int] = (),
    weights: ArrayLike = (),
    reference: ArrayLike = (),
) -> Image:
    """Return one grey image of an N-band cube.

    Parameters
    ----------
    cube : (H, W) or (H, W, N), of any real data type; a pixel with NaN or infinity in it has no value
    mode : mean, weighted, principal_component, or spectral_angle: bright where the spectrum is like the reference
    bands : numbers of the bands that count, 0 to N - 1; empty: all
    weights : one for each of these bands; for `weighted`
    reference : spectrum, one value for each of these bands; for `spectral_angle`

    Returns
    -------
    (H, W) float32; for the mean of one band of uint8 or uint16, that band in its own type. In the unit of the input,
    or, of spectral_angle, pi - angle in rad. Pixels without a value are as dark as the darkest of the others

    Raises
    ------
    ShapeError
        If the cube is not such an array, it lacks a band, or weights or reference do not fit the bands.

    Examples
    --------
    >>> cube = np.array([[[10, 20, 60], [0, 30, 30]]], np.uint8)
    >>> grey_from_bands(cube, "mean", bands=[2]).tolist(), grey_from_bands(cube, "mean", bands=[1, 2]).tolist()
    ([[60, 30]], [[40.0, 30.0]])
    """
    cube = _chosen(_as_cube(cube), bands)
    mode = BandMode(mode)
    if mode is BandMode.PRINCIPAL_COMPONENT:
        return principal_component(cube)
    if mode is BandMode.SPECTRAL_ANGLE:
        likeness = np.pi - spectral_angle(cube, reference).astype(np.float64)
        return _filled(np.where(likeness > _UNLIKE, likeness, np.nan), True)
    if mode is BandMode.WEIGHTED:
        return mean_of_bands(cube, weights)
    if cube.shape[2] == 1 and cube.dtype in (np.uint8, np.uint16):
        return np.ascontiguousarray(cube[:, :, 0])
    return mean_of_bands(cube)


def mean_of_bands(cube: Image, weights: ArrayLike | None = None) -> Image:
    """Return the mean, or weighted mean, of the bands at each pixel.

    Parameters
    ----------
    cube : (H, W) or (H, W, N), of any real data type; a pixel with NaN or infinity in it has no value
    weights : (N,), >= 0, not all 0; None: all alike

    Returns
    -------
    (H, W) float32, in the unit of the input (beyond float32's range, clamped); pixels without a value are as dark as
    the darkest of the others

    Raises
    ------
    ShapeError
        If the cube is not such an array, or the weights do not fit.

    Examples
    --------
    >>> cube = np.array([[[10, 20, 60], [0, 30, 30]]], np.uint8)
    >>> mean_of_bands(cube).tolist(), mean_of_bands(cube, [1, 0, 3]).tolist()
    ([[30.0, 20.0]], [[47.5, 22.5]])
    """
    cube = _as_cube(cube)
    if weights is None:
        with np.errstate(invalid="ignore", over="ignore"):
            return _filled(np.asarray(np.mean(cube, axis=2, dtype=np.float64)), cube.dtype.kind == "f")
    factors = as_matrix(weights, cube.shape[2:], "weights")
    if (factors < 0).any() or not factors.any():
        raise ShapeError(f"weights: {factors.tolist()}; need numbers >= 0, not all 0")
    factors = factors / factors.max()
    factors = factors / factors.sum()
    # A band of weight 0 must not count, even where it has no value.
    used = factors > 0
    mean = np.empty(cube.shape[:2])
    with np.errstate(invalid="ignore", over="ignore"):
        for row in range(0, len(mean), _ROWS):
            mean[row : row + _ROWS] = cube[row : row + _ROWS][:, :, used].astype(np.float64) @ factors[used]
    return _filled(mean, cube.dtype.kind == "f")


def principal_component(cube: Image) -> Image:
    """Return the first principal component: the weighted sum of bands that varies most over the picture.

    Of all sums with weights of unit length it has the largest variance, hence the best contrast over noise that is
    alike in all bands (Pearson 1901; Jolliffe 2002, chapter 1). Its sign is that with which the weights add up to more
    than 0, so that what is bright in most bands is bright; where they add up to 0, the largest weight is positive, the
    first one if several are. The weights are found from some 65 000 pixels on a regular grid.

    Parameters
    ----------
    cube : (H, W) or (H, W, N), of any real data type; a pixel with NaN or infinity in it has no value

    Returns
    -------
    (H, W) float32, mean about 0, in the unit of the input (beyond float32's range, clamped); pixels without a value
    are as dark as the darkest of the others; a picture without contrast is 0

    Raises
    ------
    ShapeError
        If the cube is not such an array.

    Examples
    --------
    Two bands that vary along (3, 4):

    >>> t = np.array([[-2.0, -1.0, 0.0, 3.0]])
    >>> principal_component(np.stack((6 + 3 * t, 7 + 4 * t), axis=2)).tolist()
    [[-10.0, -5.0, 0.0, 15.0]]
    """
    cube = _as_cube(cube)
    step = max(1, int(np.sqrt(cube.shape[0] * cube.shape[1] / _SAMPLES)))
    sample = _clamped(cube[::step, ::step].reshape(-1, cube.shape[2]))
    sample = sample[np.isfinite(sample).all(axis=1)]
    if not len(sample):  # too few pixels have a value for a grid to meet one
        sample = _clamped(cube.reshape(-1, cube.shape[2]))
        sample = sample[np.isfinite(sample).all(axis=1)]
    if not len(sample):
        return np.zeros(cube.shape[:2], np.float32)
    mean = sample.mean(axis=0)
    deviation = sample - mean
    largest = float(np.abs(deviation).max())
    if largest == 0:
        weights = np.ones(cube.shape[2]) / np.sqrt(cube.shape[2])
    else:
        deviation /= largest  # so that squares neither overflow nor vanish
        weights = np.linalg.eigh(deviation.T @ deviation)[1][:, -1]
    weights = weights * _sign(weights)
    out = np.empty(cube.shape[:2])
    with np.errstate(invalid="ignore", over="ignore"):
        for row in range(0, len(out), _ROWS):
            out[row : row + _ROWS] = (_clamped(cube[row : row + _ROWS]) - mean) @ weights
    return _filled(out, cube.dtype.kind == "f")


def spectral_angle(cube: Image, reference: ArrayLike) -> Image:
    """Return the angle between each pixel's spectrum and a reference: 0 where only the brightness differs.

    The spectral angle mapper (Kruse et al. 1993): cos(angle) = x . r / (|x| |r|), computed as the arctangent of the
    parts of x across and along r, which keeps the digits of small angles.

    Parameters
    ----------
    cube : (H, W, N), of any real data type, N >= 2, black level removed
    reference : (N,), not all 0

    Returns
    -------
    (H, W) float32 in [0, pi], rad; pi, the most unlike, where a pixel has no direction: all 0, or NaN or infinite

    Raises
    ------
    ShapeError
        If the cube is not such an array, or the reference has another length or is 0.

    Examples
    --------
    >>> cube = np.array([[[2, 0], [3, 3], [0, 9], [0, 0]]], np.uint8)
    >>> np.degrees(spectral_angle(cube, [1, 0])).astype(float).round(3).tolist()
    [[0.0, 45.0, 90.0, 180.0]]
    """
    cube = _as_cube(cube)
    if cube.shape[2] < 2:
        raise ShapeError("cube: 1 band; need 2 or more for an angle between spectra")
    direction = as_matrix(reference, cube.shape[2:], "reference")
    if not direction.any():
        raise ShapeError("reference: all 0; need a spectrum")
    direction = direction / np.abs(direction).max()
    direction /= np.linalg.norm(direction)
    out = np.empty(cube.shape[:2], np.float32)
    for row in range(0, len(out), _ROWS):
        out[row : row + _ROWS] = _angles(cube[row : row + _ROWS], direction)
    return out


def _angles(block: Image, direction: Floats) -> Floats:
    """Return the angles (rows, columns) of spectra (rows, columns, N) to a direction of unit length."""
    spectra = _clamped(block)
    if block.dtype.kind == "f":
        spectra[~np.isfinite(spectra).all(axis=2)] = 0
        if block.dtype.itemsize > 4:  # the squares of doubles may vanish
            largest = np.abs(spectra).max(axis=2, keepdims=True)
            spectra /= np.where(largest > 0, largest, 1)
    along = spectra @ direction
    spectra -= along[:, :, None] * direction
    aside = np.sqrt(np.einsum("ijk,ijk->ij", spectra, spectra))
    return np.where((aside > 0) | (along != 0), np.arctan2(aside, along), np.pi)


def _sign(weights: Floats) -> float:
    total = float(weights.sum())
    if abs(total) > 1e-6:
        return 1.0 if total > 0 else -1.0
    # Weights that are alike but for rounding count as equal: the first of them decides.
    first = int(np.flatnonzero(np.abs(weights) > np.abs(weights).max() - 1e-6)[0])
    return 1.0 if weights[first] > 0 else -1.0


def _clamped(values: NDArray[Any]) -> Floats:
    """Return float64 within float32's range, whose squares are within float64's; NaN stays, infinity becomes NaN."""
    if values.dtype.kind != "f":
        return values.astype(np.float64)
    out = values.astype(np.float64)
    out[np.isinf(out)] = np.nan
    return np.clip(out, -_LARGEST, _LARGEST)


def _filled(grey: Floats, may_lack_values: bool) -> Image:
    """Return float32; pixels without a value are dark, and must not stretch the range of the others."""
    if may_lack_values:
        valid = np.isfinite(grey)
        grey[~valid] = grey[valid].min() if valid.any() else 0.0
        np.clip(grey, -_LARGEST, _LARGEST, out=grey)
    return grey.astype(np.float32)


def _chosen(cube: Image, bands: Sequence[int]) -> Image:
    numbers = [as_integer(band, "bands") for band in as_sequence(bands, "bands")]
    if not numbers:
        return cube
    if min(numbers) < 0 or max(numbers) >= cube.shape[2]:
        wrong = min(numbers) if min(numbers) < 0 else max(numbers)
        raise ShapeError(f"bands: {wrong}; need 0 to {cube.shape[2] - 1} (the image's bands)")
    return cube[:, :, numbers]


def _as_cube(cube: Image) -> Image:
    cube = as_plain(cube, "cube")
    if cube.ndim not in (2, 3) or not cube.size:
        raise ShapeError(f"cube: shape {cube.shape}; need (H, W) or (H, W, N) with at least one pixel")
    if cube.dtype.kind not in "buif":
        raise ShapeError(f"cube: data type {cube.dtype}; need real numbers")
    cube = np.asarray(cube, dtype=cube.dtype.newbyteorder("="))
    return cube if cube.ndim == 3 else cube[:, :, None]
