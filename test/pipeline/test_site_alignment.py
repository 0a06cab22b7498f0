# SPDX-License-Identifier: Apache-2.0
"""Homographies by raw samples, of frames that a renderer of this file integrates over the area of every site.

The frames share nothing with the package: each site is the mean of 6 x 6 bilinear samples of the picture at the true
homography, seen through the channel of its filter, with a gain, a black level, shot and read noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from imgu_ros.errors import EstimationError, NoConsensus
from imgu_ros.image.raw_samples import Lens, LightLevel, Mosaic, RowScan, light_levels
from imgu_ros.track.patch_equations import SitesFit, noise_of
from imgu_ros.track.site_alignment import SiteAlignment

WIDTH, HEIGHT = 320, 240
STEPS = 6
PICTURE = (960, 720)
CORNERS = np.array([[-0.5, -0.5], [959.5, -0.5], [959.5, 719.5], [-0.5, 719.5]])
BLACK, WHITE = 256.0, 4095.0
#: Photons of a bright site, and the read noise in photons.
FULL, READ = 9000.0, 4.0
PATTERNS = {"rggb": (0, 1, 1, 2), "bggr": (2, 1, 1, 0), "grbg": (1, 0, 2, 1), "gbrg": (1, 2, 0, 1)}
ONE = (0, 0, 0, 0)
Coordinates = Callable[[NDArray[np.float64], NDArray[np.float64]], tuple[NDArray[np.float64], NDArray[np.float64]]]


# --- pictures and frames


def shapes(rng: np.random.Generator) -> NDArray[np.float32]:
    image = np.full((PICTURE[1], PICTURE[0], 3), 0.5, np.float32)
    for _ in range(150):
        points = rng.uniform(0, PICTURE) + rng.normal(0, 60, (4, 2))
        cv2.fillPoly(image, [np.rint(points).astype(np.int32)], rng.uniform(0.05, 0.9, 3).tolist(), cv2.LINE_8)
    return cv2.GaussianBlur(image, None, 1.0)


def page(rng: np.random.Generator) -> NDArray[np.float32]:
    image = np.full((PICTURE[1], PICTURE[0], 3), 217, np.uint8)
    for y in range(40, PICTURE[1], 42):
        words = "".join(chr(each) for each in rng.integers(65, 91, 40))
        cv2.putText(image, words, (8, y), cv2.FONT_HERSHEY_SIMPLEX, 1.2, (15, 13, 20), 3)
    return cv2.GaussianBlur(image.astype(np.float32) / 255, None, 1.0)


def photograph(rng: np.random.Generator) -> NDArray[np.float32]:
    image = np.zeros((PICTURE[1], PICTURE[0], 3), np.float32)
    for sigma in (2, 4, 8, 16, 32, 64):  # every octave as strong
        noise = cv2.GaussianBlur(rng.normal(size=image.shape).astype(np.float32), None, sigma)
        image += noise / noise.std()
    return np.clip(0.45 + 0.16 * image / image.std(), 0.02, 0.95).astype(np.float32)


TEXTURES = {"shapes": shapes, "page": page, "photograph": photograph}


@cache
def picture(name: str) -> NDArray[np.float32]:
    """Return a picture in linear light, (720, 960, 3), 0 to 1."""
    return TEXTURES[name](np.random.default_rng(4))


@cache
def levels(name: str, channels: int = 3) -> tuple[LightLevel, ...]:
    light = picture(name)
    return light_levels(light if channels == 3 else light.mean(axis=2))


@cache
def centres(name: str) -> NDArray[np.float64]:
    """Return up to 64 corners of a picture, px, with room for their patches."""
    grey = cv2.GaussianBlur(picture(name).mean(axis=2), None, 3)
    inner = np.zeros(grey.shape, np.uint8)
    inner[24:-24, 24:-24] = 1
    found = cv2.goodFeaturesToTrack(grey, 64, 0.001, 40, mask=inner, blockSize=15)
    return np.asarray(found, np.float64).reshape(-1, 2)


def homography(rng: np.random.Generator, width: float = 270.0) -> NDArray[np.float64]:
    """Return a random view of the picture, some `width` px wide in the frame."""
    middle, side = np.array([WIDTH, HEIGHT]) / 2, np.array([width, 0.75 * width])
    corners = middle + (np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2 + rng.uniform(-0.04, 0.04, (4, 2))) * side
    H, _ = cv2.findHomography(CORNERS, corners, 0)
    return np.asarray(H, np.float64)


def mapped(H: NDArray[np.float64], xy: NDArray[np.float64]) -> NDArray[np.float64]:
    at = xy @ H[:, :2].T + H[:, 2]
    return at[:, :2] / at[:, 2:]


def off(H: NDArray[np.float64], truth: NDArray[np.float64]) -> float:
    """Return the mean distance of the corners, px."""
    return float(np.hypot(*(mapped(H, CORNERS) - mapped(truth, CORNERS)).T).mean())


def light_of_sites(
    light: NDArray[np.float32], H: NDArray[np.float64], ideal: Coordinates | None = None, blur_px: float = 0.0
) -> NDArray[np.float64]:
    """Return the light that each site's area gets in every channel, (240, 320, C).

    Parameters
    ----------
    light : the picture
    H : H_frame_picture
    ideal : the place in the frame, px, that a place of the sensor shows; None: the same
    blur_px : standard deviation of a point spread
    """
    S = np.array([[STEPS, 0, (STEPS - 1) / 2], [0, STEPS, (STEPS - 1) / 2], [0, 0, 1]])
    size = WIDTH * STEPS, HEIGHT * STEPS
    if ideal is None:
        fine = cv2.warpPerspective(light, S @ H, size, flags=cv2.INTER_LINEAR, borderValue=(0.3, 0.3, 0.3))
    else:
        x, y = np.meshgrid(*((np.arange(n) - (STEPS - 1) / 2) / STEPS for n in size))
        x, y = ideal(x, y)
        (a, b, c), (d, e, f), (g, h, i) = np.linalg.inv(H)
        w = g * x + h * y + i
        u, v = ((a * x + b * y + c) / w).astype(np.float32), ((d * x + e * y + f) / w).astype(np.float32)
        fine = cv2.remap(light, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(0.3, 0.3, 0.3))
    if blur_px:
        fine = cv2.GaussianBlur(fine, None, blur_px * STEPS)
    return cv2.resize(fine, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA).astype(np.float64)


@dataclass(frozen=True, eq=False)
class Exposure:
    """How light becomes raw values: gains of red, green and blue, exposure, and the noise's seed; None: no noise."""

    gains: tuple[float, ...] = (0.6, 1.0, 0.75)
    exposure: float = 0.9
    seed: int | None = 0


