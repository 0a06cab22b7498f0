# SPDX-License-Identifier: Apache-2.0
"""The renderer against geometry computed here: centroids of blobs, brute-force area means, flat fields."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from imgu_ros.errors import ShapeError
from imgu_ros.reference.templates import TargetImage
from imgu_ros.simulate.geometry import image_from_template, rotation_about
from imgu_ros.simulate.optics import PixelGrid
from imgu_ros.simulate.render import Renderer
from imgu_ros.simulate.scene import Scene, arrange_scene, template_matrix
from imgu_ros.simulate.sequence import TYPICAL_LENSES, default_camera
from imgu_ros.vision.camera.intrinsics import Camera, DistortionModel
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.formation.cfa import BayerPattern, mosaic
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout

Array = NDArray[np.float64]

WIDTH_M = 0.5
FACING = np.diag([1.0, -1.0, -1.0])  # a camera straight before the target


@dataclass(frozen=True, slots=True)
class View:
    """A camera pose, the template's width, and the blobs' size in it."""

    tilt_deg: float
    roll_deg: float
    distance_m: float
    template_px: int


VIEWS = (
    View(0, 0, 0.5, 800),
    View(0, 77, 0.5, 800),
    View(35, 40, 0.55, 800),
    View(35, 200, 0.5, 240),  # magnified
    View(30, 130, 1.1, 1200),  # minified
)


def srgb(linear: Array) -> NDArray[np.uint8]:
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)
    return np.round(255 * encoded).astype(np.uint8)


def linear(encoded: NDArray[np.uint8]) -> Array:
    v = encoded / 255
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def blob_template(width: int, shift: float) -> tuple[NDArray[np.uint8], Array]:
    """Return a grey template, 4:3, with Gaussian blobs on black, and their centres (N, 2)."""
    height, pitch, sigma = width * 3 // 4, width / 8, width / 90
    x, y = np.meshgrid(np.arange(1, 8) * pitch + shift * sigma, np.arange(1, 6) * pitch + 0.3 * shift * sigma)
    centres = np.column_stack((x.ravel(), y.ravel()))
    light = np.zeros((height, width))
    for cx, cy in centres:
        light += np.exp(-((np.arange(width) - cx) ** 2) / (2 * sigma**2)) * np.exp(
            -((np.arange(height) - cy) ** 2)[:, None] / (2 * sigma**2)
        )
    return srgb(np.minimum(light, 1)), centres


def pose_of(view: View) -> RigidTransform:
    roll = rotation_about(np.array([0.0, 0.0, 1.0]), math.radians(view.roll_deg))
    tilt = rotation_about(np.array([0.6, 0.8, 0.0]), math.radians(view.tilt_deg))
    return RigidTransform(roll @ FACING @ tilt, np.array([0.0041, -0.0073, view.distance_m]))


def projected(camera: Camera, pose: RigidTransform, template: Array, size: tuple[int, int]) -> Array:
    """Project template points (N, 2) by the pose, without the homography under test."""
    s = WIDTH_M / size[0]
    x, y = s * (template[:, 0] - (size[0] - 1) / 2), -s * (template[:, 1] - (size[1] - 1) / 2)
    return camera.project(np.column_stack((x, y, np.zeros(len(x)))) @ pose.R.T + pose.t)


def true_centroid(camera: Camera, pose: RigidTransform, plane: NDArray[np.uint8], centre: Array) -> Array:
    """Return the centroid in the image of the template's light around a blob, each texel with its area in the image."""
    size = plane.shape[1], plane.shape[0]
    reach = 5 * size[0] / 90
    x0, y0 = (np.floor(centre - reach)).astype(int)
    x1, y1 = (np.ceil(centre + reach)).astype(int)
    x, y = np.meshgrid(np.arange(x0, x1 + 1), np.arange(y0, y1 + 1))
    points = np.column_stack((x.ravel(), y.ravel())).astype(float)
    h = 0.5
    dx = projected(camera, pose, points + (h, 0), size) - projected(camera, pose, points - (h, 0), size)
    dy = projected(camera, pose, points + (0, h), size) - projected(camera, pose, points - (0, h), size)
    area = np.abs(dx[:, 0] * dy[:, 1] - dx[:, 1] * dy[:, 0])
    weight = linear(plane[y, x]).ravel() * area
    centroid: Array = (weight[:, None] * projected(camera, pose, points, size)).sum(axis=0) / weight.sum()
    return centroid


