# SPDX-License-Identifier: Apache-2.0
"""Which targets are looked for, and how thoroughly."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

import imgu_ros.detect.detector as seeking
from imgu_ros.config.components import DevelopmentParameters
from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.detect.features import find_features
from imgu_ros.detect.frame_context import FrameContext
from imgu_ros.detect.search_passes import SearchPass
from imgu_ros.frame import Frame
from imgu_ros.image.frame_image import develop, develop_frame
from imgu_ros.localizer import Localizer
from imgu_ros.reference.features import extractor_options, thorough_parameters
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.result import StageClock, Status
from imgu_ros.simulate.conditions import condition_named
from imgu_ros.simulate.sequence import SimulatedFrame, default_targets
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.simulate.trials import Trial, known_targets, trial_frames
from imgu_ros.simulate.truth import corner_error
from imgu_ros.vision.descriptors.extractor import make_extractor
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage
from imgu_ros.vision.projective.transform import transform

ALONE = {"tracking.enabled": False}


@pytest.fixture(scope="module")
def many(target_images: tuple[TargetImage, ...]) -> tuple[TargetImage, ...]:
    """Ten targets; the fifth and the ninth are those in view."""
    absent = [TargetImage(f"absent_{i}", procedural_texture(480, 360, 900 + i), 0.3) for i in range(8)]
    return (*absent[:4], target_images[0], *absent[4:7], target_images[1], absent[7])


def test_two_of_ten(
    many: tuple[TargetImage, ...], two_target_frames: tuple[SimulatedFrame, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    parameters = parameters_from(ALONE)
    chain = Localizer(parameters, prepare_references(many, parameters))
    looked_for = []
    search = seeking.search
    monkeypatch.setattr(
        seeking, "search", lambda target, *rest: looked_for.append(target.name) or search(target, *rest)
    )
    for simulated in two_target_frames[::2]:
        result = chain.process(simulated.frame)
        assert [t.name for t in result] == [t.name for t in many]
        found = [i for i, t in enumerate(result) if t.status.found]
        assert found == [4, 8]
        not_sought = [t for t in result if t.status is Status.LOST]
        assert all(t.reason for t in not_sought)
    # Each of the three looks may fail three times before the less likely ones are left.
    assert len(looked_for) <= 3 * (2 + 3 * 3)


def test_few_targets_are_all_looked_for(two_target_frames: tuple[SimulatedFrame, ...], targets: tuple) -> None:
    results = [Localizer(parameters_from(ALONE), targets).process(two_target_frames[0].frame) for _ in range(2)]
    assert [t.status for t in results[0]] == [Status.DETECTED] * 2
    for a, b in zip(results[0], results[1], strict=True):
        np.testing.assert_array_equal(a.homography.H, b.homography.H)


@pytest.mark.parametrize("condition", ["tilt-60", "size-10", "size-300"])
def test_a_second_look_finds_what_a_first_look_does_not(condition: str) -> None:
    trial = Trial(condition_named(condition), 1280, 720, 3, seed=2, unrelated=True)
    counts = []
    for thorough in (True, False):
        parameters = parameters_from({**ALONE, "search.thorough": thorough})
        chain = Localizer(parameters, prepare_references(known_targets(trial), parameters))
        chain.prepare()
        counts.append(sum(chain.process(f.frame).first.status.found for f in trial_frames(trial)))
    assert counts[0] == 3 >= counts[1]


@pytest.mark.parametrize("reduced", [1, 2])
def test_a_target_that_is_near_needs_no_thorough_search(reduced: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three times as wide as a frame of 1080p, by a picture of 1280 px and by one of 640."""
    trial = Trial(condition_named("size-300"), 1920, 1080, 2, unrelated=True)
    known = known_targets(trial)[0]
    picture = cv2.resize(known.pixels, None, fx=1 / reduced, fy=1 / reduced, interpolation=cv2.INTER_AREA)
    parameters = parameters_from(ALONE)
    chain = Localizer(parameters, prepare_references([TargetImage(known.name, picture, known.width_m)], parameters))
    looks = []
    search = seeking.search
    monkeypatch.setattr(seeking, "search", lambda t, which, *rest: looks.append(which) or search(t, which, *rest))
    shift = reduced / 2 - 0.5
    full_from_reduced = np.array([[reduced, 0, shift], [0, reduced, shift], [0, 0, 1]])
    for simulated in trial_frames(trial):
        looks.clear()
        result = chain.process(simulated.frame).first
        assert result.status is Status.DETECTED, result.reason
        assert looks == [SearchPass.FIRST, SearchPass.CLOSE]
        true = simulated.truths[0].H @ full_from_reduced
        size = picture.shape[1], picture.shape[0]
        assert corner_error(result.homography.H, true, size, (1920, 1080), simulated.frame.camera) < 1.0
        # Matches, which no patch has improved, lie where the truth says, to a part of a template px on average.
        agreed = result.matches.inliers
        assert agreed.sum() >= 12
        aside = transform(np.linalg.inv(true), result.matches.image_xy[agreed]) - result.matches.template_xy[agreed]
        assert np.abs(np.median(aside, axis=0)).max() < 0.25
        assert (result.matches.matches.index_src[agreed] == -1).all()


