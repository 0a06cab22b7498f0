"""Tracks: where they lead, how far they are trusted, and whether they hold."""

from __future__ import annotations

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
from imgu_ros.types import Image, Matrix3
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


def test_a_steady_motion_goes_on(target: Target) -> None:
    """Seen twice; the motion of the picture is told by H1 H0^-1."""
    track = Track(Sighting(H0, SECOND)).continued(target, H1, 2 * SECOND)
    assert track.surprise_px is None
    assert_allclose(track.predicted(target, 3 * SECOND), H2, atol=1e-12)
    track = track.continued(target, H2, 3 * SECOND)
    assert track.surprise_px == pytest.approx(0, abs=1e-6)
    assert track.last.H is H2 and track.before is not None and track.before.H is H1


@pytest.mark.parametrize(("interval_s", "goes_on"), [(0.4, False), (0.5, True), (1.0, True), (2.0, True), (2.1, False)])
def test_unsteady_intervals(target: Target, interval_s: float, goes_on: bool) -> None:
    """A frame that comes far too late or early is looked for where the target was."""
    track = Track(Sighting(H1, 2 * SECOND), Sighting(H0, SECOND))
    predicted = track.predicted(target, 2 * SECOND + int(interval_s * SECOND))
    assert_allclose(predicted, H2 if goes_on else H1, atol=1e-12)


def test_time_that_stands_still_or_runs_backwards(target: Target) -> None:
    assert Track(Sighting(H1, SECOND), Sighting(H0, SECOND)).predicted(target, 2 * SECOND) is H1
    assert Track(Sighting(H1, SECOND), Sighting(H0, 2 * SECOND)).predicted(target, 3 * SECOND) is H1
    assert Track(Sighting(H1, 2 * SECOND), Sighting(H0, SECOND)).predicted(target, SECOND) is H1
    assert Track(Sighting(H1, SECOND)).predicted(target, 2 * SECOND) is H1


@given(x=st.floats(-50, 50), y=st.floats(-50, 50))
def test_surprise_is_how_far_the_prediction_was_off(targets: tuple[Target, ...], x: float, y: float) -> None:
    track = Track(Sighting(H1, 2 * SECOND), Sighting(H0, SECOND)).continued(targets[0], shifted(H2, x, y), 3 * SECOND)
    assert track.surprise_px == pytest.approx(np.hypot(x, y), abs=1e-6)


def test_a_motion_that_leads_behind_the_camera_is_not_followed(target: Target) -> None:
    """The plane tilts so fast that its vanishing line would cross the target."""
    tilting = normalised_homography(H0 + np.array([[0, 0, 0], [0, 0, 0], [-6e-4 * H0[2, 2], 0, 0]]))
    assert (np.column_stack((target.outline_template, np.ones(4))) @ tilting[2] > 0).all()
    track = Track(Sighting(tilting, 2 * SECOND), Sighting(H0, SECOND))
    predicted = track.predicted(target, 3 * SECOND)
    on = tilting @ np.linalg.solve(H0, tilting)
    crosses = np.ptp(np.sign(np.column_stack((target.outline_template, np.ones(4))) @ on[2])) > 0
    assert crosses and predicted is tilting
    singular = Sighting(np.zeros((3, 3)), SECOND)
    assert Track(Sighting(H1, 2 * SECOND), singular).predicted(target, 3 * SECOND) is H1


def test_a_sequence_is_followed(one_target_frames: tuple[SimulatedFrame, ...], target: Target) -> None:
    first = one_target_frames[0]
    track = Track(Sighting(first.truths[0].H, first.frame.stamp_ns))
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
    for track in (Track(was), Track(was, before, surprise_px=0.1)):
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
    track = Track(Sighting(normalised_homography(roll @ H), frame.frame.stamp_ns - SECOND))
    found = followed(frame, target, track)
    assert corner_error(found.homography.H, H, target.size, SIZE) < 0.1


def test_where_a_wrong_motion_led_away_the_target_is_found_where_it_was(
    one_target_frames: tuple[SimulatedFrame, ...], target: Target
) -> None:
    frame = one_target_frames[0]
    H, stamp = frame.truths[0].H, frame.frame.stamp_ns
    track = Track(Sighting(shifted(H, 2, 1), stamp - SECOND), Sighting(shifted(H, 152, 1), stamp - 2 * SECOND), 3.0)
    found = followed(frame, target, track)
    assert corner_error(found.homography.H, H, target.size, SIZE) < 0.1


def test_a_track_does_not_hold_on_anything_else(
    one_target_frames: tuple[SimulatedFrame, ...], targets: tuple[Target, ...]
) -> None:
    frame = one_target_frames[0]
    track = Track(Sighting(frame.truths[0].H, frame.frame.stamp_ns - SECOND))
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
    track = Track(Sighting(H, frame.frame.stamp_ns - SECOND))
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
        followed(frame, target, Track(last, before, surprise))
        assert reaches == [pytest.approx(reach)]
        reaches.clear()
