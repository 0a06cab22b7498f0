# SPDX-License-Identifier: Apache-2.0
"""Valid calls of optics, shutter, sensor, levels and bands; see test/vision/test_hostile.py."""

from __future__ import annotations

import numpy as np

from imgu_ros.vision.formation.bands import grey_from_bands, mean_of_bands, principal_component, spectral_angle
from imgu_ros.vision.formation.levels import stretched_to_8_bit, with_levels
from imgu_ros.vision.formation.optics import (
    ThinLens,
    circle_of_confusion,
    depth_of_field,
    disc_kernel,
    hyperfocal_distance,
)
from imgu_ros.vision.formation.pixel_array import PixelArray
from imgu_ros.vision.formation.sensor import Sensor, expose, quantise
from imgu_ros.vision.formation.shutter import Exposure, motion_kernel, rolling_shutter_points, row_times
from imgu_ros.vision.formation.transfer import (
    decode_light,
    encode_light,
    light_of_srgb,
    linear_from_srgb,
    srgb_from_linear,
)

LENS = ThinLens(0.05, 2.0, 2.0)


def sensor_of(full_well_e: float, read_noise_e: float, black_level_dn: float) -> Sensor:
    return Sensor(12, full_well_e, read_noise_e, black_level_dn)


def exposed(light: np.ndarray) -> np.ndarray:
    # A generator made here: the same noise for the same light.
    return expose(light, Sensor(12), np.random.default_rng(0))


def exposed_film(light: np.ndarray) -> np.ndarray:
    return expose(light, Sensor(12, black_level_dn=64), np.random.default_rng(0), "film")


CALLS = {
    # optics
    circle_of_confusion: lambda rng: {"lens": LENS, "depth_m": rng.uniform(0.5, 9, (4, 3))},
    depth_of_field: lambda rng: {"lens": LENS, "circle_m": 30e-6},
    hyperfocal_distance: lambda rng: {"focal_length_m": 0.05, "f_number": 8.0, "circle_m": 30e-6},
    disc_kernel: lambda rng: {"diameter_px": 3.3},
    # shutter
    Exposure: lambda rng: {"time_s": 0.01, "f_number": 8.0, "iso": 100.0},
    motion_kernel: lambda rng: {"velocity_px_s": rng.uniform(-300, 300, 2), "time_s": 0.01},
    row_times: lambda rng: {"height": 480, "row_time_s": 2e-5},
    rolling_shutter_points: lambda rng: {
        "points": rng.uniform(0, 99, (5, 2)),
        "velocity_px_s": rng.uniform(-99, 99, (5, 2)),
        "row_time_s": 1e-4,
        "height": 100,
    },
    # sensor
    PixelArray: lambda rng: {"width": 640, "height": 480, "pitch_m": 3e-6},
    PixelArray.focal_px: lambda rng: {"self": PixelArray(640, 480, 3e-6), "image_distance_m": 0.004},
    sensor_of: lambda rng: {"full_well_e": 1e4, "read_noise_e": 4.0, "black_level_dn": 10.0},
    Sensor.amplified: lambda rng: {"self": Sensor(12), "gain": 2.0},
    Sensor.expected_dn: lambda rng: {"self": Sensor(12), "mean_e": rng.uniform(0, 9000, (3, 4))},
    Sensor.variance_dn: lambda rng: {"self": Sensor(12), "mean_e": rng.uniform(0, 9000, (3, 4))},
    expose: lambda rng: {
        "light": rng.random((6, 8), dtype=np.float32),
        "sensor": Sensor(12),
        "rng": np.random.default_rng(0),
    },
    exposed_film: lambda rng: {"light": rng.random((6, 8), dtype=np.float32)},
    exposed: lambda rng: {"light": rng.random((6, 8), dtype=np.float32)},
    quantise: lambda rng: {"signal": rng.random((6, 8), dtype=np.float32), "bits": 12},
    # levels
    with_levels: lambda rng: {
        "raw": rng.integers(0, 65536, (6, 8), np.uint16),
        "pattern": "rggb",
        "black": 600.0,
        "white": 15520.0,
        "gains": (1.9, 1.0, 1.3),
    },
    encode_light: lambda rng: {"light": rng.random((6, 8)), "transfer": "film"},
    decode_light: lambda rng: {"values": rng.random((6, 8)), "transfer": "srgb"},
    light_of_srgb: lambda rng: {},
    linear_from_srgb: lambda rng: {"image": rng.integers(0, 256, (6, 8, 3)).astype(np.uint8)},
    srgb_from_linear: lambda rng: {"image": rng.integers(0, 256, (6, 8)).astype(np.uint8)},
    stretched_to_8_bit: lambda rng: {
        "grey": rng.uniform(290, 310, (6, 8)).astype(np.float32),
        "black": 0.0,
        "white": None,
    },
    # bands
    grey_from_bands: lambda rng: {
        "cube": rng.integers(0, 4096, (4, 5, 6), np.uint16),
        "mode": "spectral_angle",
        "bands": (0, 2, 5),
        "weights": np.zeros(3),
        "reference": rng.uniform(0.1, 1, 3),
    },
    mean_of_bands: lambda rng: {
        "cube": rng.uniform(0, 9, (4, 5, 6)).astype(np.float32),
        "weights": rng.uniform(0.1, 1, 6),
    },
    principal_component: lambda rng: {"cube": rng.uniform(0, 9, (4, 5, 6)).astype(np.float32)},
    spectral_angle: lambda rng: {
        "cube": rng.uniform(0, 9, (4, 5, 6)).astype(np.float32),
        "reference": rng.uniform(0.1, 1, 6),
    },
}

#: In focus at infinity.
INFINITE = {depth_of_field}
