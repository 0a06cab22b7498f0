# SPDX-License-Identifier: Apache-2.0
"""Patches of a target in one picture of a frame: which are sought, where they are found, and what is made of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from imgu_ros.config.parameters import DemosaicParameters, PoseParameters, RawParameters
from imgu_ros.errors import EstimationError, NoConsensus
from imgu_ros.image.frame_image import FrameImage, develop
from imgu_ros.reference.planar import PlanarReference
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.templates import LightTemplates, TargetImage, TemplatePyramids, Templates
from imgu_ros.simulate.sequence import TYPICAL_LENSES, SimulatedFrame, Simulation, default_camera, simulate_sequence
from imgu_ros.simulate.truth import corner_error
from imgu_ros.track import patch_squares
from imgu_ros.track.patch_alignment import AlignmentOptions, LevelAlignment
from imgu_ros.types import Image
from imgu_ros.vision.camera.distortion_model import DistortionModel
from imgu_ros.vision.formation.layout import RawImage
from imgu_ros.vision.projective.transform import transform

SIZE = (640, 480)
EFFORT = AlignmentOptions(window_px=11, most=200, fewest=8, steps=8, enough_px=0.1)


def pictures_of(frame: SimulatedFrame, pixels: Image | None = None) -> FrameImage:
    image = frame.frame.image
    raw = RawImage(image.pixels if pixels is None else pixels, image.layout)
    return develop(raw, RawParameters(), DemosaicParameters())


def shifted(H: np.ndarray, x: float, y: float) -> np.ndarray:
    return np.array([[1, 0, x], [0, 1, y], [0, 0, 1]]) @ H


@pytest.fixture
def target(targets: tuple[Reference, ...]) -> Reference:
    return targets[0]


@pytest.fixture
def frame(one_target_frames: tuple[SimulatedFrame, ...]) -> SimulatedFrame:
    return one_target_frames[0]


@pytest.mark.parametrize("halvings", [0, 1, 2])
def test_found_at_every_resolution(frame: SimulatedFrame, target: Reference, halvings: int) -> None:
    H = frame.truths[0].H
    start = shifted(H, 1.5 * 2**halvings, -(2**halvings))
    found = LevelAlignment(pictures_of(frame), halvings, target, start, None, EFFORT)
    assert corner_error(found.H, H, target.size, SIZE) < 0.01 * 4**halvings
    assert found.agreeing > 0.9 * found.sought


def test_correspondences_are_those_of_the_truth(frame: SimulatedFrame, target: Reference) -> None:
    H = frame.truths[0].H
    found = LevelAlignment(pictures_of(frame), 0, target, shifted(H, 1.0, 1.0), None, EFFORT)
    result = found.result(8)
    template, ideal = result.template_xy, result.image_xy
    assert len(template) == len(ideal) == np.count_nonzero(result.homography.inliers)
    assert 0.9 * found.agreeing < len(template) <= result.sought and result.agreeing_share == len(template) / 200
    assert_allclose(np.median(np.abs(transform(H, template) - ideal)), 0, atol=0.1)
    width, height = target.size
    assert (template >= 0).all() and (template <= (width - 1, height - 1)).all()
    assert result.homography is result.normal_equations.estimate
    assert corner_error(result.homography.H, H, target.size, SIZE) < 0.02
    with pytest.raises(NoConsensus, match="need 201"):
        found.result(201)


@pytest.mark.parametrize("model", [None, DistortionModel.PLUMB_BOB, DistortionModel.EQUIDISTANT])
def test_squares_of_the_mosaic_show_what_the_picture_shows(
    target: Reference, target_images: tuple, model: DistortionModel | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    lens = None if model is None else default_camera(1280, 720, model, TYPICAL_LENSES[model])
    simulation = Simulation(1280, 720, frames=1, seed=3, camera=lens)
    frame = next(simulate_sequence(simulation, target_images[:1]))
    H = shifted(frame.truths[0].H, 1.2, -0.7)
    developed: list[bool] = []
    whole = FrameImage.halved
    monkeypatch.setattr(FrameImage, "halved", lambda self, times: developed.append(True) or whole(self, times))
    of_squares = LevelAlignment(pictures_of(frame), 0, target, H, lens, EFFORT)
    assert not developed
    monkeypatch.setattr(patch_squares, "_SHEET_SHARE", 0.0)
    of_picture = LevelAlignment(pictures_of(frame), 0, target, H, lens, EFFORT)
    assert developed
    assert corner_error(of_squares.H, of_picture.H, target.size, (1280, 720), lens) < 0.005
    assert corner_error(of_squares.H, frame.truths[0].H, target.size, (1280, 720), lens) < 0.025
    assert of_squares.sought == of_picture.sought


def test_a_target_partly_out_of_view(frame: SimulatedFrame, target: Reference) -> None:
    """Of what is left of it in view, patches are found, all of them in the picture."""
    H, pixels = frame.truths[0].H, frame.frame.image.pixels
    left, top = np.rint(transform(H, target.outline_template).mean(axis=0) / 2).astype(int) * 2
    for x, y in ((left, 0), (0, top)):
        cut = np.ascontiguousarray(pixels[y:, x:])
        H_cut = shifted(H, -x, -y)
        found = LevelAlignment(pictures_of(frame, cut), 0, target, shifted(H_cut, 1, 1), None, EFFORT)
        at = found.result(8).image_xy
        assert (at >= 4).all() and (at <= np.array(cut.shape[::-1]) - 5).all()
        assert corner_error(found.H, H_cut, target.size, cut.shape[::-1]) < 0.025
        assert found.agreeing > 0.9 * found.sought


def test_fewer_and_more_patches(frame: SimulatedFrame, target: Reference) -> None:
    H = frame.truths[0].H
    for most in (12, 60, 121, 200):
        found = LevelAlignment(pictures_of(frame), 0, target, shifted(H, 0.8, 0.5), None, replace(EFFORT, most=most))
        assert found.sought == most and found.agreeing > 0.9 * most
        assert corner_error(found.H, H, target.size, SIZE) < 0.04 / np.sqrt(most / 12)


def test_what_cannot_be_followed_is_refused(frame: SimulatedFrame, target: Reference) -> None:
    H, pictures = frame.truths[0].H, pictures_of(frame)
    for away in (shifted(H, 2000, 0), shifted(H, 0, -1e6), -H):
        with pytest.raises(NoConsensus, match="0 in view"):
            LevelAlignment(pictures, 0, target, away, None, EFFORT)
    with pytest.raises(NoConsensus, match="need 201"):
        LevelAlignment(pictures, 0, target, H, None, replace(EFFORT, fewest=201))
    with pytest.raises(NoConsensus, match="look alike"):
        LevelAlignment(pictures, 0, target, shifted(H, 60, 40), None, EFFORT)
    # Too small to be seen, and larger than anything.
    for scale in (1e-3, 1e4):
        x, y = transform(H, target.outline_template).mean(axis=0)
        scaled = np.array([[scale, 0, (1 - scale) * x], [0, scale, (1 - scale) * y], [0, 0, 1]]) @ H
        with pytest.raises(EstimationError):
            LevelAlignment(pictures, 0, target, scaled, None, EFFORT)
    blank = Templates(
        TemplatePyramids(TargetImage("blank", np.full((300, 400), 90, np.uint8), 0.5), (), "sampled"), max_points=150
    )
    with pytest.raises(NoConsensus, match="the target has none"):
        LevelAlignment(
            pictures,
            0,
            PlanarReference(
                0,
                target.image,
                blank,
                LightTemplates(target.image, ()),
                target.front,
                target.close,
                target.thorough,
                PoseParameters(),
            ),
            H,
            None,
            EFFORT,
        )
