# SPDX-License-Identifier: Apache-2.0
"""What the light does to a frame, seen from the pipeline's end: bands, thermal pictures, shutter and lens."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from numpy.typing import NDArray

from imgu_ros.config.values import parameters_from
from imgu_ros.errors import ShapeError
from imgu_ros.localizer import Localizer
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.result import Result, Status
from imgu_ros.simulate.capture import Capture
from imgu_ros.simulate.sequence import SimulatedFrame, Simulation, default_targets, simulate_sequence
from imgu_ros.simulate.truth import corner_error
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage
from imgu_ros.vision.formation.sensor import Sensor

Frames = tuple[SimulatedFrame, ...]
FOUND = (Status.DETECTED, Status.TRACKED)
SEQUENCE = Simulation(width=480, height=360, frames=90, seed=3, sensor=Sensor(12))


@pytest.fixture(scope="module")
def color_frames(target_images: tuple[TargetImage, ...]) -> Frames:
    simulation = replace(SEQUENCE, layout=PixelLayout(ColorModel.RGB))
    return tuple(islice(simulate_sequence(simulation, target_images[:1]), 3))


def results_of(frames: Frames, targets: tuple[Reference, ...], values: dict[str, object]) -> list[Result]:
    chain = Localizer(parameters_from(values), targets[:1])
    return [chain.process(f.frame) for f in frames]


def with_pixels(frames: Frames, pixels: list[NDArray[np.generic]], layout: PixelLayout) -> Frames:
    return tuple(
        replace(f, frame=replace(f.frame, image=RawImage(p, layout))) for f, p in zip(frames, pixels, strict=True)
    )


def largest_error(frames: Frames, results: list[Result]) -> float:
    errors = []
    for simulated, result in zip(frames, results, strict=True):
        found = result.first
        assert found.status in FOUND, found.reason
        assert found.homography is not None
        size = result.developed.grey.shape[1::-1]
        errors.append(corner_error(found.homography.H, simulated.truths[0].H, (1280, 960), size))
    return max(errors)


@pytest.mark.parametrize(
    ("values", "limit"),
    [
        ({"raw.bands": [0, 1, 2]}, 0.02),
        ({"raw.band_mode": "weighted", "raw.band_weights": [1.0, 2.0, 1.0, 0.0, 0.0]}, 0.02),
        ({"raw.band_mode": "principal_component"}, 0.02),
        ({"raw.band_mode": "spectral_angle", "raw.bands": [1, 3], "raw.reference_spectrum": [1.0, 0.0]}, 0.03),
    ],
)
def test_every_band_mode_finds_the_target(
    color_frames: Frames, targets: tuple[Reference, ...], values: dict[str, object], limit: float
) -> None:
    # Red, green, blue, and two bands in which the scene is dark where it is bright in green.
    cubes: list[NDArray[np.generic]] = []
    for simulated in color_frames:
        rgb = simulated.frame.image.pixels.astype(np.int64)
        other = 4000 - np.minimum(rgb[:, :, 1:2], 3999)
        cubes.append(np.concatenate((rgb, other, other // 2), axis=2).astype(np.uint16))
    frames = with_pixels(color_frames, cubes, PixelLayout(ColorModel.BANDS))
    assert largest_error(frames, results_of(frames, targets, values)) < limit


def test_spectral_angle_sees_through_uneven_light(color_frames: Frames, targets: tuple[Reference, ...]) -> None:
    # Green and its complement under a light that changes by a factor of 30 from stripe to stripe.
    light = np.where(np.random.default_rng(0).random((1, 120)) < 0.5, 0.5, 15.0).repeat(4, axis=1)
    cubes: list[NDArray[np.generic]] = []
    for simulated in color_frames:
        green = simulated.frame.image.pixels[:, :, 1].astype(np.float32)
        cubes.append((np.stack((green, 4095 - green), axis=2) * light[:, :, None]).astype(np.float32))
    frames = with_pixels(color_frames, cubes, PixelLayout(ColorModel.BANDS))
    by_angle = {"raw.band_mode": "spectral_angle", "raw.reference_spectrum": [1.0, 0.0]}
    assert largest_error(frames, results_of(frames, targets, by_angle)) < 0.03
    assert results_of(frames, targets, {"raw.bands": [0]})[0].first.status not in FOUND


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"raw.bands": [7]}, "raw.bands: 7; need 0 to 2"),
        (
            {"raw.band_mode": "spectral_angle", "raw.reference_spectrum": [1.0, 2.0]},
            "raw.reference_spectrum: 2 values; need 3",
        ),
        ({"raw.band_mode": "weighted", "raw.band_weights": [1.0, 2.0]}, "raw.band_weights: 2 values; need 3"),
    ],
)
def test_frames_that_do_not_fit_the_band_parameters_are_rejected(
    color_frames: Frames, targets: tuple[Reference, ...], values: dict[str, object], reason: str
) -> None:
    cubes: list[NDArray[np.generic]] = [f.frame.image.pixels for f in color_frames]
    frames = with_pixels(color_frames, cubes, PixelLayout(ColorModel.BANDS))
    for result in results_of(frames, targets, values):
        assert result.first.status is Status.REJECTED
        assert result.first.reason.startswith(f"the frame cannot be used ({reason}")


def test_thermal_frames_need_no_levels(target_images: tuple[TargetImage, ...], targets: tuple[Reference, ...]) -> None:
    # mono16 in centikelvin: 3 K of contrast upon 300 K, and pixels that are stuck.
    simulation = replace(SEQUENCE, layout=PixelLayout(ColorModel.MONO))
    frames = tuple(islice(simulate_sequence(simulation, target_images[:1]), 3))
    thermal: list[NDArray[np.generic]] = []
    for simulated in frames:
        kelvin = np.rint(29_850 + simulated.frame.image.pixels * (300 / 4095)).astype(np.uint16)
        kelvin[::90, ::70] = 65535
        thermal.append(kelvin)
    frames = with_pixels(frames, thermal, PixelLayout(ColorModel.MONO))
    assert largest_error(frames, results_of(frames, targets, {})) < 0.02


@pytest.mark.parametrize(
    "capture",
    [Capture(exposure_s=0.01), Capture(defocus_px=2.0), Capture(ev=(-2.0,))],
    ids=["motion", "defocus", "dark"],
)
def test_truth_of_blurred_frames_is_that_of_mid_exposure(
    target_images: tuple[TargetImage, ...], targets: tuple[Reference, ...], capture: Capture
) -> None:
    simulation = replace(SEQUENCE, sensor=Sensor(14), capture=capture)
    frames = tuple(islice(simulate_sequence(simulation, target_images[:1]), 4))
    results = results_of(frames, targets, {"raw.significant_bits": 14})
    assert largest_error(frames, results) < 0.04


def test_a_picture_in_one_colour_alone_is_found_by_its_weights() -> None:
    # Blue and red in balance: everywhere the same grey, to half a level, by the usual weights.
    texture = default_targets(1, seed=11)[0].pixels.mean(axis=2) - 128
    balanced = np.stack((128 - texture * (0.114 / 0.299), np.full_like(texture, 128), 128 + texture), axis=2)
    target = TargetImage("blue", np.clip(np.rint(balanced), 0, 255).astype(np.uint8), 0.5)
    simulation = replace(SEQUENCE, layout=PixelLayout(ColorModel.RGB))
    frames = tuple(islice(simulate_sequence(simulation, [target]), 3))
    blue = {"raw.grey_weights": [0.0, 0.0, 1.0]}
    targets = prepare_references([target], parameters_from(blue))
    assert largest_error(frames, results_of(frames, targets, blue)) < 0.02
    with pytest.raises(ShapeError, match="texture"):
        prepare_references([target], parameters_from({}))
