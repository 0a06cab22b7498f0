# SPDX-License-Identifier: Apache-2.0
"""Each disturbance against what it claims."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import ShapeError
from imgu_ros.simulate.disturbances import (
    TargetField,
    as_mosaic,
    cover_texture,
    covered,
    defocused,
    electrons_for_snr,
    flicker,
    highlighted,
    motion_blurred,
    vignetting,
)
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.sensor import Sensor, expose

TEMPLATE = (400, 300)
SIZE = (640, 480)
#: The template seen at three fourths of its size, turned by 30 degrees, with a little perspective.
H = np.array([[0.65, -0.375, 250], [0.375, 0.65, 60], [1e-4, -5e-5, 1.0]])


def target_pixels() -> tuple[np.ndarray, np.ndarray]:
    """Image pixels on the target, and the template area that each of them shows."""
    y, x = np.mgrid[: SIZE[1], : SIZE[0]].astype(float)
    back = np.linalg.inv(H)
    w = back[2, 0] * x + back[2, 1] * y + back[2, 2]
    u = (back[0, 0] * x + back[0, 1] * y + back[0, 2]) / w
    v = (back[1, 0] * x + back[1, 1] * y + back[1, 2]) / w
    inside = (u > -0.5) & (u < TEMPLATE[0] - 0.5) & (v > -0.5) & (v < TEMPLATE[1] - 0.5)
    return inside, abs(np.linalg.det(back)) / np.abs(w) ** 3


@pytest.mark.parametrize("share", [0.2, 0.4, 0.6])
@pytest.mark.parametrize("phase", [0.0, 1.0, 4.0])
def test_cover_hides_the_share_of_the_target(share: float, phase: float) -> None:
    field = TargetField(TEMPLATE, seed=3)
    in_image = field.in_image(field.above(share, phase), H, SIZE)
    hidden = covered(np.zeros(SIZE[::-1], np.float32), in_image, np.ones(SIZE[::-1], np.float32))
    inside, area = target_pixels()
    assert (hidden * area)[inside].sum() / area[inside].sum() == pytest.approx(share, abs=0.01)
    # Opaque but for its rim.
    assert ((hidden > 0.01) & (hidden < 0.99)).mean() < 0.02


def test_cover_goes_on_beyond_the_target_and_ends() -> None:
    field = TargetField(TEMPLATE, seed=3)
    in_image = field.in_image(field.above(0.5, 0.3), H, SIZE)
    inside, _ = target_pixels()
    assert (in_image[~inside] > 0).any()
    far = field.in_image(field.above(0.9, 0.3), np.diag([0.2, 0.2, 1.0]) @ H, SIZE)
    assert (far[:, 400:] < 0).all() and (far[300:] < 0).all()


def test_cover_moves_smoothly() -> None:
    field = TargetField(TEMPLATE, seed=3)
    a, b, c = (field.above(0.4, phase) > 0 for phase in (1.0, 1.05, 2.5))
    assert 0 < (a != b).mean() < 0.05 < (a != c).mean()
    with pytest.raises(ShapeError, match="share: 1"):
        field.above(1.0, 0.0)


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_highlights_saturate_the_share(share: float) -> None:
    field = TargetField(TEMPLATE, seed=5)
    light = np.full(SIZE[::-1], 0.02, np.float32)
    lit = highlighted(light, field.in_image(field.above(share, 0.5), H, SIZE))
    inside, area = target_pixels()
    assert ((lit >= 1) * area)[inside].sum() / area[inside].sum() == pytest.approx(share, abs=0.02)
    assert (lit >= light).all() and np.isfinite(lit).all()
    color = highlighted(np.repeat(light[:, :, None], 3, 2), field.in_image(field.above(share, 0.5), H, SIZE))
    np.testing.assert_array_equal(color[:, :, 1], lit)


@given(length=st.floats(2, 15), angle=st.floats(0, math.pi))
def test_motion_blur_has_length_direction_and_no_shift(length: float, angle: float) -> None:
    point = np.zeros((41, 41, 3), np.float32)
    point[20, 20] = 1
    line = motion_blurred(point, length, angle)[:, :, 1].astype(float)
    y, x = np.mgrid[:41, :41] - 20.0
    assert line.sum() == pytest.approx(1, abs=1e-5)
    assert abs((line * x).sum()) < 1e-5 and abs((line * y).sum()) < 1e-5
    along = x * math.cos(angle) + y * math.sin(angle)
    across = y * math.cos(angle) - x * math.sin(angle)
    # Variance of a line of this length; linear interpolation adds up to a quarter of a pixel, nearly as much across.
    assert (line * along**2).sum() == pytest.approx(length**2 / 12, abs=0.26)
    assert (line * across**2).sum() < 0.26


@pytest.mark.parametrize("diameter", [4.0, 8.0])
def test_defocus_makes_a_disc(diameter: float) -> None:
    point = np.zeros((31, 31, 3), np.float32)
    point[15, 15] = 1
    disc = defocused(point, diameter)[:, :, 0].astype(float)
    y, x = np.mgrid[:31, :31] - 15.0
    assert disc.sum() == pytest.approx(1, abs=1e-5)
    # A disc's variance, of both axes: d^2 / 8; a pixel's, 1/6, adds.
    assert (disc * (x**2 + y**2)).sum() == pytest.approx(diameter**2 / 8 + 1 / 6, abs=0.1)
    assert disc[np.hypot(x, y) > diameter / 2 + 0.75].sum() == 0


def test_vignetting_takes_from_the_corners() -> None:
    shade = vignetting((65, 41), 0.7)
    assert shade.shape == (41, 65)
    assert shade[20, 32] == 1
    corners = shade[::40, ::64]
    np.testing.assert_allclose(corners, 0.3, atol=1e-6)
    np.testing.assert_allclose(shade, shade[::-1, ::-1], atol=1e-6)


@given(phase=st.floats(0, 100))
def test_flicker_waves_over_the_rows(phase: float) -> None:
    waves = flicker(480, 0.3, phase, periods=2)
    assert waves.shape == (480, 1)
    assert waves.mean() == pytest.approx(1, abs=1e-4)
    assert waves.max() == pytest.approx(1.3, abs=1e-3) and waves.min() == pytest.approx(0.7, abs=1e-3)
    np.testing.assert_allclose(waves[:240], waves[240:], atol=1e-5)


@pytest.mark.parametrize(("snr", "read"), [(10.0, 4.0), (3.0, 10.0), (40.0, 0.0)])
def test_electrons_give_the_ratio_of_signal_to_noise(snr: float, read: float) -> None:
    mean = electrons_for_snr(snr, read)
    sensor = Sensor(bits=16, full_well_e=4 * mean, read_noise_e=read)
    pixels = expose(np.full((300, 300), 0.25, np.float32), sensor, np.random.default_rng(0)).astype(float)
    if snr > 5:  # below, zero cuts the noise off
        assert pixels.mean() / pixels.std() == pytest.approx(snr, rel=0.02)
    assert mean / math.sqrt(mean + read**2) == pytest.approx(snr)


def test_mosaic_of_light() -> None:
    light = np.arange(48, dtype=np.float32).reshape(4, 4, 3)
    raw = as_mosaic(light, BayerPattern.RGGB)
    assert (raw[0, 0], raw[0, 1], raw[1, 0], raw[1, 1]) == (
        light[0, 0, 0],
        light[0, 1, 1],
        light[1, 0, 1],
        light[1, 1, 2],
    )
    assert as_mosaic(raw, BayerPattern.RGGB) is raw


def test_cover_texture_is_linear_and_turns() -> None:
    picture = procedural_texture(200, 150, 1)
    straight, turned = (cover_texture(picture, (320, 240), a) for a in (0.0, math.pi))
    assert straight.shape == (240, 320, 3) and straight.dtype == np.float32
    assert straight.min() >= 0 and straight.max() <= 1
    middle = straight[45:195, 60:260]
    np.testing.assert_allclose(middle, (picture / 255.0) ** 2.2, atol=1e-3)
    np.testing.assert_allclose(cv2.rotate(turned, cv2.ROTATE_180)[45:193, 60:258], straight[46:194, 61:259], atol=0.02)