def test_what_was_found_is_not_looked_at_again(targets: tuple, two_target_frames: tuple[SimulatedFrame, ...]) -> None:
    """With the first target's place covered, none of its keypoints is left."""
    simulated = two_target_frames[0]
    parameters = parameters_from(ALONE)
    result = Localizer(parameters, targets[:1]).process(simulated.frame, with_keypoints=True)
    outline = result.first.outline
    extractor = make_extractor(extractor_options(parameters))
    context = FrameContext(
        simulated.frame,
        develop_frame(simulated.frame, DevelopmentParameters.of(parameters)),
        lambda image, clock: find_features(image, parameters, extractor, clock),
    )
    again = list(seeking.ReferenceDetector(targets, parameters).detect(context, targets, [outline], thorough=False))
    assert {r.number: r.status.found for r in again} == {0: False, 1: True}


@pytest.mark.parametrize("size", [(640, 480), (1280, 720), (1281, 723), (1920, 1080), (1923, 1085), (3001, 2000)])
def test_keypoints_of_a_reduced_frame_lie_where_they_are(size: tuple[int, int]) -> None:
    """A textured rectangle on a flat ground, whatever the reduction: they reach its edges, and nowhere beyond."""
    width, height = size
    low, high = np.array([width // 5, height // 4]), np.array([4 * width // 5, 3 * height // 4])
    texture = np.random.default_rng(1).integers(0, 256, (27, 48), np.uint8)
    pixels = np.full((height, width), 100, np.uint8)
    pixels[low[1] : high[1], low[0] : high[0]] = cv2.resize(
        texture, tuple((high - low).tolist()), interpolation=cv2.INTER_CUBIC
    )
    raw = RawImage(pixels, PixelLayout(ColorModel.MONO))
    parameters = parameters_from({})
    for p in (parameters, thorough_parameters(parameters)):
        pictures = develop(raw, p.raw, p.demosaic)
        features = find_features(pictures, p, make_extractor(extractor_options(p)), StageClock())
        assert max(features.pyramid.levels[0].image.shape) <= p.pyramid.max_side_px
        keypoints = features.described.keypoints
        xy = keypoints.xy[keypoints.octave == 0]
        tile, unit = (high - low) / (48, 27), features.unit_px
        assert (xy >= low - 3 * unit).all() and (xy <= high - 1 + 3 * unit).all()
        assert (xy.min(axis=0) <= low + 3 * tile).all() and (xy.max(axis=0) >= high - 3 * tile).all()


def test_default_targets_are_known_apart() -> None:
    """The index names the target whose own descriptors are asked for."""
    parameters = parameters_from({})
    images = [TargetImage(t.name, t.pixels[::3, ::3].copy(), t.width_m) for t in default_targets(5, 40)]
    targets = prepare_references(images, parameters)
    index = seeking.build_index([t.features.described.descriptors for t in targets])
    for number, target in enumerate(targets):
        assert index.votes(target.features.described.descriptors).argmax() == number


def test_a_dull_target_among_strong_corners() -> None:
    """Checkers about it have more and stronger corners than a frame has keypoints."""
    rng = np.random.default_rng(11)
    dull = cv2.resize(rng.normal(0, 1, (60, 80)).astype(np.float32), (640, 480), interpolation=cv2.INTER_CUBIC)
    target = np.repeat(np.uint8(np.clip(95 + 9 * dull, 0, 255))[..., None], 3, axis=2)
    scene = np.kron(rng.integers(0, 2, (80, 107)) * 255, np.ones((6, 6)))[:480, :640].astype(np.uint8)
    H = np.array([[0.27, -0.1, 260.0], [0.1, 0.27, 130.0], [0.0, 0.0, 1.0]])
    cv2.warpPerspective(target[..., 0], H, (640, 480), scene, cv2.INTER_AREA, cv2.BORDER_TRANSPARENT)
    noisy = np.clip(cv2.GaussianBlur(scene, (0, 0), 0.6) + rng.normal(0, 1.5, scene.shape), 0, 255).astype(np.uint8)
    frame = Frame(RawImage(noisy, PixelLayout(ColorModel.MONO)), 0, "camera", None)
    result = Localizer(Parameters(), prepare_references([TargetImage("dull", target, 0.3)], Parameters()))
    found = result.process(frame).first
    assert found.homography is not None, found.reason
    assert corner_error(found.homography.H, H, (640, 480), (640, 480)) < 1.0
