# SPDX-License-Identifier: Apache-2.0
"""The search over every shift, on simulated frames."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.config.parameters import DemosaicParameters, RawParameters
from imgu_ros.errors import NoConsensus
from imgu_ros.image.frame_image import FrameImage, develop
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.templates import TargetImage
from imgu_ros.simulate.sequence import TYPICAL_LENSES, SimulatedFrame, Simulation, default_camera, simulate_sequence
from imgu_ros.track.shift_search import shifted_homography
from imgu_ros.types import Image, Matrix3
from imgu_ros.vision.camera.distortion_model import DistortionModel
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage
from imgu_ros.vision.projective.transform import transform

BAYER = PixelLayout(ColorModel.BAYER, BayerPattern.RGGB)
MODELS = [None, DistortionModel.PLUMB_BOB, DistortionModel.EQUIDISTANT]


def pictures_of(pixels: Image) -> FrameImage:
    return develop(RawImage(pixels, BAYER), RawParameters(), DemosaicParameters())


@pytest.fixture(scope="module")
def frames(target_images: tuple[TargetImage, ...]) -> dict[DistortionModel | None, SimulatedFrame]:
    out = {}
    for model in MODELS:
        camera = None if model is None else default_camera(640, 480, model, TYPICAL_LENSES[model])
        out[model] = next(simulate_sequence(Simulation(640, 480, frames=1, seed=3, camera=camera), target_images[:1]))
    return out


@pytest.fixture(scope="module")
def target(targets: tuple[Reference, ...]) -> Reference:
    return targets[0]


def middle(H: Matrix3, target: Reference) -> np.ndarray:
    width, height = target.size
    return transform(H, [[(width - 1) / 2, (height - 1) / 2]])[0]


def small_pixel_px(H: Matrix3, target: Reference) -> float:
    """The target's shorter side is compared at 30 px or so: what one of them is in the frame."""
    corners = transform(H, target.outline_template)
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).max()) / 30


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("x", [-60.0, -23.0, 0.0, 41.0, 60.0])
@pytest.mark.parametrize("y", [-50.0, 0.0, 33.0])
def test_a_shift_is_found_to_a_small_pixel(
    frames: dict[DistortionModel | None, SimulatedFrame],
    target: Reference,
    model: DistortionModel | None,
    x: float,
    y: float,
) -> None:
    frame, truth = frames[model], frames[model].truths[0].H
    start = np.array([[1, 0, x], [0, 1, y], [0, 0, 1]]) @ truth
    lens = frame.frame.camera if model is not None else None
    found = shifted_homography(pictures_of(frame.frame.image.pixels), target, start, lens, 80.0)
    away = transform(found, target.outline_template) - transform(truth, target.outline_template)
    # In the target's plane: where the shift is large, the perspective is a little another one.
    assert np.abs(away).max() < 1.5 * small_pixel_px(truth, target) + 0.1 * np.hypot(x, y)
    assert np.linalg.norm(middle(found, target) - middle(truth, target)) < small_pixel_px(truth, target)


@given(angle=st.floats(0, 2 * np.pi), length=st.floats(0, 1))
def test_every_shift_within_reach(
    frames: dict[DistortionModel | None, SimulatedFrame], target: Reference, angle: float, length: float
) -> None:
    truth = frames[None].truths[0].H
    x, y = 64 * length * np.array([np.cos(angle), np.sin(angle)])
    start = np.array([[1, 0, x], [0, 1, y], [0, 0, 1]]) @ truth
    found = shifted_homography(pictures_of(frames[None].frame.image.pixels), target, start, None, 64.0)
    assert np.linalg.norm(middle(found, target) - middle(truth, target)) < small_pixel_px(truth, target)


def test_it_is_the_same_whatever_the_light(
    frames: dict[DistortionModel | None, SimulatedFrame], target: Reference
) -> None:
    truth, pixels = frames[None].truths[0].H, frames[None].frame.image.pixels
    start = np.array([[1, 0, 30], [0, 1, -20], [0, 0, 1]]) @ truth
    for changed in ((0.4 * pixels + 60).astype(np.uint8), (0.5 * pixels).astype(np.uint8)):
        found = shifted_homography(pictures_of(changed), target, start, None, 64.0)
        assert np.linalg.norm(middle(found, target) - middle(truth, target)) < small_pixel_px(truth, target)


def test_what_lies_out_of_reach_is_not_found(
    frames: dict[DistortionModel | None, SimulatedFrame], target: Reference
) -> None:
    truth, pixels = frames[None].truths[0].H, frames[None].frame.image.pixels
    start = np.array([[1, 0, 120], [0, 1, 0], [0, 0, 1]]) @ truth
    with pytest.raises(NoConsensus, match="nothing within 30 px"):
        shifted_homography(pictures_of(pixels), target, start, None, 30.0)


def test_other_pictures_are_refused(
    frames: dict[DistortionModel | None, SimulatedFrame], targets: tuple[Reference, ...]
) -> None:
    truth, pixels = frames[None].truths[0].H, frames[None].frame.image.pixels
    noise = np.random.default_rng(2).integers(0, 256, pixels.shape, np.uint8)
    for other in (noise, np.full_like(noise, 90), np.zeros_like(noise)):
        with pytest.raises(NoConsensus, match="looks like the target"):
            shifted_homography(pictures_of(other), targets[0], truth, None, 64.0)
    # Another target where this one is said to be.
    with pytest.raises(NoConsensus, match="looks like the target"):
        shifted_homography(pictures_of(pixels), targets[1], truth, None, 64.0)
