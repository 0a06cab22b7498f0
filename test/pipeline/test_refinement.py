# SPDX-License-Identifier: Apache-2.0
"""Alignment of a target with simulated frames, from homographies that are wrong by known amounts."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import pytest

from imgu_ros.config.parameters import DemosaicParameters, Parameters, RawParameters, RefinementParameters
from imgu_ros.errors import EstimationError, NoConsensus
from imgu_ros.image.frame_image import develop
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.templates import TargetImage
from imgu_ros.simulate.sequence import TYPICAL_LENSES, Simulation, default_camera, simulate_sequence
from imgu_ros.simulate.truth import corner_error
from imgu_ros.track.patch_alignment import PatchAlignment, align_patches
from imgu_ros.types import Image, Matrix3, Points
from imgu_ros.vision.camera.distortion_model import DistortionModel
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage
from imgu_ros.vision.projective.transform import transform

SIZE = (640, 480)
MONO = PixelLayout(ColorModel.MONO, None)
LENSES = ["none", "plumb_bob", "equidistant"]


@dataclass(frozen=True)
class View:
    """What the camera saw, the homography in ideal px, and the camera when its lens distorts."""

    pixels: Image
    H: Matrix3
    lens: Camera | None


def views_of(image: TargetImage, lens: str = "none") -> list[View]:
    """Three frames that have little to do with each other."""
    model = DistortionModel.PLUMB_BOB if lens == "none" else DistortionModel(lens)
    camera = default_camera(*SIZE, model, () if lens == "none" else TYPICAL_LENSES[model])
    simulation = Simulation(*SIZE, frames=3, seed=3, layout=MONO, camera=camera)
    return [
        View(s.frame.image.pixels, s.truths[0].H, camera if camera.is_distorted else None)
        for s in simulate_sequence(simulation, [image])
    ]


@pytest.fixture(scope="module")
def views(target_images: tuple[TargetImage, ...]) -> dict[str, list[View]]:
    return {lens: views_of(target_images[0], lens) for lens in LENSES}


@pytest.fixture(scope="module")
def others(target_images: tuple[TargetImage, ...]) -> list[View]:
    """Another target at the same places."""
    return views_of(target_images[1])


@pytest.fixture
def target(targets: tuple[Reference, ...]) -> Reference:
    return targets[0]


def aligned(
    pixels: Image,
    target: Reference,
    H: Matrix3,
    reach_px: float,
    lens: Camera | None = None,
    min_points: int = 8,
    parameters: RefinementParameters | None = None,
) -> PatchAlignment:
    pictures = develop(RawImage(pixels, MONO), RawParameters(), DemosaicParameters())
    parameters = parameters or Parameters().refinement
    return align_patches(pictures, target, H, lens, parameters, min_points, reach_px)


def with_corners_moved(H: Matrix3, target: Reference, by: Points) -> Matrix3:
    outline = target.outline_template
    moved = (transform(H, outline) + by).astype(np.float32)
    return cv2.getPerspectiveTransform(outline.astype(np.float32), moved)


def wrong(H: Matrix3, target: Reference, px: float, seed: int = 0) -> Matrix3:
    """Every corner so far off, each in a direction of its own."""
    angle = np.random.default_rng(seed).uniform(0, 2 * np.pi, 4)
    return with_corners_moved(H, target, px * np.column_stack((np.cos(angle), np.sin(angle))))


def error_px(found: PatchAlignment, view: View, target: Reference) -> float:
    return corner_error(found.homography.H, view.H, target.size, SIZE, view.lens)


def sigma_px(found: PatchAlignment, target: Reference) -> float:
    """The largest standard deviation of a corner that the covariance tells, by propagation."""
    H, outline = found.homography.H, target.outline_template
    rows = np.column_stack((outline, np.ones(4)))
    out = []
    for row, (x, y), w in zip(rows, transform(H, outline), rows @ H[2], strict=True):
        J = np.zeros((2, 9))
        J[0, :3] = J[1, 3:6] = row / w
        J[0, 6:], J[1, 6:] = -x * row / w, -y * row / w
        out.append(np.sqrt(np.trace(J @ found.homography.covariance @ J.T)))
    return float(max(out))


def require_honest(found: PatchAlignment, view: View, target: Reference) -> None:
    """Its error is none that its covariance would not allow."""
    assert error_px(found, view, target) < 5 * sigma_px(found, target) + 0.05


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("px", [0.0, 1.0, 5.0])
def test_wrong_by_some_pixels(views: dict[str, list[View]], target: Reference, lens: str, px: float) -> None:
    for seed, view in enumerate(views[lens]):
        found = aligned(view.pixels, target, wrong(view.H, target, px, seed), max(1.5 * px, 2.0), view.lens)
        assert error_px(found, view, target) < 0.1
        assert found.halvings == 0 and len(found.template_xy) > 0.9 * found.sought
        require_honest(found, view, target)
        # Raw pixels: where the lens puts what the homography says.
        ideal = transform(view.H, found.template_xy)
        raw = ideal if view.lens is None else view.lens.raw_pixels(ideal)
        assert np.median(np.abs(found.image_xy - raw)) < 0.15


@pytest.mark.parametrize("degrees", [-4.0, 4.0, 8.0, 20.0])
def test_rolled(views: dict[str, list[View]], target: Reference, degrees: float) -> None:
    """A few degrees are bridged; of more, what is found is right."""
    a = np.radians(degrees)
    R = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
    for view in views["none"]:
        corners = transform(view.H, target.outline_template)
        away = corners - corners.mean(axis=0)
        H = with_corners_moved(view.H, target, away @ R.T - away)
        try:
            found = aligned(view.pixels, target, H, 24.0)
        except EstimationError:
            assert abs(degrees) > 4
        else:
            assert error_px(found, view, target) < 0.1


def test_half_of_the_target_is_covered(views: dict[str, list[View]], others: list[View], target: Reference) -> None:
    for view, other in zip(views["none"], others, strict=True):
        a, b, c, d = transform(view.H, target.outline_template)
        half = np.zeros(view.pixels.shape, np.uint8)
        cv2.fillConvexPoly(half, np.rint([a, (a + b) / 2, (c + d) / 2, d]).astype(np.int32), 1)
        pixels = np.where(half > 0, np.roll(other.pixels, 40, axis=1), view.pixels)
        found = aligned(pixels, target, wrong(view.H, target, 1.0), 3.0)
        # What is extrapolated is less certain, and said to be.
        assert error_px(found, view, target) < 0.4
        assert sigma_px(found, target) > 1.3 * sigma_px(aligned(view.pixels, target, view.H, 3.0), target)
        require_honest(found, view, target)
        covered = half[tuple(np.rint(found.image_xy[:, ::-1]).astype(int).T)]
        assert covered.mean() < 0.05


@pytest.mark.parametrize("gain", [0.5, 2.0])
def test_exposure_halved_and_doubled(views: dict[str, list[View]], target: Reference, gain: float) -> None:
    for view in views["none"]:
        pixels = np.clip(gain * view.pixels.astype(np.float64), 0, 255).astype(np.uint8)
        found = aligned(pixels, target, wrong(view.H, target, 1.5), 3.0)
        assert error_px(found, view, target) < 0.12
        require_honest(found, view, target)


@pytest.mark.parametrize("length", [6, 10, 16, 40])
@pytest.mark.parametrize("upright", [False, True])
def test_motion_blur(views: dict[str, list[View]], target: Reference, length: int, upright: bool) -> None:
    """Light blur costs some accuracy, which the covariance knows; of heavy blur nothing wrong is told."""
    kernel = np.full((1, length + 1), 1 / length)
    kernel[0, [0, -1]] /= 2
    for view in views["none"]:
        pixels = cv2.filter2D(view.pixels, -1, kernel.T if upright else kernel, borderType=cv2.BORDER_REFLECT)
        try:
            found = aligned(pixels, target, wrong(view.H, target, 2.0), 6.0)
        except EstimationError:
            assert length > 6
            continue
        require_honest(found, view, target)
        assert length == 40 or error_px(found, view, target) < (0.2 if length == 6 else 2.0)
        assert sigma_px(found, target) > sigma_px(aligned(view.pixels, target, view.H, 2.0), target)


def test_where_full_resolution_shows_nothing_a_reduced_picture_counts(
    views: dict[str, list[View]], target: Reference
) -> None:
    """Defocus takes the fine texture away; what is left is in the picture halved."""
    halvings = []
    for view in views["none"]:
        for sigma in (3.0, 6.0):
            try:
                found = aligned(cv2.GaussianBlur(view.pixels, (0, 0), sigma), target, wrong(view.H, target, 2.0), 12.0)
            except EstimationError:
                continue
            halvings.append(found.halvings)
            require_honest(found, view, target)
            assert error_px(found, view, target) < 3.0
    assert len(halvings) >= 3 and max(halvings) > 0


def test_another_texture_is_refused(views: dict[str, list[View]], others: list[View], target: Reference) -> None:
    noise = np.random.default_rng(1).integers(0, 256, (480, 640), np.uint8)
    for view, other in zip(views["none"], others, strict=True):
        for pixels in (other.pixels, noise, np.full_like(noise, 120), cv2.GaussianBlur(noise, (0, 0), 4)):
            for reach in (2.0, 24.0):
                with pytest.raises(EstimationError, match="need"):
                    aligned(pixels, target, view.H, reach)


def test_what_is_asked_for_is_needed(views: dict[str, list[View]], target: Reference) -> None:
    view = views["none"][0]
    few = aligned(view.pixels, target, view.H, 2.0, parameters=RefinementParameters(max_points=40))
    assert 30 < len(few.template_xy) <= few.sought == 40
    wide = aligned(view.pixels, target, view.H, 2.0, parameters=RefinementParameters(window_px=21))
    assert error_px(wide, view, target) < 0.1
    with pytest.raises(NoConsensus, match="need 1000"):
        aligned(view.pixels, target, view.H, 2.0, min_points=1000)


@pytest.mark.parametrize("shift", [700.0, -5000.0])
def test_a_target_out_of_view_is_refused(views: dict[str, list[View]], target: Reference, shift: float) -> None:
    for lens in LENSES:
        view = views[lens][0]
        away = np.array([[1, 0, shift], [0, 1, 0], [0, 0, 1]]) @ view.H
        with pytest.raises(EstimationError, match="in view"):
            aligned(view.pixels, target, away, 4.0, view.lens)
    # The vanishing line across the target, and the target behind the camera.
    view = views["none"][0]
    across = view.H + np.array([[0, 0, 0], [0, 0, 0], [-view.H[2, 2] / 600, 0, 0]])
    for H in (across, -view.H):
        with pytest.raises(EstimationError):
            aligned(view.pixels, target, H, 4.0)
