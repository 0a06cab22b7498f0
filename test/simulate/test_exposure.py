# SPDX-License-Identifier: Apache-2.0
"""Colour filters, metering by saturated pixels and transfer functions of the simulated camera, and their truth."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from imgu_ros.errors import ParameterError
from imgu_ros.reference.templates import TargetImage
from imgu_ros.simulate.capture import Capture
from imgu_ros.simulate.exposure import (
    ExposureTruth,
    filtered_light,
    saturated_share,
    saturating_exposure,
    take_picture,
    write_exposures,
)
from imgu_ros.simulate.path import camera_from_scene_at
from imgu_ros.simulate.render import Renderer
from imgu_ros.simulate.scene import arrange_scene
from imgu_ros.simulate.sequence import Simulation, camera_of, check_simulation, simulate_sequence
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.vision.formation.cfa import BayerPattern, site_mask
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout
from imgu_ros.vision.formation.sensor import BIT_DEPTHS, Sensor, expose
from imgu_ros.vision.formation.transfer import TransferFunction, decode_light

PATTERNS, FUNCTIONS = list(BayerPattern), list(TransferFunction)
SMALL = Simulation(width=160, height=120, frames=3, seed=2)
TARGETS = (TargetImage("poster", procedural_texture(160, 120), 0.25),)
#: 1e12 electrons: a relative noise of 1e-6.
QUIET = Sensor(16, full_well_e=1e12, read_noise_e=0)


def pixels(simulation: Simulation) -> list[np.ndarray]:
    return [simulated.frame.image.pixels for simulated in simulate_sequence(simulation, TARGETS)]


@pytest.mark.parametrize("layout", [PixelLayout(ColorModel.BAYER, p) for p in PATTERNS] + [PixelLayout(ColorModel.RGB)])
@pytest.mark.parametrize("sensor", [Sensor(), Sensor(12, 5_000, 3, 64)])
def test_defaults_give_the_frames_of_light_and_sensor_alone(layout: PixelLayout, sensor: Sensor) -> None:
    simulation = replace(SMALL, layout=layout, sensor=sensor)
    scene, camera = arrange_scene(TARGETS, 2), camera_of(simulation)
    renderer = Renderer(scene, camera, layout)
    for index, frame in enumerate(pixels(simulation)):
        pose = camera_from_scene_at(index / 2, simulation.motion, camera, scene.radius_m, 2)
        rng = np.random.default_rng([2, index, 0x5E45])
        np.testing.assert_array_equal(frame, expose(renderer.radiance(pose) * np.float32(0.9), sensor, rng))


@given(
    sensitivities=st.tuples(*[st.floats(0.01, 1.0)] * 3),
    pattern=st.sampled_from(PATTERNS),
    seed=st.integers(0, 2**32),
)
def test_each_colour_is_multiplied_by_its_sensitivity(
    sensitivities: tuple[float, float, float], pattern: BayerPattern, seed: int
) -> None:
    light = np.random.default_rng(seed).random((6, 8), dtype=np.float32)
    before = light.copy()
    filtered = filtered_light(light, pattern, sensitivities)
    for color, sensitivity in zip("rgb", sensitivities, strict=True):
        sites = site_mask(light.shape, pattern, color)
        np.testing.assert_array_equal(filtered[sites], light[sites] * np.float32(sensitivity))
    np.testing.assert_array_equal(light, before)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_means_of_the_channels_are_in_the_ratio_of_the_sensitivities(pattern: BayerPattern) -> None:
    sensitivities = (0.5, 1.0, 0.65)
    plain = replace(SMALL, layout=PixelLayout(ColorModel.BAYER, pattern), sensor=Sensor(16, 1e6, 0, 1000))
    balanced, raw = pixels(plain), pixels(replace(plain, capture=Capture(sensitivities=sensitivities)))
    for even, uneven in zip(balanced, raw, strict=True):
        for color, sensitivity in zip("rgb", sensitivities, strict=True):
            sites = site_mask(even.shape, pattern, color)
            means = [frame[sites].astype(np.float64).mean() - 1000 for frame in (even, uneven)]
            assert means[1] / means[0] == pytest.approx(sensitivity, rel=2e-4)


@pytest.mark.parametrize("transfer", FUNCTIONS)
@pytest.mark.parametrize("sensor", [QUIET, None])
def test_inverse_of_the_transfer_function_recovers_the_linear_frames(
    transfer: TransferFunction, sensor: Sensor | None
) -> None:
    linear = pixels(replace(SMALL, sensor=sensor))
    encoded = pixels(replace(SMALL, sensor=sensor, capture=Capture(transfer=transfer)))
    for straight, curved in zip(linear, encoded, strict=True):
        # Film is the flattest at full scale: a step there is 5 steps of light.
        difference = 65535 * decode_light(curved / 65535, transfer) - straight.astype(np.float64)
        assert np.abs(difference).max() < 4


@settings(max_examples=60, deadline=None)
@given(
    share=st.floats(0.002, 0.95),
    bits=st.sampled_from(BIT_DEPTHS),
    black=st.integers(0, 60),
    full_well=st.floats(200.0, 1e6),
    gamma=st.floats(0.5, 3.0),
    transfer=st.sampled_from(FUNCTIONS),
    seed=st.integers(0, 2**32),
)
# The darkest pixels are saturated only at 8000 times the light.
@example(0.95, 12, 60, 1e6, 2.9, TransferFunction.LINEAR, 1)
def test_the_share_of_the_pixels_is_saturated(
    share: float, bits: int, black: int, full_well: float, gamma: float, transfer: TransferFunction, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    light = (rng.random((200, 300)) ** gamma).astype(np.float32)
    sensor = Sensor(bits, full_well, 4.0, black)
    layout = PixelLayout(ColorModel.MONO)
    taken, factor = take_picture(light, layout, Capture(saturated=share, transfer=transfer), sensor, rng)
    # 60 000 independent pixels: five standard deviations of a count, and 0.001 of the normal approximation.
    spread = 5 * np.sqrt(share * (1 - share) / light.size) + 0.001
    assert saturated_share(taken, sensor) == pytest.approx(share, abs=spread)
    assert factor == saturating_exposure(light, share, sensor, transfer)


@pytest.mark.parametrize("share", [0.02, 0.1, 0.5])
@pytest.mark.parametrize("encoding", ["bayer", "rgb"])
@pytest.mark.parametrize("sensor", [Sensor(), Sensor(12, black_level_dn=200), None], ids=str)
def test_every_frame_of_a_sequence_has_the_share(share: float, encoding: str, sensor: Sensor | None) -> None:
    layout = SMALL.layout if encoding == "bayer" else PixelLayout(ColorModel.RGB)
    simulation = replace(SMALL, layout=layout, sensor=sensor, capture=Capture(saturated=share))
    white = 65535 if sensor is None else sensor.white_level_dn
    exposures = set()
    for simulated in simulate_sequence(simulation, TARGETS):
        assert np.mean(simulated.frame.image.pixels == white) == pytest.approx(share, abs=0.004)
        exposures.add(simulated.exposure)
    assert len(exposures) == 2 and max(exposures) < 20  # the path ends where it begins


def test_exposure_is_the_signal_of_white() -> None:
    # The target is white: what an ideal camera gives for it is the exposure of the truth, below saturation.
    white = (TargetImage("white", np.full((90, 120, 3), 255, np.uint8), 0.5),)
    for capture in (Capture(), Capture(ev=(-1.5,))):
        for simulated in simulate_sequence(replace(SMALL, sensor=None, capture=capture), white):
            assert simulated.frame.image.pixels.max() / 65535 == pytest.approx(simulated.exposure, abs=1e-3)
    metered = next(simulate_sequence(replace(SMALL, sensor=None, capture=Capture(saturated=0.02)), white))
    plain = next(simulate_sequence(replace(SMALL, sensor=None), white))
    wall = metered.frame.image.pixels[:8].astype(float), plain.frame.image.pixels[:8].astype(float)
    assert wall[0].mean() / wall[1].mean() == pytest.approx(metered.exposure / plain.exposure, rel=1e-3)


@pytest.mark.parametrize(
    ("light", "sensor", "message"),
    [
        (0.0, Sensor(), "saturated: 0.02; need more than 0 and less than 0 in this frame"),
        (0.5, Sensor(8, full_well_e=10, read_noise_e=100), "need more than 0.46"),
    ],
)
def test_a_share_that_no_exposure_gives_is_refused(light: float, sensor: Sensor, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        saturating_exposure(np.full((20, 30), light, np.float32), 0.02, sensor, TransferFunction.LINEAR)


@pytest.mark.parametrize(
    ("capture", "message"),
    [
        (Capture(saturated=0.0), "saturated: 0; need more than 0, up to 0.99"),
        (Capture(saturated=float("nan")), "saturated: nan"),
        (Capture(saturated=0.02, ev=(0.0, -1.0)), "saturated: 0.02 with ev .0.0, -1.0.; need one or the other"),
        (Capture(sensitivities=(0.5, 1.0, 0.0)), "sensitivities: 0.5, 1, 0; need 3 numbers"),
        (Capture(sensitivities=(0.5, 1.0)), "sensitivities: 0.5, 1; need 3 numbers"),  # type: ignore[arg-type]
        (Capture(sensitivities=(1.0, 2.0, 1.0)), "from 0.01 to 1"),
    ],
)
def test_impossible_captures_are_refused(capture: Capture, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        check_simulation(replace(SMALL, capture=capture))


def test_sensitivities_need_colour_filters() -> None:
    capture = Capture(sensitivities=(0.5, 1.0, 0.65))
    with pytest.raises(ParameterError, match="sensitivities: 0.5, 1, 0.65 of mono pixels; need a Bayer pattern"):
        check_simulation(replace(SMALL, layout=PixelLayout(ColorModel.MONO), capture=capture))


def test_truth_file_tells_how_bright_every_frame_was(tmp_path: Path) -> None:
    exposures = [ExposureTruth(7, 0.9, 0.0), ExposureTruth(11, 1 / 3, 0.02)]
    capture = Capture(sensitivities=(0.5, 1.0, 0.65), transfer=TransferFunction.FILM)
    write_exposures(tmp_path / "exposure.csv", exposures, capture, Sensor(10, black_level_dn=64))
    with (tmp_path / "exposure.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(int(r["stamp_ns"]), float(r["exposure"]), float(r["saturated"])) for r in rows] == [
        (7, 0.9, 0.0),
        (11, 1 / 3, 0.02),
    ]
    for row in rows:
        assert [float(row[f"sensitivity_{c}"]) for c in "rgb"] == [0.5, 1.0, 0.65]
        assert row["transfer"] == "film"
        assert (float(row["black_level"]), float(row["white_level"])) == (64, 1023)
