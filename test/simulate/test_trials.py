# SPDX-License-Identifier: Apache-2.0
"""Frames under every condition, with their truth; pictures that look alike; frames without a target."""

from __future__ import annotations

import itertools
from dataclasses import replace

import cv2
import numpy as np
import pytest

from imgu_ros.errors import ParameterError, ShapeError
from imgu_ros.simulate.capture import Capture
from imgu_ros.simulate.conditions import CONDITIONS, PLAIN, Condition, SceneContent, condition_named
from imgu_ros.simulate.negatives import absent_frames
from imgu_ros.simulate.pictures import look_alike, repeated_picture
from imgu_ros.simulate.placing import Placing
from imgu_ros.simulate.sequence import Simulation, simulate_sequence
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.simulate.trials import LAP_FRAMES, Trial, known_targets, trial_batches, trial_frames
from imgu_ros.vision.formation.cfa import BayerPattern, site_mask
from imgu_ros.vision.formation.transfer import decode_light

SMALL = Trial(PLAIN, 320, 180, frames=2, seed=1)


def pixels(trial: Trial) -> list[np.ndarray]:
    return [simulated.frame.image.pixels for simulated in trial_frames(trial)]


def target_mask(trial: Trial) -> np.ndarray:
    """Pixels of the first frame well inside the target."""
    (simulated, *_) = trial_frames(replace(trial, frames=1))
    height, width = known_targets(trial)[0].pixels.shape[:2]
    full = np.full((height, width), 255, np.uint8)
    shown = cv2.warpPerspective(full, simulated.truths[0].H, (trial.width, trial.height))
    return cv2.erode(shown, np.ones((9, 9))) == 255


@pytest.mark.parametrize("condition", CONDITIONS, ids=lambda c: c.name)
def test_every_condition_makes_frames_with_truth(condition: Condition) -> None:
    count = {SceneContent.ABSENT: 0, SceneContent.TWO_COPIES: 2, SceneContent.LOOK_ALIKES: 2}.get(condition.show, 1)
    names = {target.name for target in known_targets(replace(SMALL, condition=condition))}
    for unrelated in (False, True):
        trial = replace(SMALL, condition=condition, frames=1, unrelated=unrelated)
        (simulated,) = trial_frames(trial)
        assert simulated.frame.image.pixels.shape == (180, 320)
        assert simulated.frame.image.pixels.dtype == np.uint8
        assert simulated.frame.image.pixels.std() > 3
        assert len(simulated.truths) == count
        assert {truth.target for truth in simulated.truths} <= names


def test_names_are_unique_and_found() -> None:
    assert len({c.name for c in CONDITIONS}) == len(CONDITIONS)
    assert condition_named("occlusion-40").occluded == 0.4
    with pytest.raises(ParameterError, match="nearest known: occlusion-40"):
        condition_named("oclusion-40")


def test_plain_sequence_is_that_of_the_simulation() -> None:
    # The path of `simulate_sequence`, whose own tests say that it is right.
    trial = Trial(PLAIN, 320, 180, frames=3, seed=4)
    simulation = Simulation(320, 180, frames=LAP_FRAMES, rate_hz=30.0, seed=4)
    for ours, theirs in zip(trial_frames(trial), simulate_sequence(simulation, known_targets(trial)), strict=False):
        np.testing.assert_allclose(ours.truths[0].H, theirs.truths[0].H, atol=1e-12)
        difference = ours.frame.image.pixels.astype(float) - theirs.frame.image.pixels
        assert abs(difference.mean()) < 0.1 and difference.std() < 4  # noise


def test_same_trial_same_frames_and_single_frames_are_unrelated() -> None:
    for trial in (SMALL, replace(SMALL, unrelated=True)):
        for a, b in zip(pixels(trial), pixels(trial), strict=True):
            np.testing.assert_array_equal(a, b)
        batches = list(trial_batches(replace(trial, frames=5), 2))
        assert [len(batch) for batch in batches] == [2, 2, 1]
        np.testing.assert_array_equal(batches[0][1].frame.image.pixels, pixels(trial)[1])
    near = [s.truths[0].pose for s in trial_frames(SMALL)]
    far = [s.truths[0].pose for s in trial_frames(replace(SMALL, unrelated=True))]
    assert near[0] is not None and near[1] is not None and far[0] is not None and far[1] is not None
    assert np.trace(near[0].R @ near[1].R.T) > 2.9 > np.trace(far[0].R @ far[1].R.T)


def test_exposure_doubles_or_halves() -> None:
    trial = replace(SMALL, condition=condition_named("exposure-steps"), frames=12)
    mask = target_mask(trial)
    means = [np.median(frame[~mask & (frame < 250)]) for frame in pixels(trial)]
    quotients = [b / a for a, b in itertools.pairwise(means)]
    np.testing.assert_allclose(np.array(quotients)[[2, 5, 8]], [2, 0.5, 0.5], rtol=0.12)
    np.testing.assert_allclose(np.delete(quotients, [2, 5, 8]), 1, rtol=0.12)


def test_signal_to_noise_on_the_target() -> None:
    trial = replace(SMALL, condition=condition_named("noise-snr-10"), frames=1)
    mask = target_mask(trial)
    noiseless = replace(trial.condition, snr=3000.0)
    (noisy,), (clean,) = pixels(trial), pixels(replace(trial, condition=noiseless))
    residual = noisy.astype(float) - clean
    bright = mask & (np.abs(clean.astype(float) - clean[mask].mean()) < 8)  # where the light is the mean
    assert bright.sum() > 300
    assert clean[bright].mean() / residual[bright].std() == pytest.approx(10, rel=0.15)


