# SPDX-License-Identifier: Apache-2.0
"""From the light on a simulated sensor to pixels: colour filters, exposure, noise, converter; its truth file."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from imgu_ros.errors import ParameterError
from imgu_ros.file_access.text_files import write_text
from imgu_ros.simulate.capture import Capture
from imgu_ros.types import Image
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import PixelLayout
from imgu_ros.vision.formation.sensor import Sensor, expose, quantise
from imgu_ros.vision.formation.transfer import TransferFunction, decode_light, encode_light

#: Light on a white surface, as a share of what saturates the sensor, without exposure compensation.
WHITE = 0.9
COLUMNS = (
    "stamp_ns", "exposure", "saturated",
    "sensitivity_r", "sensitivity_g", "sensitivity_b", "transfer", "black_level", "white_level",
)  # fmt: skip

#: What a simulation without a sensor has: 16 bits, no noise to speak of.
_IDEAL_SENSOR = Sensor(16, 1e15, 0.0)
#: Quantiles of the light by which a frame is metered: the share is right to half of one.
_QUANTILES = 1 << 14
#: Least variance of a pixel, squared electrons: one of black without read noise has none.
_LEAST_VARIANCE = 1e-12
#: The exposure is changed by at most this factor.
_LARGEST_CHANGE = 1e6


@dataclass(frozen=True, slots=True)
class ExposureTruth:
    """How bright one frame is.

    Attributes
    ----------
    stamp_ns : the frame's stamp
    exposure : signal of a white surface in a pixel of sensitivity 1, 1 saturates
    saturated : share of the pixel values that are the white level
    """

    stamp_ns: int
    exposure: float
    saturated: float


def take_picture(
    light: Image, layout: PixelLayout, capture: Capture, sensor: Sensor | None, rng: np.random.Generator
) -> tuple[Image, float]:
    """Turn light into pixels through colour filters, metering, noise, transfer function and converter.

    Parameters
    ----------
    light : (H, W) or (H, W, 3) float32, 1 saturates a pixel of sensitivity 1
    layout : what a pixel measures
    capture : sensitivities, transfer function, share to be saturated
    sensor : None: no noise, 16 bits
    rng : source of the noise

    Returns
    -------
    pixels, uint8 for 8 bits, else uint16; and the factor by which metering changed the exposure

    Raises
    ------
    ParameterError
        If no exposure saturates that share.
    """
    if layout.pattern is not None:
        light = filtered_light(light, layout.pattern, capture.sensitivities)
    factor = 1.0
    if capture.saturated is not None:
        factor = saturating_exposure(light, capture.saturated, sensor or _IDEAL_SENSOR, capture.transfer)
    light = light * np.float32(factor)
    if sensor is None:
        return quantise(encode_light(light, capture.transfer).astype(np.float32, copy=False), 16), factor
    return expose(light, sensor, rng, capture.transfer), factor


def filtered_light(light: Image, pattern: BayerPattern, sensitivities: tuple[float, float, float]) -> Image:
    """Return the light of a mosaic, (H, W), times the sensitivity of each site's colour."""
    out = light.copy()
    for index, color in enumerate(pattern.value):
        row, column = divmod(index, 2)
        out[row::2, column::2] *= np.float32(sensitivities["rgb".index(color)])
    return out


def saturating_exposure(light: Image, share: float, sensor: Sensor, transfer: TransferFunction) -> float:
    """Return the factor of the light at which this share of the values is expected at the white level, with noise.

    Raises
    ------
    ParameterError
        If no factor from 1e-6 to 1e6 does that: of a black frame, or when the read noise alone saturates more.
    """
    count = min(light.size, _QUANTILES)
    ranks = ((np.arange(count) + 0.5) * (light.size / count)).astype(np.intp)
    means_e = np.sort(light, axis=None)[ranks].astype(np.float64) * sensor.full_well_e
    # The converter rounds: half a step below full scale is the white level already.
    half_step = 0.5 / (sensor.white_level_dn - sensor.black_level_dn)
    full_e = float(decode_light(1 - half_step, transfer)) * sensor.full_well_e

    def saturated(log_factor: float) -> float:
        electrons = math.exp(log_factor) * means_e
        variance = np.maximum(electrons + sensor.read_noise_e**2, _LEAST_VARIANCE)
        return float(ndtr((electrons - full_e) / np.sqrt(variance)).mean())

    ends = -math.log(_LARGEST_CHANGE), math.log(_LARGEST_CHANGE)
    least, most = (saturated(end) for end in ends)
    if not least < share < most:
        raise ParameterError(f"saturated: {share:g}; need more than {least:.3g} and less than {most:.3g} in this frame")
    return math.exp(float(brentq(lambda log_factor: saturated(log_factor) - share, *ends)))


def saturated_share(pixels: Image, sensor: Sensor | None) -> float:
    """Return the share of the pixel values, of all channels, that are the white level."""
    return float(np.mean(pixels == (sensor or _IDEAL_SENSOR).white_level_dn))


def write_exposures(path: Path, exposures: Iterable[ExposureTruth], capture: Capture, sensor: Sensor | None) -> None:
    """Write `exposure.csv`: a row for each frame, with what is the same in all of them; numbers round-trip.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    sensor = sensor or _IDEAL_SENSOR
    same = [*map(float, capture.sensitivities), capture.transfer, float(sensor.black_level_dn), sensor.white_level_dn]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows([truth.stamp_ns, truth.exposure, truth.saturated, *same] for truth in exposures)
    write_text(path, text.getvalue())