@cache
def true_blobs(view: View, model: DistortionModel | None) -> dict[str, list[tuple[Array, float]]]:
    """Return each colour's blobs that lie well inside the image: centroid and a radius around it, px."""
    camera, pose = camera_with(model), pose_of(view)
    found: dict[str, list[tuple[Array, float]]] = {}
    for color, (plane, centres) in colored_blobs(view.template_px).items():
        size = plane.shape[1], plane.shape[0]
        found[color] = []
        for centre in centres:
            ring = centre + 4.5 * size[0] / 90 * np.column_stack((np.cos(np.arange(8)), np.sin(np.arange(8))))
            around = projected(camera, pose, ring, size)
            if (around > 1).all() and (around < (camera.width - 2, camera.height - 2)).all():
                radius = float(np.hypot(*(around - around.mean(axis=0)).T).max())
                found[color].append((true_centroid(camera, pose, plane, centre), radius))
    return found


def centroid_errors(view: View, layout: PixelLayout, model: DistortionModel | None = None) -> Array:
    """Render, and return the blob centroids' errors (N, 2) px over all colours that the layout measures."""
    camera = camera_with(model)
    stack = np.stack([plane for plane, _ in colored_blobs(view.template_px).values()], axis=2)
    scene = arrange_scene([TargetImage("blobs", stack, WIDTH_M)])
    image = Renderer(scene, camera, layout).radiance(pose_of(view)).astype(np.float64)
    truths = true_blobs(view, model)
    errors = []
    for index, color in enumerate(layout.pattern.value if layout.pattern else "rgb"):
        row, column, step = (*divmod(index, 2), 2) if layout.pattern else (0, 0, 1)
        values = image[row::step, column::step] if image.ndim == 2 else image[:, :, index]
        for truth, radius in truths[color]:
            i0, i1 = (min(max(math.ceil((truth[1] + s * radius - row) / step), 0), len(values)) for s in (-1, 1))
            j0, j1 = (min(max(math.ceil((truth[0] + s * radius - column) / step), 0), values.shape[1]) for s in (-1, 1))
            x, y = column + step * np.arange(j0, j1), row + step * np.arange(i0, i1)[:, None]
            light = np.where(np.hypot(x - truth[0], y - truth[1]) < radius, values[i0:i1, j0:j1], 0)
            errors.append(np.array([(light * x).sum(), (light * y).sum()]) / light.sum() - truth)
    assert len(errors) > 60
    return np.array(errors)


def camera_with(model: DistortionModel | None) -> Camera:
    return default_camera(640, 480) if model is None else default_camera(640, 480, model, TYPICAL_LENSES[model])


@cache
def colored_blobs(width: int) -> dict[str, tuple[NDArray[np.uint8], Array]]:
    """Blobs at other places in each colour, so that a swapped colour shows."""
    return {color: blob_template(width, shift) for color, shift in zip("rgb", (-1.0, 0.0, 1.0), strict=True)}


@pytest.mark.parametrize("pattern", BayerPattern)
@pytest.mark.parametrize("view", VIEWS, ids=str)
def test_blob_centroids_agree_with_the_truth(view: View, pattern: BayerPattern) -> None:
    errors = centroid_errors(view, PixelLayout(ColorModel.BAYER, pattern))
    assert np.hypot(*errors.T).max() < 0.01
    assert np.abs(errors.mean(axis=0)).max() < 0.002


@pytest.mark.parametrize("model", DistortionModel)
def test_blob_centroids_agree_with_the_truth_through_a_lens(model: DistortionModel) -> None:
    errors = centroid_errors(VIEWS[2], PixelLayout(ColorModel.RGB), model)
    assert np.hypot(*errors.T).max() < 0.01
    assert np.abs(errors.mean(axis=0)).max() < 0.002


