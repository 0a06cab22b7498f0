# SPDX-License-Identifier: Apache-2.0
"""From light to digital numbers: shot noise, read noise, quantisation (IU 1.1.6; EMVA Standard 1288, section 2)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_generator, as_integer, as_number, require_type
from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Image, as_floats, as_image
from imgu_ros.vision.formation.transfer import TransferFunction, encode_light

#: Bit depths of analogue-to-digital converters that can be simulated.
BIT_DEPTHS = (8, 10, 12, 14, 16)
#: Below this mean a Poisson variable is too skewed to be drawn from a normal distribution.
_FEW_ELECTRONS = 30.0
#: More light than this, in multiples of saturation, is as much: keeps single precision from overflowing.
_MOST_LIGHT = 1e6
_MOST_ELECTRONS = 1e15


@dataclass(frozen=True, slots=True)
class Sensor:
    """A linear image sensor.

    Attributes
    ----------
    bits : of the converter: 8, 10, 12, 14 or 16; right-aligned in its output
    full_well_e : electrons that saturate the converter
    read_noise_e : standard deviation of the dark signal, electrons
    black_level_dn : digital number of no light
    """

    bits: int = 8
    full_well_e: float = 10_000.0
    read_noise_e: float = 4.0
    black_level_dn: float = 0.0

    def __post_init__(self) -> None:
        """Raise ShapeError when a value is out of range."""
        if as_integer(self.bits, "bits") not in BIT_DEPTHS:
            raise ShapeError(f"bits: {self.bits}; need one of {', '.join(map(str, BIT_DEPTHS))}")
        if not 1e-15 <= as_number(self.full_well_e, "full_well_e") <= _MOST_ELECTRONS:
            raise ShapeError(f"full_well_e: {self.full_well_e:g}; need more than 0 electrons (1e-15 to 1e15)")
        if not 0 <= as_number(self.read_noise_e, "read_noise_e") <= _MOST_ELECTRONS:
            raise ShapeError(f"read_noise_e: {self.read_noise_e:g}; need 0 electrons or more (to 1e15)")
        if not 0 <= as_number(self.black_level_dn, "black_level_dn") < self.white_level_dn:
            raise ShapeError(f"black_level_dn: {self.black_level_dn:g}; need 0 to below {self.white_level_dn}")

    @property
    def white_level_dn(self) -> int:
        """Largest digital number."""
        return (1 << self.bits) - 1

    @property
    def gain_dn_per_e(self) -> float:
        """Digital numbers an electron."""
        return (self.white_level_dn - self.black_level_dn) / self.full_well_e

    def amplified(self, gain: float) -> Sensor:
        """Return the sensor with `gain` times the digital numbers an electron: twice the ISO number is a gain of 2.

        Fewer electrons then saturate the converter; noise in electrons stays.

        Raises
        ------
        ShapeError
            If the gain is not positive.
        """
        gain = as_number(gain, "gain")
        if not (math.isfinite(gain) and gain > 0):
            raise ShapeError(f"gain: {gain:g}; need more than 0")
        return replace(self, full_well_e=self.full_well_e / gain)

    def expected_dn(self, mean_e: ArrayLike) -> Floats:
        """Return the digital number that `mean_e` electrons (any shape, >= 0) give on average, unclipped."""
        return np.asarray(self.black_level_dn + self.gain_dn_per_e * _as_electrons(mean_e))

    def variance_dn(self, mean_e: ArrayLike) -> Floats:
        """Return the digital number's variance, unclipped: gain^2 (mean + read^2) + 1/12 (EMVA 1288, equation 15).

        Over the mean it is a straight line, the photon transfer curve: its slope is the gain.
        """
        return np.asarray(self.gain_dn_per_e**2 * (_as_electrons(mean_e) + self.read_noise_e**2) + 1 / 12)


def quantise(signal: Image, bits: int) -> Image:
    """Convert an analogue signal to digital numbers: rounded to the nearest of 2^bits, clamped at both ends.

    Parameters
    ----------
    signal : (H, W) or (H, W, C) float32, 0 to 1 is the converter's range
    bits : 8, 10, 12, 14 or 16; right-aligned in the result

    Returns
    -------
    same shape, uint8 for 8 bits, else uint16; the error is at most half a step, its variance a twelfth of a step's
    square where the signal moves over many steps

    Raises
    ------
    ShapeError
        If `signal` is not such an image, or there is no converter of that many bits.

    Examples
    --------
    >>> quantise(np.array([[-0.1, 0.25, 1.0, 2.0]], np.float32), 10).tolist()
    [[0, 256, 1023, 1023]]
    """
    bits = as_integer(bits, "bits")
    signal = as_image(signal, "signal", channels=(1, 3, 4), dtypes=(np.float32,))
    if bits not in BIT_DEPTHS:
        raise ShapeError(f"bits: {bits}; need one of {', '.join(map(str, BIT_DEPTHS))}")
    steps = np.rint(np.clip(signal, 0, 1) * np.float32((1 << bits) - 1))
    return np.asarray(steps, np.uint8 if bits == 8 else np.uint16)


def expose(
    light: Image,
    sensor: Sensor,
    rng: np.random.Generator | int,
    transfer: TransferFunction | str = TransferFunction.LINEAR,
) -> Image:
    """Turn light into digital numbers.

    Parameters
    ----------
    light : (H, W) or (H, W, C) float32, 1 saturates the sensor; negative counts as 0
    sensor : its noise and converter
    rng : source of the noise, or its seed
    transfer : function from the noisy signal above black to what the converter quantises: linear, srgb or film

    Returns
    -------
    same shape, uint8 for 8 bits, else uint16

    Raises
    ------
    ShapeError
        If `light` is not such an image, or there is no such transfer function.

    Examples
    --------
    >>> light = np.full((200, 300), 0.5, np.float32)
    >>> pixels = expose(light, Sensor(bits=12, full_well_e=10_000), np.random.default_rng(0))
    >>> str(pixels.dtype), round(float(pixels.mean())), round(float(pixels.std()))  # sqrt(5016) e x 0.41 DN/e
    ('uint16', 2048, 29)
    """
    require_type(sensor, Sensor, "sensor")
    light = as_image(light, "light", channels=(1, 3, 4), dtypes=(np.float32,))
    rng, transfer = as_generator(rng), TransferFunction(transfer)
    electrons = np.minimum(light, np.float32(_MOST_LIGHT))
    electrons *= np.float32(sensor.full_well_e)
    np.maximum(electrons, 0, out=electrons)
    few = np.flatnonzero(electrons < _FEW_ELECTRONS)
    few_means = electrons.ravel()[few]
    # Shot and read noise are independent: one normal draw carries both where electrons are many.
    noise = rng.standard_normal(electrons.shape, dtype=np.float32)
    noise *= np.sqrt(electrons + np.float32(sensor.read_noise_e**2))
    electrons += noise
    electrons.ravel()[few] = rng.poisson(few_means) + sensor.read_noise_e * rng.standard_normal(len(few_means))
    if transfer is not TransferFunction.LINEAR:  # the numbers of a linear camera stay, to the last bit
        electrons /= np.float32(sensor.full_well_e)
        electrons = encode_light(electrons, transfer)
        electrons *= np.float32(sensor.full_well_e)
    electrons *= np.float32(sensor.gain_dn_per_e)
    # Rounding half up: an offset and a truncation.
    electrons += np.float32(sensor.black_level_dn + 0.5)
    np.maximum(electrons, 0, out=electrons)
    np.minimum(electrons, np.float32(sensor.white_level_dn), out=electrons)
    return electrons.astype(np.uint8 if sensor.bits == 8 else np.uint16)


def _as_electrons(mean_e: ArrayLike) -> Floats:
    electrons = as_floats(mean_e, "mean_e")
    if not ((electrons >= 0) & (electrons <= _MOST_ELECTRONS)).all():
        raise ShapeError("mean_e: a value is negative, above 1e15 or no number; need electrons >= 0")
    return electrons
