"""From light to digital numbers: shot noise, read noise, quantisation (notes 1.2; EMVA Standard 1288, section 2)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Image, as_image

#: Bit depths of analogue-to-digital converters that can be simulated.
BIT_DEPTHS = (8, 10, 12, 14, 16)
#: Below this mean a Poisson variable is too skewed to be drawn from a normal distribution.
_FEW_ELECTRONS = 30.0


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
        if self.bits not in BIT_DEPTHS:
            raise ShapeError(f"bits: {self.bits}; need one of {', '.join(map(str, BIT_DEPTHS))}")
        if not (math.isfinite(self.full_well_e) and self.full_well_e > 0):
            raise ShapeError(f"full_well_e: {self.full_well_e:g}; need more than 0 electrons")
        if not (math.isfinite(self.read_noise_e) and self.read_noise_e >= 0):
            raise ShapeError(f"read_noise_e: {self.read_noise_e:g}; need 0 electrons or more")
        if not 0 <= self.black_level_dn < self.white_level_dn:
            raise ShapeError(f"black_level_dn: {self.black_level_dn:g}; need 0 to below {self.white_level_dn}")

    @property
    def white_level_dn(self) -> int:
        """Largest digital number."""
        return (1 << self.bits) - 1

    @property
    def gain_dn_per_e(self) -> float:
        """Digital numbers an electron."""
        return (self.white_level_dn - self.black_level_dn) / self.full_well_e

    def expected_dn(self, mean_e: Floats) -> Floats:
        """Return the digital number that `mean_e` electrons give on average, unclipped."""
        return self.black_level_dn + self.gain_dn_per_e * mean_e

    def variance_dn(self, mean_e: Floats) -> Floats:
        """Return the digital number's variance, unclipped: gain^2 (mean + read^2) + 1/12 (EMVA 1288, equation 15)."""
        return self.gain_dn_per_e**2 * (mean_e + self.read_noise_e**2) + 1 / 12


def expose(light: Image, sensor: Sensor, rng: np.random.Generator) -> Image:
    """Turn light into digital numbers.

    Parameters
    ----------
    light : (H, W) or (H, W, C) float32, 1 saturates the sensor; negative counts as 0
    sensor : its noise and converter
    rng : source of the noise

    Returns
    -------
    same shape, uint8 for 8 bits, else uint16

    Raises
    ------
    ShapeError
        If `light` is not float32.
    """
    light = as_image(light, "light", channels=(1, 3, 4), dtypes=(np.float32,))
    electrons = light * np.float32(sensor.full_well_e)
    np.maximum(electrons, 0, out=electrons)
    few = np.flatnonzero(electrons < _FEW_ELECTRONS)
    few_means = electrons.ravel()[few]
    # Shot and read noise are independent: one normal draw carries both where electrons are many.
    noise = rng.standard_normal(electrons.shape, dtype=np.float32)
    noise *= np.sqrt(electrons + np.float32(sensor.read_noise_e**2))
    electrons += noise
    electrons.ravel()[few] = rng.poisson(few_means) + sensor.read_noise_e * rng.standard_normal(len(few_means))
    electrons *= np.float32(sensor.gain_dn_per_e)
    # Rounding half up: an offset and a truncation.
    electrons += np.float32(sensor.black_level_dn + 0.5)
    np.maximum(electrons, 0, out=electrons)
    np.minimum(electrons, np.float32(sensor.white_level_dn), out=electrons)
    return electrons.astype(np.uint8 if sensor.bits == 8 else np.uint16)