def mosaic_of(light: NDArray[np.float64], channels: tuple[int, int, int, int], how: Exposure = Exposure()) -> Mosaic:
    """Return the raw values of 12 bits that a sensor makes of light."""
    if channels == ONE:
        share = light.mean(axis=2)
    else:
        share = np.empty(light.shape[:2])
        for k, channel in enumerate(channels):
            share[k // 2 :: 2, k % 2 :: 2] = light[k // 2 :: 2, k % 2 :: 2, channel] * how.gains[channel]
    share = share * how.exposure
    if how.seed is not None:
        rng = np.random.default_rng(how.seed)
        share = (rng.poisson(share * FULL) + rng.normal(0, READ, share.shape)) / FULL
    values = np.clip(np.rint(BLACK + share * (WHITE - BLACK)), 0, WHITE).astype(np.uint16)
    return Mosaic(values, channels, BLACK, WHITE)


def start_of(H: NDArray[np.float64], rng: np.random.Generator, px: float = 0.1) -> NDArray[np.float64]:
    """Return a homography whose corners are off by so much each."""
    angle = rng.uniform(0, 2 * np.pi, 4)
    moved = mapped(H, CORNERS) + px * np.stack((np.cos(angle), np.sin(angle)), axis=1)
    return np.asarray(cv2.findHomography(CORNERS, moved, 0)[0], np.float64)


@dataclass(frozen=True, eq=False)
class View:
    """A frame of a picture, the truth and a start 0.1 px off."""

    name: str
    mosaic: Mosaic
    H: NDArray[np.float64]
    start: NDArray[np.float64]

    def fit(self, mosaic: Mosaic | None = None, lens: Lens | None = None, scan: RowScan | None = None) -> SitesFit:
        mosaic = self.mosaic if mosaic is None else mosaic
        light = levels(self.name, 1 if mosaic.channels == ONE else 3)
        return SiteAlignment(mosaic, light, self.start, centres(self.name), lens, scan).fit()


def view(
    name: str,
    seed: int = 0,
    channels: tuple[int, int, int, int] = PATTERNS["rggb"],
    how: Exposure | None = None,
    ideal: Coordinates | None = None,
    blur_px: float = 0.0,
) -> View:
    rng = np.random.default_rng([seed, 17])
    H = homography(rng)
    light = light_of_sites(picture(name), H, ideal, blur_px)
    return View(name, mosaic_of(light, channels, how or Exposure(seed=seed)), H, start_of(H, rng))


# --- accuracy


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("name", TEXTURES)
def test_corners_are_found_in_every_pattern(name: str, pattern: str) -> None:
    v = view(name, 1, PATTERNS[pattern])
    fit = v.fit()
    assert off(v.start, v.H) == pytest.approx(0.1, abs=1e-3)
    assert off(fit.H, v.H) < 0.03
    assert np.count_nonzero(fit.kept) > 0.8 * len(fit.kept)


@pytest.mark.parametrize("name", TEXTURES)
def test_corners_are_found_by_one_channel(name: str) -> None:
    v = view(name, 2, ONE)
    assert off(v.fit().H, v.H) < 0.03


@pytest.mark.parametrize("name", TEXTURES)
def test_blur_of_a_pixel_is_followed(name: str) -> None:
    v = view(name, 3, blur_px=1.0)
    fit = v.fit()
    assert off(fit.H, v.H) < 0.08
    # The point spread that was simulated has a variance of 1 along x and y; most of it is seen, and that it is round.
    xx, xy, yy = fit.spread
    assert 0.6 < xx < 1.1 and 0.6 < yy < 1.1 and abs(xx - yy) < 0.1 and abs(xy) < 0.06


def test_a_sharp_frame_has_no_spread() -> None:
    np.testing.assert_allclose(view("shapes", 3).fit().spread, 0.0, atol=0.06)


def nees(fit: SitesFit, H: NDArray[np.float64]) -> float:
    """Return the squared error of a fit in units of its covariance: 8 on average where that is right."""
    M = fit.T @ H @ np.linalg.inv(fit.H) @ np.linalg.inv(fit.T)
    p = (np.eye(3) - M / M[2, 2]).ravel()[:8]
    return float(p @ np.linalg.solve(fit.covariance + fit.doubted, p))


def test_covariance_is_that_of_the_errors() -> None:
    found = [nees(v.fit(), v.H) for v in (view(name, seed) for name in TEXTURES for seed in range(10, 20))]
    assert 3 < np.mean(found) < 14
    # Of chi-squared with 8 degrees of freedom, 99.99 % lie below 31.8.
    assert np.quantile(found, 0.9) < 32


# --- what does not matter


@cache
def quiet() -> tuple[View, NDArray[np.float64], NDArray[np.float64]]:
    """A frame without noise, its light, and the homography that is found."""
    v = view("shapes", 5, how=Exposure(seed=None))
    return v, light_of_sites(picture("shapes"), v.H), v.fit().H


@given(gain=st.floats(0.4, 1.05), black=st.floats(0, 1000))
def test_gain_and_black_level_do_not_move_it(gain: float, black: float) -> None:
    v, _, H = quiet()
    values = np.rint((v.mosaic.values - BLACK) * gain + black).clip(0).astype(np.uint16)
    white = (WHITE - BLACK) + black
    assert off(v.fit(Mosaic(values, v.mosaic.channels, black, white)).H, H) < 0.01
    # Nor does a black level that is a little wrong.
    assert off(v.fit(replace(v.mosaic, black=BLACK + 60 * (gain - 0.7))).H, H) < 0.01


@given(red=st.floats(0.35, 1.1), blue=st.floats(0.35, 1.1))
def test_white_balance_does_not_move_it(red: float, blue: float) -> None:
    v, light, H = quiet()
    other = mosaic_of(light, v.mosaic.channels, Exposure((red, 0.8, blue), seed=None))
    assert off(v.fit(other).H, H) < 0.01


@given(along=st.floats(-0.3, 0.3), across=st.floats(-0.3, 0.3))
def test_shading_does_not_move_it(along: float, across: float) -> None:
    v, light, H = quiet()
    y, x = np.mgrid[-1 : 1 : HEIGHT * 1j, -1 : 1 : WIDTH * 1j]
    shaded = light * (0.7 * (1 + along * x + across * y))[:, :, None]
    assert off(v.fit(mosaic_of(shaded, v.mosaic.channels, Exposure(seed=None))).H, H) < 0.01


# --- what is left out


def test_saturated_sites_are_left_out() -> None:
    v = view("shapes", 6, how=Exposure((1.0, 1.0, 1.0), 1.5, 6))
    clipped = v.mosaic.values >= WHITE
    assert 0.05 < clipped.mean() < 0.6
    fit = v.fit()
    assert off(fit.H, v.H) < 0.03
    # What they say is of no consequence at all.
    wild = np.where(clipped, np.random.default_rng(0).integers(4095, 65535, clipped.shape), v.mosaic.values)
    np.testing.assert_array_equal(v.fit(replace(v.mosaic, values=wild.astype(np.uint16))).H, fit.H)


def test_an_occluded_patch_is_not_kept() -> None:
    v = view("shapes", 7)
    before = v.fit()
    which = int(np.flatnonzero(before.kept)[10])
    x, y = np.rint(mapped(v.H, centres("shapes")[before.chosen[which : which + 1]])[0]).astype(int)
    values = v.mosaic.values.copy()
    values[y - 7 : y + 8, x - 7 : x + 8] = 400
    # An edge of something else, which no picture's light explains.
    values[y - 7 : y + 8, x : x + 8] = 3000
    values[y : y + 8, x - 7 : x + 8] += 700
    after = v.fit(replace(v.mosaic, values=values))
    assert not after.kept[which]
    assert off(after.H, v.H) < 0.03


def test_patches_out_of_view_are_not_chosen() -> None:
    v = view("shapes", 8)
    away = np.array([[1, 0, 0.6 * WIDTH], [0, 1, 0], [0, 0, 1]]) @ v.H
    alignment = SiteAlignment(v.mosaic, levels("shapes"), away, centres("shapes"))
    at = mapped(away, centres("shapes")[alignment.chosen])
    assert 6 <= len(alignment.chosen) < len(centres("shapes"))
    assert (at >= 4).all() and (at <= (WIDTH - 5, HEIGHT - 5)).all()


@pytest.mark.parametrize("shift", [WIDTH, -WIDTH, 10 * WIDTH])
def test_too_few_patches_in_view(shift: float) -> None:
    v = view("shapes", 8)
    away = np.array([[1, 0, shift], [0, 1, 0], [0, 0, 1]]) @ v.H
    with pytest.raises(NoConsensus, match="patches in view; need 6"):
        SiteAlignment(v.mosaic, levels("shapes"), away, centres("shapes"))


def _tried(values: NDArray[np.uint16], light: NDArray[np.float32]) -> SitesFit | None:
    """Return what is found in any values; None: an error says that nothing is. Warnings of numpy are errors."""
    v = view("shapes", 8)
    try:
        return SiteAlignment(replace(v.mosaic, values=values), light_levels(light), v.start, centres("shapes")).fit()
    except EstimationError:
        return None


@pytest.mark.parametrize("value", [0, 256, 2000, 4095, 65535])
def test_a_flat_frame_gives_no_homography(value: int) -> None:
    with np.errstate(divide="raise", invalid="raise"):
        assert _tried(np.full((HEIGHT, WIDTH), value, np.uint16), picture("shapes")) is None


@pytest.mark.parametrize("value", [0.0, 0.5, 1.0])
def test_a_flat_picture_gives_no_homography(value: float) -> None:
    flat = np.full(picture("shapes").shape, value, np.float32)
    with np.errstate(divide="raise", invalid="raise"):
        assert _tried(view("shapes", 8).mosaic.values, flat) is None
        assert _tried(np.full((HEIGHT, WIDTH), 700, np.uint16), flat) is None


def test_another_picture_never_gives_numbers_that_are_not_finite() -> None:
    found = _tried(view("page", 8).mosaic.values, picture("shapes"))
    assert found is None or (np.isfinite(found.H).all() and np.isfinite(found.information).all())
    noise = np.random.default_rng(1).integers(0, 4096, (HEIGHT, WIDTH)).astype(np.uint16)
    found = _tried(noise, picture("shapes"))
    assert found is None or (np.isfinite(found.H).all() and np.isfinite(found.information).all())


# --- lens and rolling shutter

#: Radial distortion with a closed form both ways: ideal = raw / (1 + K r^2) about the middle, r in px.
MIDDLE, K = np.array([150.0, 124.0]), 1.5e-6


def ideal_of_raw(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    x, y = x - MIDDLE[0], y - MIDDLE[1]
    shrunk = 1 / (1 + K * (x * x + y * y))
    return x * shrunk + MIDDLE[0], y * shrunk + MIDDLE[1]


def raw_of_ideal(ideal: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    def raw(at: NDArray[np.float64]) -> NDArray[np.float64]:
        from_middle = at - MIDDLE
        r2 = (from_middle**2).sum(axis=1, keepdims=True)
        return MIDDLE + from_middle * 2 / (1 + np.sqrt(1 - 4 * K * r2))

    step = 1e-4
    columns = [(raw(ideal + d) - raw(ideal - d)) / (2 * step) for d in step * np.eye(2)]
    return raw(ideal), np.stack(columns, axis=2)


def test_the_lens_of_this_file_is_inverted() -> None:
    xy = np.random.default_rng(0).uniform(0, (WIDTH, HEIGHT), (50, 2))
    raw, _ = raw_of_ideal(xy)
    np.testing.assert_allclose(np.stack(ideal_of_raw(*raw.T), axis=1), xy, atol=1e-9)
    assert 3 < np.hypot(*(raw - xy).T).max() < 20


@pytest.mark.parametrize("name", TEXTURES)
def test_through_a_lens(name: str) -> None:
    v = view(name, 9, ideal=ideal_of_raw)
    assert off(v.fit(lens=raw_of_ideal).H, v.H) < 0.03


@pytest.mark.parametrize("name", TEXTURES)
def test_the_mean_place_of_a_motion_that_turns_is_in_the_covariance(name: str) -> None:
    """Along an arc, it is off the arc's middle by the square of the length over 24 radii."""
    radius, length = 40.0, 4.0
    H = view(name, 12).H
    exposed: list[NDArray[np.float64]] = []
    for angle in (np.arange(17) - 8) / 17 * length / radius:
        to = np.array([[1, 0, radius * np.sin(angle)], [0, 1, radius * (1 - np.cos(angle))], [0, 0, 1]])
        exposed.append(light_of_sites(picture(name), to @ H))
    v = replace(view(name, 12), mosaic=mosaic_of(np.mean(exposed, axis=0), PATTERNS["rggb"]))
    fit = v.fit()
    shift = (mapped(fit.H, CORNERS) - mapped(H, CORNERS)).mean(axis=0)
    sigma = np.sqrt(fit.doubted[[2, 5], [2, 5]]) / fit.T[0, 0]
    np.testing.assert_allclose(sigma, length**2 / (24 * radius), rtol=0.4)
    assert shift[1] > 0.3 * sigma[1] and (np.abs(shift) < 2.5 * sigma).all()


@pytest.mark.parametrize("name", TEXTURES)
def test_a_rolling_shutter_is_undone(name: str) -> None:
    """Rows are exposed one after the other, while the target moves by 5 px and turns by half a degree."""
    row, by = (HEIGHT - 1) / 2, np.array([[0.0, -4e-5, 0.02], [4e-5, 0.0, -0.012]])

    def moved_back(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        later = np.floor(y + 0.5) - row
        return x - later * (by[0, 1] * y + by[0, 2]), y - later * (by[1, 0] * x + by[1, 2])

    v = view(name, 11, ideal=moved_back)
    at = mapped(v.start, centres(name))
    by_row = at @ by[:, :2].T + by[:, 2]
    fit = v.fit(scan=RowScan(by_row, 0.1 * by_row[None], row))
    assert off(fit.H, v.H) < 0.04
    assert off(v.fit().H, v.H) > 0.3
    # What is doubted of the motion is beside what the samples tell.
    sure = v.fit(scan=RowScan(by_row, 0 * by_row[None], row))
    np.testing.assert_array_equal(fit.covariance, sure.covariance)
    assert np.linalg.eigvalsh(fit.doubted - sure.doubted).max() > 0
    assert nees(fit, v.H) < nees(sure, v.H) + 1e-6


def test_rows_of_the_sensor_see_a_point_later() -> None:
    """A point at row y at time 0, which moves by v a row, is seen where y + v t = t: by hand."""
    scan = RowScan(np.array([[0.5, 0.0], [0.0, 0.5], [0.1, -0.25]]), np.zeros((1, 3, 2)), 100.0)
    seen = scan.seen(np.array([[10.0, 120.0], [10.0, 120.0], [50.0, 75.0]]))
    np.testing.assert_allclose(seen, [[20.0, 120.0], [10.0, 140.0], [48.0, 80.0]], atol=1e-12)


def test_the_same_samples_give_the_same_numbers() -> None:
    v = view("page", 12)
    first, second = v.fit(), v.fit()
    np.testing.assert_array_equal(first.H, second.H)
    np.testing.assert_array_equal(first.information, second.information)


def test_samples_that_all_have_the_same_slope_agree_on_nothing() -> None:
    """As where a transfer curve that was tried makes everything one value."""
    flat = np.zeros((6, 100), np.float32)
    for usable in (np.ones((6, 100), bool), np.zeros((6, 100), bool)):
        with pytest.raises(NoConsensus, match="do not vary"):
            noise_of(flat, flat, flat + np.float32(0.5), usable)
