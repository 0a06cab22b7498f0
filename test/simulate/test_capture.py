# SPDX-License-Identifier: Apache-2.0
"""Shutter, lens and exposure of the simulated camera against their formulae, on small blobs of light on black."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import islice

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from imgu_ros.errors import ParameterError
from imgu_ros.reference.templates import TargetImage
from imgu_ros.simulate.capture import Capture, check_capture, thin_lens, views_of
from imgu_ros.simulate.geometry import rotation_about
from imgu_ros.simulate.render import Renderer
from imgu_ros.simulate.scene import Scene
from imgu_ros.simulate.sequence import TYPICAL_LENSES, Simulation, default_camera, simulate_sequence
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.vision.camera.intrinsics import Camera, DistortionModel
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout
from imgu_ros.vision.formation.optics import circle_of_confusion, disc_kernel
from imgu_ros.vision.formation.shutter import motion_kernel, rolling_shutter_points

Array = NDArray[np.float64]
PoseAt = Callable[[float], RigidTransform]

CAMERA = default_camera(280, 200)
F = float(CAMERA.K[0, 0])
PITCH = 150e-6
FACING = np.diag([1.0, -1.0, -1.0])
WIDTH_M = 0.5
SIZE = 800, 560
#: Template px: far from the edge and from each other.
DOTS = np.array([[x, y] for y in (140.0, 420.0) for x in (140.0, 400.0, 660.0)])
DOT_SIGMA = 8.0
MONO = PixelLayout(ColorModel.MONO)


def dots_scene() -> Scene:
    y, x = np.indices(SIZE[::-1])
    light = np.sum([np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * DOT_SIGMA**2)) for cx, cy in DOTS], axis=0)
    encoded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)
    target = TargetImage("dots", np.round(255 * encoded).astype(np.uint8), WIDTH_M)
    return Scene((target,), (RigidTransform(np.eye(3), np.zeros(3)),), 0.01)


SCENE = dots_scene()


def still(distance_m: float = 0.55, tilt_deg: float = 0.0) -> RigidTransform:
    tilt = rotation_about(np.array([0.6, 0.8, 0.0]), math.radians(tilt_deg))
    return RigidTransform(FACING @ tilt, np.array([0.004, -0.003, distance_m]))


def sliding(velocity_m_s: tuple[float, float, float], start: RigidTransform) -> PoseAt:
    return lambda seconds: RigidTransform(start.R, start.t + seconds * np.array(velocity_m_s))


def turning(rate_rad_s: float, start: RigidTransform) -> PoseAt:
    def pose_at(seconds: float) -> RigidTransform:
        turn = rotation_about(np.array([0.3, 0.2, 1.0]), rate_rad_s * seconds)
        return RigidTransform(turn @ start.R, turn @ start.t)

    return pose_at


def on_image(pose: RigidTransform, camera: Camera = CAMERA) -> Array:
    s = WIDTH_M / SIZE[0]
    x, y = s * (DOTS[:, 0] - (SIZE[0] - 1) / 2), -s * (DOTS[:, 1] - (SIZE[1] - 1) / 2)
    projected: Array = camera.project(np.column_stack((x, y, np.zeros(len(x)))) @ pose.R.T + pose.t)
    return projected


def taken(capture: Capture, pose_at: PoseAt, camera: Camera = CAMERA, layout: PixelLayout = MONO) -> Array:
    views = views_of(capture, pose_at, 10.0, camera, SCENE)
    return Renderer(SCENE, camera, layout).mean_radiance(views).astype(np.float64)


def moments(image: Array, near: Array, radius: int = 17) -> tuple[Array, Array]:
    """Return centroid (2,) and covariance (2, 2) of the light within a square around a place."""
    cx, cy = np.round(near).astype(int)
    y, x = np.mgrid[cy - radius : cy + radius + 1, cx - radius : cx + radius + 1]
    light = image[y, x].ravel()
    points = np.column_stack((x.ravel(), y.ravel()))
    centroid = light @ points / light.sum()
    return centroid, (light[:, None] * (points - centroid)).T @ (points - centroid) / light.sum()


@pytest.mark.parametrize("layout", [MONO, PixelLayout(ColorModel.BAYER, BayerPattern.RGGB)])
def test_an_ideal_camera_takes_one_view_bit_for_bit(layout: PixelLayout) -> None:
    assert Capture().is_ideal
    image = taken(Capture(), lambda _: still(), layout=layout)
    np.testing.assert_array_equal(image, Renderer(SCENE, CAMERA, layout).radiance(still()))


@pytest.mark.parametrize("diameter", [2.0, 4.5, 9.0])
def test_defocus_spreads_a_point_over_a_disc(diameter: float) -> None:
    # A uniform disc of diameter D has variance D^2 / 16 along each axis, and moves no centroid.
    sharp = taken(Capture(), lambda _: still())
    blurred = taken(Capture(defocus_px=diameter), lambda _: still())
    growth = []
    for place in on_image(still()):
        (before, small), (after, large) = moments(sharp, place), moments(blurred, place)
        np.testing.assert_allclose(after, before, atol=0.01)
        growth.append(large - small)
    mean = np.mean(growth, axis=0)
    np.testing.assert_allclose(4 * np.sqrt(np.diag(mean)), diameter, rtol=0.02)
    assert abs(mean[0, 1]) < 0.01 * mean[0, 0]
    assert blurred.sum() == pytest.approx(sharp.sum(), rel=1e-3)


def test_defocus_is_a_convolution_with_the_disc() -> None:
    sharp, blurred = (taken(c, lambda _: still()) for c in (Capture(), Capture(defocus_px=7)))
    inside = slice(40, 160), slice(60, 220)
    expected = cv2.filter2D(sharp, -1, disc_kernel(7.0).astype(float))
    np.testing.assert_allclose(blurred[inside], expected[inside], atol=0.01 * sharp.max())


@pytest.mark.parametrize(("focus", "depth"), [(0.4, 0.55), (0.9, 0.55), (0.55, 0.55)])
def test_thin_lens_blurs_by_its_circle_of_confusion(focus: float, depth: float) -> None:
    capture = Capture(f_number=1.4, focus_m=focus, pitch_m=PITCH)
    # By hand: image distance v = f_px pitch, 1/f = 1/v + 1/s, aperture f / N, disc A v |1/s - 1/d| on the sensor.
    v = F * PITCH
    aperture = 1 / (1 / v + 1 / focus) / 1.4
    expected = aperture * v * abs(1 / focus - 1 / depth) / PITCH
    lens = thin_lens(capture, CAMERA, focus)
    assert float(circle_of_confusion(lens, depth)) / PITCH == pytest.approx(expected)
    assert lens.image_distance_m == pytest.approx(v)
    sharp, blurred = (taken(c, lambda _: still(depth)) for c in (Capture(), capture))
    growth = []
    for place in on_image(still(depth)):
        (before, small), (after, large) = moments(sharp, place), moments(blurred, place)
        np.testing.assert_allclose(after, before, atol=0.01)
        growth.append(np.diag(large - small))
    measured = 4 * math.sqrt(max(float(np.mean(growth)), 0.0))
    assert measured == pytest.approx(expected, rel=0.02, abs=0.05)
    assert expected == 0 or expected > 3


def test_thin_lens_blurs_what_is_nearer_and_farther_on_a_tilted_plane() -> None:
    pose = still(0.55, 35)
    capture = Capture(f_number=0.8, focus_m=0.55, pitch_m=PITCH)
    aperture = thin_lens(capture, CAMERA, 0.55).aperture_m
    s = WIDTH_M / SIZE[0]
    local = np.column_stack((s * (DOTS[:, 0] - 399.5), -s * (DOTS[:, 1] - 279.5), np.zeros(len(DOTS))))
    depths = (local @ pose.R.T + pose.t)[:, 2]
    sharp, blurred = (taken(c, lambda _: pose) for c in (Capture(), capture))
    for place, depth in zip(on_image(pose), depths, strict=True):
        growth = moments(blurred, place)[1] - moments(sharp, place)[1]
        expected = aperture * F * abs(1 / 0.55 - 1 / depth)
        assert 4 * math.sqrt(max(np.trace(growth) / 2, 0)) == pytest.approx(expected, rel=0.04, abs=0.15)
    assert np.ptp(depths) > 0.2


@pytest.mark.parametrize("velocity", [(0.4, 0.0, 0.0), (-0.2, 0.5, 0.0)])
def test_motion_blur_is_a_line_of_the_travelled_length(velocity: tuple[float, float, float]) -> None:
    # A line of length L has variance L^2 / 12; over 20 ms the picture moves by f v t / Z.
    time = 0.02
    pose_at = sliding(velocity, still())
    sharp, blurred = (taken(c, pose_at) for c in (Capture(), Capture(exposure_s=time)))
    travel = F * np.array(velocity[:2]) * time / 0.55
    for place in on_image(still()):
        (before, small), (after, large) = moments(sharp, place), moments(blurred, place)
        np.testing.assert_allclose(after, before, atol=0.01)  # the truth is that of mid-exposure
        np.testing.assert_allclose(large - small, np.outer(travel, travel) / 12, rtol=0.02, atol=0.01)


def test_motion_blur_is_a_convolution_with_the_line() -> None:
    pose_at = sliding((0.3, 0.4, 0.0), still())
    sharp, blurred = (taken(c, pose_at) for c in (Capture(), Capture(exposure_s=0.03)))
    inside = slice(40, 160), slice(60, 220)
    expected = cv2.filter2D(sharp, -1, motion_kernel(F * np.array([0.3, 0.4]) / 0.55, 0.03).astype(float))
    # The kernel interpolates linearly between pixels, which smooths a little more.
    np.testing.assert_allclose(blurred[inside], expected[inside], atol=0.025 * sharp.max())


def test_motion_blur_follows_the_path_of_each_point() -> None:
    # Turning: every dot is smeared along its own arc, whose mean position is computed here.
    time, rate = 0.03, 1.5
    pose_at = turning(rate, still())
    blurred = taken(Capture(exposure_s=time), pose_at)
    arcs = np.stack([on_image(pose_at(t)) for t in (np.arange(200) + 0.5) / 200 * time - time / 2])
    for arc in np.swapaxes(arcs, 0, 1):
        centroid, _ = moments(blurred, arc.mean(axis=0))
        np.testing.assert_allclose(centroid, arc.mean(axis=0), atol=0.01)


def test_motion_and_defocus_add_up() -> None:
    pose_at = sliding((0.4, 0.0, 0.0), still())
    sharp, blurred = (taken(c, pose_at) for c in (Capture(), Capture(exposure_s=0.02, defocus_px=5)))
    travel = F * 0.4 * 0.02 / 0.55
    growth = np.mean([moments(blurred, p)[1] - moments(sharp, p)[1] for p in on_image(still())], axis=0)
    np.testing.assert_allclose(growth, np.diag([25 / 16 + travel**2 / 12, 25 / 16]), rtol=0.03, atol=0.03)


@pytest.mark.parametrize("row_time", [200e-6, -200e-6])
@pytest.mark.parametrize("velocity", [(0.6, 0.0, 0.0), (0.0, 0.6, 0.0), (-0.3, -0.5, 0.0)])
def test_rolling_shutter_shows_moving_points_where_computed(
    row_time: float, velocity: tuple[float, float, float]
) -> None:
    pose_at = sliding(velocity, still())
    image = taken(Capture(row_time_s=row_time), pose_at)
    pixels_s = F * np.array(velocity[:2]) / 0.55
    expected = rolling_shutter_points(on_image(still()), pixels_s, row_time, CAMERA.height)
    got = np.array([moments(image, place)[0] for place in expected])
    # A dot is some 5 px tall: its rows differ in time by little, its outline is sheared about its centre.
    np.testing.assert_allclose(got, expected, atol=0.01)
    assert np.abs(expected - on_image(still())).max() > 1


def test_rolling_shutter_skews_a_vertical_line() -> None:
    # Black left, white right: in every row, the edge lies where the row's time puts it; x' = x0 + v_x t_row.
    side = np.zeros((560, 800), np.uint8)
    side[:, 400:] = 255
    scene = replace(SCENE, targets=(TargetImage("edge", side, WIDTH_M),))
    row_time, velocity = 50e-6, 0.8
    views = views_of(Capture(row_time_s=row_time), sliding((velocity, 0.0, 0.0), still(0.3)), 10.0, CAMERA, scene)
    image = Renderer(scene, CAMERA, MONO).mean_radiance(views)
    edges = 220 - image[:, 60:220].sum(axis=1) - 0.5
    rows = np.arange(CAMERA.height)
    slope, _ = np.polyfit(rows, edges, 1)
    expected = F * velocity / 0.3 * row_time
    assert slope == pytest.approx(expected, rel=1e-3)
    at_rest = CAMERA.project(np.array([[0.004, -0.003, 0.3]]))  # the edge is on the target's middle line
    np.testing.assert_allclose(edges, at_rest[0, 0] + expected * (rows - (CAMERA.height - 1) / 2), atol=0.03)


@pytest.mark.parametrize("model", [None, DistortionModel.PLUMB_BOB])
def test_rolling_shutter_of_a_turning_camera_agrees_row_by_row(model: DistortionModel | None) -> None:
    camera = CAMERA if model is None else default_camera(280, 200, model, TYPICAL_LENSES[model])
    row_time, pose_at = 250e-6, turning(2.0, still(0.55, 30))
    image = taken(Capture(row_time_s=row_time), pose_at, camera, PixelLayout(ColorModel.MONO))
    global_image = taken(Capture(), pose_at, camera)
    expected = on_image(pose_at(0.0), camera)
    bias = np.array([moments(global_image, place)[0] for place in expected]) - expected
    for _ in range(20):  # the row in which a dot is seen gives the time, which gives the row
        seen = [on_image(pose_at(row_time * (y - 99.5)), camera)[i] for i, (_, y) in enumerate(expected)]
        expected = np.array(seen)
    got = np.array([moments(image, place)[0] for place in expected])
    np.testing.assert_allclose(got - bias, expected, atol=0.015)
    assert np.abs(expected - on_image(pose_at(0.0), camera)).max() > 1


def test_rolling_shutter_without_motion_is_global() -> None:
    rolling, at_once = (taken(c, lambda _: still(0.55, 25)) for c in (Capture(row_time_s=1e-5), Capture()))
    assert np.abs(rolling - at_once).max() < 0.02  # single precision, and other strips with another texture level
    assert np.abs(rolling - at_once).mean() < 1e-4


def test_rolling_shutter_over_a_floor_that_reaches_behind_the_camera() -> None:
    floor = replace(SCENE, targets=(replace(SCENE.targets[0], width_m=4.0),))
    tilt = rotation_about(np.array([1.0, 0.0, 0.0]), math.radians(75))
    pose_at = sliding((0.0, 0.0, 0.0), RigidTransform(tilt @ FACING, np.array([0.0, 0.3, 0.5])))
    images = [
        Renderer(floor, CAMERA, MONO).mean_radiance(views_of(capture, pose_at, 10.0, CAMERA, floor))
        for capture in (Capture(row_time_s=1e-5), Capture())
    ]
    assert np.abs(images[0] - images[1]).mean() < 1e-4


def test_target_that_passes_while_the_rows_are_read() -> None:
    # So fast that the first rows see it on the left and the last ones on the right, beyond the image's edge.
    pose_at = sliding((20.0, 0.0, 0.0), still())
    image = taken(Capture(row_time_s=2e-4), pose_at)
    rows = np.arange(CAMERA.height)
    expected = np.array([on_image(pose_at(2e-4 * (row - 99.5)))[1, 0] for row in rows])
    near = np.abs(rows - on_image(still())[1, 1]) < 2
    for row, x in zip(rows[near], expected[near], strict=True):
        light = image[row, round(x) - 8 : round(x) + 9]
        assert light @ np.arange(-8, 9) / light.sum() + round(x) == pytest.approx(x, abs=0.02)
    assert image[:40, -30:].mean() > 0.1 > image[90:110, 100:180].min()  # the wall where the target is not yet


SMALL = Simulation(width=160, height=120, frames=90, seed=5, sensor=None, layout=MONO)
POSTER = (TargetImage("poster", procedural_texture(160, 120, 0), 0.4),)


def test_stops_double_the_light() -> None:
    small = replace(SMALL, frames=4)
    plain = [f.frame.image.pixels.astype(float) for f in simulate_sequence(small, POSTER)]
    stepped = replace(small, capture=Capture(ev=(0.0, -1.5)))
    for index, simulated in enumerate(simulate_sequence(stepped, POSTER)):
        factor = 1.0 if index < 2 else 2**-1.5
        np.testing.assert_allclose(simulated.frame.image.pixels, plain[index] * factor, atol=0.75)


def test_sequences_keep_their_truth_and_repeat() -> None:
    capture = Capture(exposure_s=0.01, row_time_s=1e-4, defocus_px=1.0)
    ideal = list(islice(simulate_sequence(SMALL, POSTER), 3))
    real = replace(SMALL, capture=capture)
    first, again = (list(islice(simulate_sequence(real, POSTER, workers=n), 3)) for n in (1, 2))
    for a, b, c in zip(ideal, first, again, strict=True):
        np.testing.assert_array_equal(b.frame.image.pixels, c.frame.image.pixels)
        assert a.frame.stamp_ns == b.frame.stamp_ns
        np.testing.assert_array_equal(a.truths[0].H, b.truths[0].H)
        difference = a.frame.image.pixels.astype(float) - b.frame.image.pixels
        assert np.abs(difference).mean() > 100


@pytest.mark.parametrize(
    ("capture", "message"),
    [
        (Capture(exposure_s=-1e-3), "exposure: -1 ms; need 0 to the frame period, 100"),
        (Capture(exposure_s=0.2), "exposure: 200 ms"),
        (Capture(exposure_s=math.nan), "exposure: nan ms"),
        (Capture(row_time_s=0.001), "row time: 1000 us x 119 rows; need at most the frame period, 100000 us"),
        (Capture(row_time_s=math.nan), "row time: nan"),
        (Capture(defocus_px=-1), "defocus: -1 px; need 0 to 40"),
        (Capture(defocus_px=math.inf), "defocus: inf px"),
        (Capture(f_number=0.1), "f-number: 0.1; need 0.5 to 1000"),
        (Capture(f_number=math.nan), "f-number: nan"),
        (Capture(focus_m=1.0), "focus: 1 m without an f-number"),
        (Capture(f_number=2, focus_m=-1.0), "focus: -1 m"),
        (Capture(f_number=2, pitch_m=0.0), "pixel pitch: 0 um"),
        (Capture(ev=()), "ev: \\[\\]; need numbers from -10 to 10"),
        (Capture(ev=(0.0, 99.0)), "ev: "),
    ],
)
def test_impossible_captures_are_refused(capture: Capture, message: str) -> None:
    with pytest.raises(ParameterError, match=f"^{message}"):
        check_capture(capture, 120, 10.0)
    with pytest.raises(ParameterError):
        next(simulate_sequence(replace(SMALL, rate_hz=10.0, capture=capture), POSTER))
