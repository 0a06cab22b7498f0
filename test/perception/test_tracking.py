"""Tracks: where they lead, how far they are trusted, and whether they hold."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from imgu_ros.errors import EstimationError
from imgu_ros.parameter_values import parameters_from
from imgu_ros.params import DemosaicParameters, Parameters, RawParameters
from imgu_ros.perception import tracking
from imgu_ros.perception.develop import develop
from imgu_ros.perception.pictures import Pictures
from imgu_ros.perception.refinement import Alignment
from imgu_ros.perception.targets import Target
from imgu_ros.perception.tracking import Sighting, Track, follow, located
from imgu_ros.simulate.sequence import SimulatedFrame
from imgu_ros.simulate.truth import corner_error
from imgu_ros.types import Image, Matrix3, Points
from imgu_ros.vision.formation.layout import RawImage
from imgu_ros.vision.projective.transform import normalised_homography, transform

SIZE = (640, 480)
SECOND = 1_000_000_000
#: Where a target is, and how it moves on the picture from one frame to the next.
H0 = normalised_homography([[0.3, 0.02, 120.0], [-0.01, 0.31, 90.0], [1e-5, -2e-5, 1.0]])
MOTION = np.array([[0.999, -0.02, 7.0], [0.02, 1.001, -4.0], [1e-6, 2e-6, 1.0]])
H1 = normalised_homography(MOTION @ H0)
H2 = normalised_homography(MOTION @ H1)


@pytest.fixture(scope="module")
def target(targets: tuple[Target, ...]) -> Target:
    return targets[0]


def pictures_of(frame: SimulatedFrame, pixels: Image | None = None) -> Pictures:
    image = frame.frame.image
    raw = RawImage(image.pixels if pixels is None else pixels, image.layout)
    return Pictures(develop(raw, RawParameters(), DemosaicParameters()))


def shifted(H: Matrix3, x: float, y: float) -> Matrix3:
    return normalised_homography(np.array([[1, 0, x], [0, 1, y], [0, 0, 1]]) @ H)


def followed(frame: SimulatedFrame, target: Target, track: Track, pixels: Image | None = None) -> Alignment:
    return follow(target, track, pictures_of(frame, pixels), frame.frame.stamp_ns, frame.frame.camera, Parameters())


def track_of(*sightings: Sighting, surprises_px: Sequence[float] = ()) -> Track:
    return Track(sightings, surprises_px)


def on_corners(H: Matrix3, target: Target) -> Points:
    return transform(H, target.outline_template)


def test_a_steady_motion_goes_on(target: Target) -> None:
    """Seen twice; the motion of the picture is told by H1 H0^-1."""
    track = track_of(Sighting(H0, SECOND)).continued(target, H1, 2 * SECOND)
    assert track.surprise_px is None
    assert_allclose(track.predicted(target, 3 * SECOND), H2, atol=1e-12)
    track = track.continued(target, H2, 3 * SECOND)
    assert track.surprise_px == pytest.approx(0, abs=1e-6)
    assert [sighting.H for sighting in track.sightings] == [H2, H1, H0]


@pytest.mark.parametrize(("interval_s", "goes_on"), [(0.1, False), (0.5, True), (1.0, True), (3.0, True), (6, False)])
def test_intervals_differ(target: Target, interval_s: float, goes_on: bool) -> None:
    """After a frame that was left out, or that came sooner, the motion is that of the time; else none is known."""
    x, y = 12.0, -3.0
    track = track_of(Sighting(shifted(H0, x, y), 2 * SECOND), Sighting(H0, SECOND))
    predicted = track.predicted(target, 2 * SECOND + int(interval_s * SECOND))
    part = 1 + interval_s if goes_on else 1
    assert_allclose(on_corners(predicted, target), on_corners(H0, target) + np.multiply((x, y), part), atol=1e-6)


def test_part_of_a_turn(target: Target) -> None:
    a = np.radians(20)
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    half = np.array([[np.cos(a / 2), -np.sin(a / 2), 0], [np.sin(a / 2), np.cos(a / 2), 0], [0, 0, 1]])
    H = normalised_homography(turn @ H0)
    track = track_of(Sighting(H, 3 * SECOND), Sighting(H0, SECOND))
    assert_allclose(on_corners(track.predicted(target, 4 * SECOND), target), on_corners(half @ H, target), atol=1e-6)


def test_the_way_that_served_best_is_followed(target: Target) -> None:
    """At rest, in steady motion and in one that grows, what comes next is told; after a while, for all of them."""
    paths: list[Callable[[int], float]] = [lambda i: 0.0, lambda i: 3.0 * i, lambda i: 0.5 * i * i]
    for path in paths:
        track = track_of(Sighting(shifted(H0, path(0), 0), SECOND))
        for i in range(1, 8):
            if i > 4:
                at = on_corners(track.predicted(target, (i + 1) * SECOND), target)
                assert_allclose(at, on_corners(H0, target) + [path(i), 0], atol=1e-6)
            track = track.continued(target, shifted(H0, path(i), 0), (i + 1) * SECOND)


def test_noise_is_not_taken_for_motion(target: Target) -> None:
    """Of a target at rest whose place is known to a few hundredths of a pixel, the next place is told as well."""
    rng = np.random.default_rng(3)
    track = track_of(Sighting(H0, SECOND))
    away = []
    for i in range(1, 60):
        stamp = (i + 1) * SECOND
        away.append(np.abs(on_corners(track.predicted(target, stamp), target) - on_corners(H0, target)).max())
        track = track.continued(target, shifted(H0, *rng.normal(0, 0.03, 2)), stamp)
    assert np.median(away) < 0.08


def test_time_that_stands_still_or_runs_backwards(target: Target) -> None:
    assert track_of(Sighting(H1, SECOND), Sighting(H0, SECOND)).predicted(target, 2 * SECOND) is H1
    assert track_of(Sighting(H1, SECOND), Sighting(H0, 2 * SECOND)).predicted(target, 3 * SECOND) is H1
    assert track_of(Sighting(H1, 2 * SECOND), Sighting(H0, SECOND)).predicted(target, SECOND) is H1
    assert track_of(Sighting(H1, SECOND)).predicted(target, 2 * SECOND) is H1


@given(x=st.floats(-50, 50), y=st.floats(-50, 50))
def test_surprise_is_how_far_the_prediction_was_off(targets: tuple[Target, ...], x: float, y: float) -> None:
    """Of the ways to predict it is that of the best one."""
    track = track_of(Sighting(H1, 2 * SECOND), Sighting(H0, SECOND))
    track = track.continued(targets[0], shifted(H2, x, y), 3 * SECOND)
    stays, goes_on = track.surprises_px
    assert goes_on == pytest.approx(np.hypot(x, y), abs=1e-6)
    away = on_corners(shifted(H2, x, y), targets[0]) - on_corners(H1, targets[0])
    assert stays == pytest.approx(np.hypot(*away.T).max(), abs=1e-6)
    assert track.surprise_px == min(stays, goes_on)


def test_a_motion_that_leads_behind_the_camera_is_not_followed(target: Target) -> None:
    """The plane tilts so fast that its vanishing line would cross the target."""
    tilting = normalised_homography(H0 + np.array([[0, 0, 0], [0, 0, 0], [-6e-4 * H0[2, 2], 0, 0]]))
    assert (np.column_stack((target.outline_template, np.ones(4))) @ tilting[2] > 0).all()
    track = track_of(Sighting(tilting, 2 * SECOND), Sighting(H0, SECOND))
    predicted = track.predicted(target, 3 * SECOND)
    on = tilting @ np.linalg.solve(H0, tilting)
    crosses = np.ptp(np.sign(np.column_stack((target.outline_template, np.ones(4))) @ on[2])) > 0
    assert crosses and predicted is tilting
    singular = Sighting(np.zeros((3, 3)), SECOND)
    assert track_of(Sighting(H1, 2 * SECOND), singular).predicted(target, 3 * SECOND) is H1


def test_a_sequence_is_followed(one_target_frames: tuple[SimulatedFrame, ...], target: Target) -> None:
    first = one_target_frames[0]
    track = track_of(Sighting(first.truths[0].H, first.frame.stamp_ns))
    for frame in one_target_frames[1:]:
        found = followed(frame, target, track)
        assert corner_error(found.homography.H, frame.truths[0].H, target.size, SIZE) < 0.3
        place = located(found)
        assert place.homography is found.homography and place.condensed is found.condensed
        assert len(place.template_xy) == len(place.image_xy) == np.count_nonzero(found.homography.inliers)
        track = track.continued(target, found.homography.H, frame.frame.stamp_ns)
    assert track.surprise_px is not None and track.surprise_px < 10


@pytest.mark.parametrize(("x", "y"), [(5, 0), (-12, 16), (20, 0), (-40, 30), (0, 60)])
def test_a_jump_is_caught_up_with(
    one_target_frames: tuple[SimulatedFrame, ...], target: Target, x: float, y: float
) -> None:
    """Whether or not the motion before promised an exact prediction."""
    frame = one_target_frames[0]
    H, stamp = frame.truths[0].H, frame.frame.stamp_ns
    was = Sighting(shifted(H, x, y), stamp - SECOND)
    before = Sighting(was.H, stamp - 2 * SECOND)
    for track in (track_of(was), track_of(was, before, surprises_px=[0.1, 0.1])):
        found = followed(frame, target, track)
        assert corner_error(found.homography.H, H, target.size, SIZE) < 0.1


@pytest.mark.parametrize("degrees", [4.0, -4.0])
def test_a_sudden_roll_is_caught_up_with(
    one_target_frames: tuple[SimulatedFrame, ...], target: Target, degrees: float
) -> None:
    frame = one_target_frames[0]
    H = frame.truths[0].H
    a = np.radians(degrees)
    x, y = transform(H, target.outline_template).mean(axis=0)
    about = np.array([[1, 0, x], [0, 1, y], [0, 0, 1]])
    roll = about @ [[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]] @ np.linalg.inv(about)
    track = track_of(Sighting(normalised_homography(roll @ H), frame.frame.stamp_ns - SECOND))
    found = followed(frame, target, track)
    assert corner_error(found.homography.H, H, target.size, SIZE) < 0.1


def test_where_a_wrong_motion_led_away_the_target_is_found_where_it_was(
    one_target_frames: tuple[SimulatedFrame, ...], target: Target
) -> None:
    frame = one_target_frames[0]
    H, stamp = frame.truths[0].H, frame.frame.stamp_ns
    was, before = Sighting(shifted(H, 2, 1), stamp - SECOND), Sighting(shifted(H, 152, 1), stamp - 2 * SECOND)
    track = track_of(was, before, surprises_px=[150.0, 3.0])
    found = followed(frame, target, track)
    assert corner_error(found.homography.H, H, target.size, SIZE) < 0.1


def test_a_track_does_not_hold_on_anything_else(
    one_target_frames: tuple[SimulatedFrame, ...], targets: tuple[Target, ...]
) -> None:
    frame = one_target_frames[0]
    track = track_of(Sighting(frame.truths[0].H, frame.frame.stamp_ns - SECOND))
    noise = np.random.default_rng(4).integers(0, 256, (480, 640), np.uint8)
    for pixels in (noise, np.full_like(noise, 100), np.ascontiguousarray(frame.frame.image.pixels[:, ::-1])):
        with pytest.raises(EstimationError):
            followed(frame, targets[0], track, pixels)
    with pytest.raises(EstimationError):
        followed(frame, targets[1], track)


def test_few_patches_are_no_track(one_target_frames: tuple[SimulatedFrame, ...], target: Target) -> None:
    """Of a target that is nearly covered some patches are found, but fewer than a track asks for."""
    frame = one_target_frames[0]
    H = frame.truths[0].H
    xy = transform(H, target.outline_template)
    left, right = xy[:, 0].min(), xy[:, 0].max()
    pixels = frame.frame.image.pixels.copy()
    pixels[:, : int(left + 0.85 * (right - left))] = np.random.default_rng(4).integers(0, 256, 1, np.uint8)
    track = track_of(Sighting(H, frame.frame.stamp_ns - SECOND))
    with pytest.raises(EstimationError):
        followed(frame, target, track, pixels)
    p = parameters_from({"homography.min_inliers": 150})
    covered = frame.frame.image.pixels.copy()
    covered[:, : int((left + right) / 2)] = 90
    with pytest.raises(EstimationError):
        follow(target, track, pictures_of(frame, covered), frame.frame.stamp_ns, frame.frame.camera, p)


def test_an_exact_prediction_needs_no_second_try(
    one_target_frames: tuple[SimulatedFrame, ...], target: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    reaches: list[float] = []
    refine = tracking.refine_by_alignment

    def recorded(*arguments: object) -> Alignment:
        reaches.append(float(arguments[-1]))  # type: ignore[arg-type]
        return refine(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(tracking, "refine_by_alignment", recorded)
    frame = one_target_frames[0]
    H, stamp = frame.truths[0].H, frame.frame.stamp_ns
    last, before = Sighting(H, stamp - SECOND), Sighting(H, stamp - 2 * SECOND)
    for surprise, reach in ((0.0, 2.0), (4.0, 6.0), (1e3, 24.0), (None, 24.0)):
        surprises = [] if surprise is None else [surprise, surprise]
        followed(frame, target, track_of(last, before, surprises_px=surprises))
        assert reaches == [pytest.approx(reach)]
        reaches.clear()
