# SPDX-License-Identifier: Apache-2.0
"""Homographies by raw samples in the pipeline: when they are used, a rolling shutter, and a camera's transfer curve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from imgu_ros.config.parameters import DemosaicParameters, Parameters, RawParameters
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import NoConsensus
from imgu_ros.image.frame_image import FrameImage, LightKind, develop
from imgu_ros.image.transfer_fit import SRGB_CURVE, TransferKind
from imgu_ros.localizer import Localizer
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.templates import TargetImage
from imgu_ros.result import Result, Status
from imgu_ros.simulate.capture import Capture
from imgu_ros.simulate.sequence import SimulatedFrame, Simulation, simulate_sequence
from imgu_ros.simulate.truth import corner_error, normalised_squared_error
from imgu_ros.track.patch_alignment import align_patches
from imgu_ros.track.sample_refinement import (
    NO_HINTS,
    AlignedPatches,
    FrameHints,
    Observation,
    has_samples,
    refined_on_samples,
)
from imgu_ros.types import Matrix3
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage
from imgu_ros.vision.formation.transfer import TransferFunction

SIZE = (640, 480)
Frames = tuple[SimulatedFrame, ...]
Targets = tuple[Reference, ...]


def image_of(simulated: SimulatedFrame, transfer: str = "auto") -> FrameImage:
    return develop(simulated.frame.image, RawParameters(transfer=transfer), DemosaicParameters())


def moved(H: Matrix3, x: float, y: float = 0.0) -> Matrix3:
    return np.array([[1, 0, x], [0, 1, y], [0, 0, 1]]) @ H


def sequence(targets: Sequence[TargetImage], capture: Capture, count: int, frames: int = 60) -> Frames:
    simulation = Simulation(*SIZE, frames=frames, seed=3, capture=capture)
    return tuple(islice(simulate_sequence(simulation, targets), count))


def processed(frames: Frames, target: Reference, values: dict[str, object] | None = None) -> list[Result]:
    localizer = Localizer(parameters_from(values or {}), [target])
    return [localizer.process(each.frame) for each in frames]


def corner_px(frames: Frames, results: list[Result], target: Reference) -> list[float]:
    found = []
    for simulated, result in zip(frames, results, strict=True):
        assert result.first.homography is not None, result.first.reason
        found.append(corner_error(result.first.homography.H, simulated.truths[0].H, target.size, SIZE))
    return found


# --- which alignment gives the result


@pytest.fixture
def target(targets: Targets) -> Reference:
    return targets[0]


def aligned(frame: SimulatedFrame, target: Reference, min_points: int = 8, transfer: str = "auto"):
    image, H = image_of(frame, transfer), moved(frame.truths[0].H, 0.7, -0.5)
    return align_patches(image, target, H, None, Parameters().refinement, min_points, 3.0)


def test_a_raw_frame_is_aligned_by_its_samples(one_target_frames: Frames, target: Reference) -> None:
    frame = one_target_frames[0]
    found = aligned(frame, target)
    assert found.samples is not None and found.sampled is not None
    assert corner_error(found.homography.H, frame.truths[0].H, target.size, SIZE) < 0.01
    samples = found.samples()
    assert len(samples.values) == len(samples.light) == len(samples.weights) > 500
    assert [samples.channels[0].start, samples.channels[-1].stop] == [0, len(samples.values)]


def test_samples_that_cannot_agree_leave_the_patches_result(one_target_frames: Frames, target: Reference) -> None:
    """More patches have to agree than give the start of the refinement on samples."""
    frame = one_target_frames[0]
    found = aligned(frame, target, min_points=80)
    assert found.samples is None and found.sampled is None
    assert np.count_nonzero(found.homography.inliers) >= 80
    assert corner_error(found.homography.H, frame.truths[0].H, target.size, SIZE) < 0.03


def test_any_failure_of_the_samples_leaves_the_patches_result(
    one_target_frames: Frames, target: Reference, monkeypatch: pytest.MonkeyPatch
) -> None:
    def disagree(*arguments: object) -> None:
        raise NoConsensus("sites: 0 patches agree; need 8")

    frame = one_target_frames[0]
    monkeypatch.setattr("imgu_ros.track.patch_alignment.refined_on_samples", disagree)
    failed = aligned(frame, target)
    monkeypatch.setattr("imgu_ros.track.patch_alignment.has_samples", lambda frame, reference: False)
    without = aligned(frame, target)
    assert failed.samples is None
    assert_array_equal(failed.homography.H, without.homography.H)
    assert_array_equal(failed.homography.covariance, without.homography.covariance)


def start(frame: SimulatedFrame, target: Reference, x: float) -> AlignedPatches:
    grid = np.stack(np.meshgrid(np.linspace(100, 1180, 8), np.linspace(100, 860, 8)), axis=-1).reshape(-1, 2)
    return AlignedPatches(moved(frame.truths[0].H, x), grid, 0, len(grid))


@pytest.mark.parametrize("x", [0.0, 0.3])
def test_a_start_is_refined(one_target_frames: Frames, target: Reference, x: float) -> None:
    frame = one_target_frames[0]
    found = refined_on_samples(image_of(frame), target, start(frame, target, x), None, 8, NO_HINTS)
    assert corner_error(found.homography.H, frame.truths[0].H, target.size, SIZE) < 0.02
    assert 0.6 < found.agreeing_share <= 1 and found.sought == 64


def test_a_start_that_is_far_off_is_refused(one_target_frames: Frames, target: Reference) -> None:
    frame = one_target_frames[0]
    with pytest.raises(NoConsensus, match="sites"):
        refined_on_samples(image_of(frame), target, start(frame, target, 5.0), None, 8, NO_HINTS)


def test_a_start_that_is_off_by_two_px_is_refined_as_well(one_target_frames: Frames, target: Reference) -> None:
    frame = one_target_frames[0]
    found = refined_on_samples(image_of(frame), target, start(frame, target, 2.0), None, 8, NO_HINTS)
    assert corner_error(found.homography.H, frame.truths[0].H, target.size, SIZE) < 0.02


def test_a_flat_frame_has_nothing_to_refine_on(one_target_frames: Frames, target: Reference) -> None:
    frame = one_target_frames[0]
    raw = RawImage(np.full_like(frame.frame.image.pixels, 90), frame.frame.image.layout)
    flat = develop(raw, RawParameters(), DemosaicParameters())
    with pytest.raises(NoConsensus, match="sites"):
        refined_on_samples(flat, target, start(frame, target, 0.0), None, 8, NO_HINTS)


# --- the samples of a frame


@pytest.mark.parametrize("pattern", BayerPattern)
def test_samples_of_a_mosaic_are_its_raw_values(pattern: BayerPattern, target: Reference) -> None:
    pixels = np.random.default_rng(0).integers(0, 1024, (12, 16)).astype(np.uint16)
    raw = RawImage(pixels, PixelLayout(ColorModel.BAYER, pattern))
    image = develop(raw, RawParameters(black_level=64, white_level=1023), DemosaicParameters())
    mosaic = image.mosaic
    assert mosaic is not None and has_samples(image, target) and image.may_have_curve
    assert_array_equal(mosaic.values, pixels)
    assert "".join("rgb"[channel] for channel in mosaic.channels) == pattern.value
    assert (mosaic.black, mosaic.white, mosaic.light) == (64, 1023, None)
    assert image.light_kind is LightKind.COLOR


def test_a_curve_gives_every_raw_value_its_light() -> None:
    pixels = np.arange(256, dtype=np.uint8).reshape(16, 16)
    raw = RawImage(pixels, PixelLayout(ColorModel.BAYER, BayerPattern.RGGB))
    image = develop(raw, RawParameters(), DemosaicParameters())
    image.curve = SRGB_CURVE
    assert image.mosaic is not None and image.mosaic.light is not None
    assert_allclose(image.mosaic.light, SRGB_CURVE.light(np.arange(256) / 255), atol=1e-6)
    # `raw.transfer: srgb` needs no earlier frames; `linear` leaves nothing open.
    told = develop(raw, RawParameters(transfer="srgb"), DemosaicParameters())
    assert told.mosaic is not None and told.mosaic.light is not None and not told.may_have_curve
    assert not develop(raw, RawParameters(transfer="linear"), DemosaicParameters()).may_have_curve


def test_samples_of_other_pictures_are_grey() -> None:
    rng = np.random.default_rng(0)
    colour = RawImage(rng.integers(0, 256, (16, 20, 3)).astype(np.uint8), PixelLayout(ColorModel.RGB))
    image = develop(colour, RawParameters(), DemosaicParameters())
    assert image.mosaic is not None and not image.may_have_curve
    assert image.mosaic.channels == (0, 0, 0, 0) and image.light_kind is LightKind.CODED
    assert_array_equal(image.mosaic.values, image.grey)
    mono = RawImage(colour.pixels[:, :, 0].copy(), PixelLayout(ColorModel.MONO))
    image = develop(mono, RawParameters(), DemosaicParameters())
    assert image.mosaic is not None and image.may_have_curve and image.light_kind is LightKind.GREY
    assert_array_equal(image.mosaic.values, mono.pixels)


# --- a rolling shutter


def test_the_motion_of_rows_by_hand() -> None:
    """Points of one row, which move along x by a parabola in time: the speed is its derivative."""
    row_ns, period_ns, middle, y = 30_000.0, 33_000_000, 239.5, 100.0
    exposed = (y - middle) * row_ns

    def x(ns: float) -> float:
        return 4e-7 * ns + 2e-15 * ns**2

    def seen(frame: int) -> Observation:
        stamp = 1_000_000_000 - frame * period_ns
        return Observation(moved(np.eye(3), x(stamp + exposed - 1_000_000_000)), stamp)

    points = np.array([[10.0, y], [300.0, y], [500.0, y]])
    stamp_ns = 1_000_000_000
    scan = FrameHints(None, stamp_ns, [seen(1), seen(2)]).scan(seen(0).H, points, middle, row_ns)
    speed = 4e-7 + 4e-15 * exposed
    assert_allclose(scan.by_row, np.tile([speed * row_ns, 0], (3, 1)), rtol=1e-6, atol=1e-12)
    assert scan.row == middle
    # Of two frames, their mean speed; and it is doubted more.
    two = FrameHints(None, stamp_ns, [seen(1)]).scan(seen(0).H, points, middle, row_ns)
    assert_allclose(two.by_row[:, 0], (x(exposed) - x(exposed - period_ns)) / period_ns * row_ns, rtol=1e-6)
    assert (np.abs(two.doubts).max(axis=0)[:, 0] > np.abs(scan.doubts).max(axis=0)[:, 0]).all()
    # Of one, nothing is known, along both axes.
    one = FrameHints(None, stamp_ns).scan(seen(0).H, points, middle, row_ns)
    assert_array_equal(one.by_row, np.zeros((3, 2)))
    assert (np.abs(one.doubts).max(axis=0) > np.abs(two.doubts).max(axis=0)).all()


ROW_US = 60.0


@pytest.fixture(scope="module")
def rolled(target_images: tuple[TargetImage, ...]) -> Frames:
    """Rows are read out during 29 of 67 ms, while the target moves by several px."""
    return sequence(target_images[:1], Capture(row_time_s=ROW_US * 1e-6), 7, frames=60)


def test_tracking_corrects_a_rolling_shutter(rolled: Frames, target: Reference) -> None:
    corrected = processed(rolled, target, {"camera.row_time_us": ROW_US})
    as_seen = processed(rolled, target)
    assert [each.first.status for each in corrected] == [Status.DETECTED] + [Status.TRACKED] * 6
    px, without = corner_px(rolled, corrected, target)[2:], corner_px(rolled, as_seen, target)[2:]
    assert np.median(without) > 0.5 and np.median(px) < 0.1 * np.median(without)
    for result in corrected[2:]:
        assert result.first.H_seen is not None and result.first.homography is not None
    assert all(each.first.H_seen is None for each in as_seen)


def test_a_detection_through_a_rolling_shutter_does_not_know_its_speed(rolled: Frames, target: Reference) -> None:
    values = {"tracking.enabled": False}
    honest = processed(rolled, target, {**values, "camera.row_time_us": ROW_US})
    proud = processed(rolled, target, values)
    squares = []
    for results in (honest, proud):
        poses = [(frame.truths[0].pose, each.first.pose) for frame, each in zip(rolled, results, strict=True)]
        squares.append(
            [normalised_squared_error(true, pose.transform, pose.covariance) for true, pose in poses if true and pose]
        )
    assert [len(each) for each in squares] == [len(rolled)] * 2
    assert (np.array(squares[0], float) < np.array(squares[1], float)).all()
    # The target is fastest in the first frame: 99.7 % of a chi-squared of 6 degrees of freedom are below 20.
    assert max(np.array(squares[0], float)) < 20 < max(np.array(squares[1], float))


def test_a_global_shutter_needs_no_row_time(one_target_frames: Frames, target: Reference) -> None:
    results = processed(one_target_frames[:3], target)
    assert all(each.first.H_seen is None for each in results)


def test_both_homographies_of_a_rolling_shutter(rolled: Frames, target: Reference) -> None:
    """H is that of one instant, H_seen is where the rows show the target: from there it is found again."""
    results = [each.first for each in processed(rolled[:4], target, {"camera.row_time_us": ROW_US})]
    seen = [each.H_seen for each in results]
    assert seen[1] is not None and seen[2] is not None and seen[3] is not None
    earlier = [Observation(seen[2], rolled[2].frame.stamp_ns), Observation(seen[1], rolled[1].frame.stamp_ns)]
    hints = FrameHints(None, rolled[3].frame.stamp_ns, earlier)
    begin = replace(start(rolled[3], target, 0.0), H=moved(seen[3], 0.2))
    image = image_of(rolled[3])
    image.row_time_ns = ROW_US * 1000
    found = refined_on_samples(image, target, begin, None, 8, hints)
    assert found.H_seen is not None
    apart = corner_error(found.homography.H, seen[3], target.size, SIZE)
    assert apart > 0.5
    assert corner_error(found.homography.H, rolled[3].truths[0].H, target.size, SIZE) < 0.15 * apart
    # No homography is where the rows show all of it: the nearest one depends on the patches.
    assert corner_error(found.H_seen, seen[3], target.size, SIZE) < 0.5 * apart


# --- the transfer curve


@pytest.mark.parametrize(
    ("transfer", "kind", "words"),
    [
        (TransferFunction.SRGB, TransferKind.SRGB, "sRGB"),
        (TransferFunction.FILM, TransferKind.FITTED, "a curve that was fitted to the target"),
    ],
)
def test_a_curve_is_learnt_and_said(
    target_images: tuple[TargetImage, ...],
    target: Reference,
    transfer: TransferFunction,
    kind: TransferKind,
    words: str,
) -> None:
    frames = sequence(target_images[:1], Capture(transfer=transfer), 11)
    results = processed(frames, target)
    said = [[remark for remark in each.camera_remarks if "raw.transfer" in remark] for each in results]
    # The first frame is a detection; eight tracked ones settle it.
    assert said[:8] == [[]] * 8 and [each.transfer for each in results[:8]] == [None] * 8
    for remarks, result in zip(said[9:], results[9:], strict=True):
        assert result.transfer is kind and len(remarks) == 1 and words in remarks[0]
    # It pays: the same frames without a curve.
    px, without = (
        corner_px(frames, each, target) for each in (results, processed(frames, target, {"raw.transfer": "linear"}))
    )
    assert np.median(px[2:]) < 0.02 and np.median(px[2:]) < np.median(without[2:])


def test_a_linear_camera_is_said_nothing_of(one_target_frames: Frames, target: Reference) -> None:
    results = processed(one_target_frames[:11], target)
    assert results[-1].transfer is TransferKind.LINEAR
    assert all("raw.transfer" not in remark for each in results for remark in each.camera_remarks)


def test_a_curve_that_is_given_is_not_learnt(target_images: tuple[TargetImage, ...], target: Reference) -> None:
    frames = sequence(target_images[:1], Capture(transfer=TransferFunction.SRGB), 10)
    results = processed(frames, target, {"raw.transfer": "srgb"})
    assert all(each.transfer is None and each.camera_remarks == () for each in results)
    assert np.median(corner_px(frames, results, target)) < 0.02


def test_the_same_frames_give_the_same_numbers(one_target_frames: Frames, targets: Targets, rolled: Frames) -> None:
    for frames, values in ((one_target_frames, {}), (rolled, {"camera.row_time_us": ROW_US})):
        first, second = processed(frames, targets[0], values), processed(frames, targets[0], values)
        # Another target that is looked for and not there changes nothing.
        localizer = Localizer(parameters_from(values), targets)
        third = [localizer.process(each.frame) for each in frames]
        for a, b, c in zip(first, second, third, strict=True):
            c_first = next(each for each in c if each.name == a.first.name)
            for other in (b.first, c_first):
                assert a.first.homography is not None and other.homography is not None
                assert_array_equal(a.first.homography.H, other.homography.H)
                assert_array_equal(a.first.homography.covariance, other.homography.covariance)
            assert a.transfer is b.transfer is c.transfer


def test_hints_by_default() -> None:
    assert NO_HINTS.spread is None and len(NO_HINTS.earlier) == 0
    assert replace(NO_HINTS, spread=np.zeros(3)).spread is not None
