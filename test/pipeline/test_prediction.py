# SPDX-License-Identifier: Apache-2.0
"""Where observations lead: steady, changing and interrupted motions, and how wrong that may be."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from imgu_ros.reference.reference import Reference
from imgu_ros.track.tracker import Observation, Track
from imgu_ros.types import Matrix3, Points
from imgu_ros.vision.projective.homography import normalised_homography
from imgu_ros.vision.projective.transform import transform

SECOND = 1_000_000_000
#: Where a target is, and how it moves on the picture from one frame to the next.
H0 = normalised_homography([[0.3, 0.02, 120.0], [-0.01, 0.31, 90.0], [1e-5, -2e-5, 1.0]])
MOTION = np.array([[0.999, -0.02, 7.0], [0.02, 1.001, -4.0], [1e-6, 2e-6, 1.0]])
H1 = normalised_homography(MOTION @ H0)
H2 = normalised_homography(MOTION @ H1)


@pytest.fixture(scope="module")
def target(targets: tuple[Reference, ...]) -> Reference:
    return targets[0]


def shifted(H: Matrix3, x: float, y: float) -> Matrix3:
    return normalised_homography(np.array([[1, 0, x], [0, 1, y], [0, 0, 1]]) @ H)


def track_of(*observations: Observation, errors_px: Sequence[float] = ()) -> Track:
    return Track(observations, errors_px)


def predicted(track: Track, target: Reference, stamp_ns: int) -> Matrix3:
    return track.expected(target, stamp_ns).H


def on_corners(H: Matrix3, target: Reference) -> Points:
    return transform(H, target.outline_template)


def test_a_steady_motion_goes_on(target: Reference) -> None:
    """Seen twice; the motion of the picture is told by H1 H0^-1."""
    track = track_of(Observation(H0, SECOND)).continued(target, H1, 2 * SECOND)
    assert track.expected(target, 3 * SECOND).error_px is None
    assert_allclose(predicted(track, target, 3 * SECOND), H2, atol=1e-12)
    track = track.continued(target, H2, 3 * SECOND)
    assert track.expected(target, 4 * SECOND).error_px == pytest.approx(0, abs=1e-6)
    assert [sighting.H for sighting in track.observations] == [H2, H1, H0]


@pytest.mark.parametrize(("interval_s", "goes_on"), [(0.1, False), (0.5, True), (1.0, True), (3.0, True), (6, False)])
def test_intervals_differ(target: Reference, interval_s: float, goes_on: bool) -> None:
    """After a frame that was left out, or that came sooner, the motion is that of the time; else none is known."""
    x, y = 12.0, -3.0
    track = track_of(Observation(shifted(H0, x, y), 2 * SECOND), Observation(H0, SECOND))
    led_to = predicted(track, target, 2 * SECOND + int(interval_s * SECOND))
    part = 1 + interval_s if goes_on else 1
    assert_allclose(on_corners(led_to, target), on_corners(H0, target) + np.multiply((x, y), part), atol=1e-6)


def test_part_of_a_turn(target: Reference) -> None:
    a = np.radians(20)
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    half = np.array([[np.cos(a / 2), -np.sin(a / 2), 0], [np.sin(a / 2), np.cos(a / 2), 0], [0, 0, 1]])
    H = normalised_homography(turn @ H0)
    track = track_of(Observation(H, 3 * SECOND), Observation(H0, SECOND))
    assert_allclose(on_corners(predicted(track, target, 4 * SECOND), target), on_corners(half @ H, target), atol=1e-6)


def test_the_way_that_served_best_is_followed(target: Reference) -> None:
    """At rest, in steady motion and in one that grows, what comes next is told; after a while, for all of them."""
    paths: list[Callable[[int], float]] = [lambda i: 0.0, lambda i: 3.0 * i, lambda i: 0.5 * i * i]
    for path in paths:
        track = track_of(Observation(shifted(H0, path(0), 0), SECOND))
        for i in range(1, 8):
            if i > 4:
                at = on_corners(predicted(track, target, (i + 1) * SECOND), target)
                assert_allclose(at, on_corners(H0, target) + [path(i), 0], atol=1e-6)
            track = track.continued(target, shifted(H0, path(i), 0), (i + 1) * SECOND)


def test_noise_is_not_taken_for_motion(target: Reference) -> None:
    """Of a target at rest whose place is known to a few hundredths of a pixel, the next place is told as well."""
    rng = np.random.default_rng(3)
    track = track_of(Observation(H0, SECOND))
    away = []
    for i in range(1, 60):
        stamp = (i + 1) * SECOND
        away.append(np.abs(on_corners(predicted(track, target, stamp), target) - on_corners(H0, target)).max())
        track = track.continued(target, shifted(H0, *rng.normal(0, 0.03, 2)), stamp)
    assert np.median(away) < 0.08


def falling(seconds: float) -> Matrix3:
    return shifted(H0, 4 * seconds, 3 * seconds**2)


def test_a_changing_motion_whose_frames_are_left_out(target: Reference) -> None:
    """Of a path that is a parabola any frame is told, whichever were seen, and how wrong the straight one would be."""
    for seen in ((0, 1, 2, 5), (0, 2, 3, 4), (0, 3, 4, 6), (0, 1, 3, 4)):
        track = track_of(*(Observation(falling(i), (i + 1) * SECOND) for i in reversed(seen[:3])), errors_px=(9, 9, 0))
        led_to = predicted(track, target, (seen[3] + 1) * SECOND)
        assert_allclose(on_corners(led_to, target), on_corners(falling(seen[3]), target), atol=1e-5)


@pytest.mark.parametrize("later", [1, 2, 3])
def test_what_grows_with_the_time(target: Reference, later: int) -> None:
    """The longer ahead, the more wrong: a straight path beside a parabola by as much as is said."""
    track = track_of(Observation(falling(1), 2 * SECOND), Observation(falling(0), SECOND)).continued(
        target, falling(2), 3 * SECOND
    )
    straight_only = Track(track.observations[:2], (1e3, track.errors_px[1]))
    expected = straight_only.expected(target, (3 + later) * SECOND)
    away = np.abs(on_corners(expected.H, target) - on_corners(falling(2 + later), target)).max()
    assert expected.error_px == pytest.approx(away, rel=1e-5)


def test_half_a_turn_has_no_part(target: Reference) -> None:
    """Nothing is known of the way between two observations on opposite sides: the target is sought where it was."""
    x, y = on_corners(H0, target).mean(axis=0)
    about = np.array([[1, 0, x], [0, 1, y], [0, 0, 1]])
    H = normalised_homography(about @ np.diag([-1.0, -1, 1]) @ np.linalg.inv(about) @ H0)
    track = track_of(Observation(H, 3 * SECOND), Observation(H0, SECOND))
    assert predicted(track, target, 4 * SECOND) is H


def test_time_that_stands_still_or_runs_backwards(target: Reference) -> None:
    assert track_of(Observation(H1, SECOND), Observation(H0, SECOND)).expected(target, 2 * SECOND).H is H1
    assert track_of(Observation(H1, SECOND), Observation(H0, 2 * SECOND)).expected(target, 3 * SECOND).H is H1
    assert track_of(Observation(H1, 2 * SECOND), Observation(H0, SECOND)).expected(target, SECOND).H is H1
    assert track_of(Observation(H1, SECOND)).expected(target, 2 * SECOND).H is H1


@given(x=st.floats(-50, 50), y=st.floats(-50, 50))
def test_surprise_is_how_far_the_prediction_was_off(targets: tuple[Reference, ...], x: float, y: float) -> None:
    """Of the ways to predict it is that of the best one."""
    track = track_of(Observation(H1, 2 * SECOND), Observation(H0, SECOND))
    track = track.continued(targets[0], shifted(H2, x, y), 3 * SECOND)
    stays, goes_on = track.errors_px
    assert goes_on == pytest.approx(np.hypot(x, y), abs=1e-6)
    away = on_corners(shifted(H2, x, y), targets[0]) - on_corners(H1, targets[0])
    assert stays == pytest.approx(np.hypot(*away.T).max(), abs=1e-6)
    assert track.expected(targets[0], 4 * SECOND).error_px == min(stays, goes_on)


def test_a_motion_that_leads_behind_the_camera_is_not_followed(target: Reference) -> None:
    """The plane tilts so fast that its vanishing line would cross the target."""
    tilting = normalised_homography(H0 + np.array([[0, 0, 0], [0, 0, 0], [-6e-4 * H0[2, 2], 0, 0]]))
    assert (np.column_stack((target.outline_template, np.ones(4))) @ tilting[2] > 0).all()
    track = track_of(Observation(tilting, 2 * SECOND), Observation(H0, SECOND))
    led_to = predicted(track, target, 3 * SECOND)
    on = tilting @ np.linalg.solve(H0, tilting)
    crosses = np.ptp(np.sign(np.column_stack((target.outline_template, np.ones(4))) @ on[2])) > 0
    assert crosses and led_to is tilting
    singular = Observation(np.zeros((3, 3)), SECOND)
    assert track_of(Observation(H1, 2 * SECOND), singular).expected(target, 3 * SECOND).H is H1