def test_sensitivities_scale_the_channels() -> None:
    (plain,), (raw,) = (
        pixels(replace(SMALL, condition=condition, frames=1))
        for condition in (PLAIN, condition_named("no-white-balance"))
    )
    for color, sensitivity in zip("rgb", (0.5, 1.0, 0.65), strict=True):
        sites = site_mask(plain.shape, BayerPattern.RGGB, color)
        assert raw[sites].mean() / plain[sites].mean() == pytest.approx(sensitivity, rel=0.01)


@pytest.mark.parametrize("transfer", ["srgb", "film"])
def test_transfer_functions_are_undone_by_their_inverses(transfer: str) -> None:
    (plain,), (encoded,) = (
        pixels(replace(SMALL, condition=condition, frames=1))
        for condition in (PLAIN, condition_named(f"transfer-{transfer}"))
    )
    # The noise is the same: only quantisation differs, by half a step of each and the slope of the inverse, up to 5.
    difference = 255 * decode_light(encoded / 255, transfer) - plain
    assert np.abs(difference).max() < 3.1 and abs(difference.mean()) < 0.1
    assert encoded.mean() > 1.3 * plain.mean()


@pytest.mark.parametrize("percent", [2, 10, 30])
def test_saturated_share_of_every_frame(percent: int) -> None:
    trial = replace(SMALL, condition=condition_named(f"saturated-{percent}"))
    for simulated in trial_frames(trial):
        assert np.mean(simulated.frame.image.pixels == 255) == pytest.approx(percent / 100, abs=0.003)
        assert simulated.exposure > 1


def test_conditions_take_every_capture() -> None:
    """What `imgu simulate` can set is part of a condition, beside everything else."""
    capture = Capture(exposure_s=0.01, defocus_px=2.0, ev=(-1.0,), sensitivities=(0.5, 1.0, 0.65))
    condition = replace(condition_named("rolling-shutter"), capture=capture)
    (simulated,) = trial_frames(replace(SMALL, condition=condition, frames=1))
    (plain,) = trial_frames(replace(SMALL, frames=1))
    assert simulated.exposure == pytest.approx(0.45) and plain.exposure == pytest.approx(0.9)
    means = [s.frame.image.pixels[::2, 1::2].mean() for s in (simulated, plain)]
    assert means[0] / means[1] == pytest.approx(0.5, rel=0.02)
    with pytest.raises(ParameterError, match="saturated"):
        next(trial_frames(replace(SMALL, condition=replace(PLAIN, capture=Capture(saturated=2.0)))))


def test_rolling_shutter_bends_and_leaves_the_middle() -> None:
    trial = replace(SMALL, frames=1, condition=replace(PLAIN, placing=Placing(width_share=1.0, tilt_rad=0.0)))
    slow = replace(trial, condition=replace(trial.condition, readout=1.0))
    (rolled,), (plain,) = pixels(slow), pixels(trial)
    change = np.abs(rolled.astype(float) - plain).mean(axis=1)
    # Over the frame period the camera rolls by 3 degrees; the middle row's exposure is the truth's.
    assert change[88:92].mean() < 3 < 15 < change[[*range(10), *range(170, 180)]].mean()


def test_repeated_picture_repeats() -> None:
    picture = repeated_picture(500, 400, seed=3)
    tiles = [picture[100 * r : 100 * r + 100, 100 * c : 100 * c + 100] for r in range(4) for c in range(5)]
    alike = max(sum(np.array_equal(a, b) for b in tiles) for a in tiles)
    assert alike == 16
    with pytest.raises(ShapeError, match="picture size"):
        repeated_picture(40, 40)


def test_look_alike_shares_the_header() -> None:
    picture = procedural_texture(160, 120, 0)
    other = look_alike(picture, 1, 0.25)
    np.testing.assert_array_equal(other[:30], picture[:30])
    assert (other[30:] != picture[30:]).mean() > 0.9
    with pytest.raises(ShapeError, match="shared"):
        look_alike(picture, 1, 1.5)
    with pytest.raises(ShapeError, match="picture"):
        look_alike(picture[:, :, 0], 1)


def test_absent_frames_show_photographs() -> None:
    photographs = [procedural_texture(300, 200, s) for s in (1, 2)]
    target = procedural_texture(160, 120, 0)
    frames = list(absent_frames(photographs, target, (320, 180), 4, seed=2))
    again = list(absent_frames(photographs, target, (320, 180), 4, seed=2))
    for a, b in zip(frames, again, strict=True):
        assert a.truths == ()
        assert a.frame.image.pixels.shape == (180, 320)
        assert a.frame.image.pixels.std() > 10  # never blank
        np.testing.assert_array_equal(a.frame.image.pixels, b.frame.image.pixels)
    assert len({f.frame.stamp_ns for f in frames}) == 4
    with pytest.raises(ShapeError, match="photographs: none"):
        next(absent_frames([], target, (320, 180), 1))
    with pytest.raises(ShapeError, match="photograph"):
        next(absent_frames([photographs[0][:, :, 0]], target, (320, 180), 1))