@pytest.mark.parametrize("pattern", BayerPattern)
def test_bayer_is_the_mosaic_of_the_color_picture(pattern: BayerPattern) -> None:
    rng = np.random.default_rng(1)
    scene = arrange_scene([TargetImage("t", rng.integers(0, 256, (90, 120, 3), dtype=np.uint8), WIDTH_M)])
    camera, pose = default_camera(322, 242), pose_of(VIEWS[2])
    color = Renderer(scene, camera, PixelLayout(ColorModel.RGB)).radiance(pose)
    raw = Renderer(scene, camera, PixelLayout(ColorModel.BAYER, pattern)).radiance(pose)
    # Not bit-equal: single precision about another origin, and 1/32-pixel weights, at each site.
    assert np.abs(raw - mosaic(color, pattern)).max() < 0.05
    assert np.sqrt(np.mean((raw - mosaic(color, pattern)) ** 2)) < 0.003
    swapped = Renderer(scene, camera, PixelLayout(ColorModel.BGR)).radiance(pose)
    np.testing.assert_array_equal(swapped, color[:, :, ::-1])


@pytest.mark.parametrize(("view", "cell"), [(VIEWS[2], 6), (VIEWS[4], 20)], ids=["near", "minified"])
def test_pixels_are_area_means(view: View, cell: int) -> None:
    # Hard-edged cells of about two pixels, averaged by brute force: 16x16 exact rays for each of a few hundred pixels.
    rng = np.random.default_rng(2)
    size = view.template_px, view.template_px * 3 // 4
    texture = np.kron(rng.integers(0, 256, (size[1] // cell + 1, size[0] // cell + 1)), np.ones((cell, cell)))
    texture = texture[: size[1], : size[0]].astype(np.uint8)
    camera, pose = default_camera(320, 240), pose_of(view)
    scene = arrange_scene([TargetImage("t", texture, WIDTH_M)])
    image = Renderer(scene, camera, PixelLayout(ColorModel.MONO)).radiance(pose)
    target = TargetImage("t", texture, WIDTH_M)
    H_inverse = np.linalg.inv(image_from_template(camera.K, pose, template_matrix(target)))
    x, y = np.meshgrid(np.arange(135, 185, 3), np.arange(95, 145, 3))
    sub = (np.arange(16) + 0.5) / 16 - 0.5
    rays = np.stack(np.broadcast_arrays(x[..., None, None] + sub, y[..., None, None] + sub[:, None], 1.0), axis=-1)
    mapped = rays @ H_inverse.T
    u, v = np.round(mapped[..., 0] / mapped[..., 2]).astype(int), np.round(mapped[..., 1] / mapped[..., 2]).astype(int)
    expected = linear(texture)[v, u].mean(axis=(2, 3))
    got = image[y, x]
    assert np.corrcoef(got.ravel(), expected.ravel())[0, 1] > 0.995
    assert np.sqrt(np.mean((got - expected) ** 2)) < 0.02


def test_fine_checkerboard_does_not_alias() -> None:
    checker = ((np.indices((1200, 1600)).sum(axis=0) % 2) * 255).astype(np.uint8)
    scene = arrange_scene([TargetImage("t", checker, WIDTH_M)])
    image = Renderer(scene, default_camera(320, 240), PixelLayout(ColorModel.MONO)).radiance(pose_of(VIEWS[1]))
    assert np.abs(image[60:180, 120:200] - 0.5).max() < 0.02


@pytest.mark.parametrize("view", VIEWS, ids=str)
def test_white_target_has_exact_area_and_outline(view: View) -> None:
    # White on the wall: the sum of coverage is the outline's area, its centroid the quadrilateral's.
    template = np.full((view.template_px * 3 // 4, view.template_px), 255, np.uint8)
    size = template.shape[1], template.shape[0]
    camera, pose = default_camera(640, 480), pose_of(View(view.tilt_deg, view.roll_deg, 1.1, view.template_px))
    target = TargetImage("t", template, WIDTH_M)
    layout = PixelLayout(ColorModel.MONO)
    white = Renderer(arrange_scene([target]), camera, layout).radiance(pose)
    black_target = TargetImage("t", np.zeros_like(template), WIDTH_M)
    black = Renderer(arrange_scene([black_target]), camera, layout).radiance(pose)
    coverage = (white - black).astype(np.float64)
    corners = np.array([[-0.5, -0.5], [size[0] - 0.5, -0.5], [size[0] - 0.5, size[1] - 0.5], [-0.5, size[1] - 0.5]])
    quad = projected(camera, pose, corners, size)
    a, b = quad, np.roll(quad, -1, axis=0)
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    area = cross.sum() / 2
    centroid = ((a + b) * cross[:, None]).sum(axis=0) / (6 * area)
    y, x = np.indices(coverage.shape)
    assert coverage.sum() == pytest.approx(abs(area), rel=2e-4)
    got = np.array([(coverage * x).sum(), (coverage * y).sum()]) / coverage.sum()
    np.testing.assert_allclose(got, centroid, atol=0.01)


def test_nearer_target_hides_the_farther_one() -> None:
    layout, camera = PixelLayout(ColorModel.MONO), default_camera(320, 240)
    white, black = (TargetImage(n, np.full((60, 80), v, np.uint8), WIDTH_M) for n, v in (("w", 255), ("b", 0)))
    near, far = (RigidTransform(np.eye(3), np.array([0.0, 0.0, z])) for z in (0.1, 0.0))
    for poses, expected in (((near, far), 1.0), ((far, near), 0.0)):
        image = Renderer(Scene((white, black), poses, 0.1), camera, layout).radiance(pose_of(VIEWS[0]))
        assert image[120, 160] == pytest.approx(expected, abs=1e-6)


def test_target_across_the_image_border_and_behind_the_camera() -> None:
    camera = default_camera(320, 240)
    white = arrange_scene([TargetImage("t", np.full((60, 80), 255, np.uint8), 4.0)])
    renderer = Renderer(white, camera, PixelLayout(ColorModel.MONO))
    # A floor that reaches from before the camera to behind it.
    tilt = rotation_about(np.array([1.0, 0.0, 0.0]), math.radians(75))
    image = renderer.radiance(RigidTransform(tilt @ FACING, np.array([0.0, 0.3, 0.5])))
    assert np.isfinite(image).all()
    assert 0 <= image.min() <= image.max() <= 1
    with pytest.raises(ShapeError, match="in front"):
        renderer.radiance(RigidTransform(FACING, np.array([0.0, 0.0, -0.5])))


@pytest.mark.parametrize("model", DistortionModel)
def test_lens_inverse_agrees_with_the_camera(model: DistortionModel) -> None:
    camera = default_camera(640, 480, model, TYPICAL_LENSES[model])
    m = PixelGrid(camera).plane_map(np.eye(3), slice(0, 480, 7), slice(0, 640, 11))
    x, y = np.meshgrid(np.arange(0, 640, 11.0), np.arange(0, 480, 7.0))
    ideal, valid = camera.ideal_pixels(np.column_stack((x.ravel(), y.ravel())))
    assert valid.all()
    np.testing.assert_allclose(np.column_stack((m.u.ravel(), m.v.ravel())), ideal, atol=1e-4)


def test_lens_without_inverse_is_refused() -> None:
    camera = default_camera(640, 480, "plumb_bob", [-2.0, 0, 0, 0, 0])
    with pytest.raises(ShapeError, match="no inverse"):
        PixelGrid(camera)


def test_layouts_that_cannot_be_rendered_are_refused() -> None:
    scene = arrange_scene([TargetImage("t", np.zeros((60, 80), np.uint8), WIDTH_M)])
    with pytest.raises(ShapeError, match="layout"):
        Renderer(scene, default_camera(320, 240), PixelLayout(ColorModel.YUYV))
