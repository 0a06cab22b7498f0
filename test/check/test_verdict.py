# SPDX-License-Identifier: Apache-2.0
"""What a check says of pictures that are what they are by construction."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from imgu_ros.check.accuracy import expected_errors
from imgu_ros.check.finding import SIZES_PX, SLOPE, FindingCurve, SearchTrial, finding_curve, fitted_curve
from imgu_ros.check.load_remarks import load_remarks
from imgu_ros.check.traits import traits_of
from imgu_ros.check.trial_views import DEFAULT_CAMERA, TrialViews
from imgu_ros.check.verdict import DEPENDABLE, ReasonKind, TargetCheck, check_targets, score_of, target_scores
from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.localizer import Localizer
from imgu_ros.reference.marker import marker_image
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import make_references

SIMULATED = parameters_from({"raw.significant_bits": 10})
needs_aruco = pytest.mark.skipif(not hasattr(cv2, "aruco"), reason="this OpenCV has no aruco module")
#: Scores are lower without the thorough search, and take a third of the time.
QUICK = parameters_from({"search.thorough": False})


def patchwork(width: int = 360, height: int = 280, seed: int = 5, count: int = 160) -> np.ndarray:
    """Return rectangles and discs of any grey, no two parts alike: a good target."""
    rng = np.random.default_rng(seed)
    picture = np.full((height, width), 128, np.uint8)
    for _ in range(count):
        x, y = rng.integers((0, 0), (width, height)).tolist()
        size, grey = int(rng.integers(6, 42)), int(rng.integers(256))
        if rng.random() < 0.6:
            cv2.rectangle(picture, (x, y), (x + size, y + int(rng.integers(6, 42))), grey, -1)
        else:
            cv2.circle(picture, (x, y), size // 2, grey, -1)
    return picture


def half_turn_symmetric() -> np.ndarray:
    half = patchwork(height=140)
    return np.vstack((half, half[::-1, ::-1]))


def quarter_turn_symmetric() -> np.ndarray:
    quarter = patchwork(160, 160, count=70)
    top = np.hstack((quarter, np.rot90(quarter, -1)))
    return np.vstack((top, np.rot90(top, 2)))


def periodic() -> np.ndarray:
    return np.tile(patchwork(60, 56, count=8), (5, 6))


def faint() -> np.ndarray:
    return np.rint(118 + 14 * (patchwork() / 255.0)).astype(np.uint8)


def plain() -> np.ndarray:
    """White with one soft blot: nothing to hold on to."""
    picture = np.full((280, 360), 255, np.uint8)
    cv2.circle(picture, (120, 130), 60, 120, -1)
    return cv2.GaussianBlur(picture, (0, 0), 12)


def reference_of(picture: np.ndarray, name: str = "a") -> Reference:
    return make_references([TargetImage(name, picture, 0.2)], Parameters())[0]


def kinds_of(check: TargetCheck) -> set[ReasonKind]:
    return {reason.kind for reason in check.reasons}


def checked(picture: np.ndarray, **more: object) -> TargetCheck:
    (check,) = check_targets([TargetImage("a", picture, 0.2)], ["a.png"], QUICK, DEFAULT_CAMERA, **more)
    return check


@pytest.fixture(scope="module")
def good() -> TargetCheck:
    return checked(patchwork())


# What the picture alone says


def test_turns_of_a_picture_are_those_it_was_made_with() -> None:
    assert traits_of(reference_of(half_turn_symmetric())).turns_deg == (180,)
    assert traits_of(reference_of(quarter_turn_symmetric())).turns_deg == (90, 180)
    assert traits_of(reference_of(patchwork())).turns_deg == ()


def test_a_turn_of_a_picture_by_a_quarter_changes_no_trait() -> None:
    one, turned = (
        traits_of(reference_of(picture)) for picture in (half_turn_symmetric(), np.rot90(half_turn_symmetric()))
    )
    assert turned.turns_deg == one.turns_deg
    assert (turned.width_px, turned.height_px) == (one.height_px, one.width_px)
    assert turned.contrast == pytest.approx(one.contrast, rel=1e-6)
    assert turned.flat_share == pytest.approx(one.flat_share, abs=0.03)
    assert turned.lost_share == pytest.approx(one.lost_share, abs=0.01)
    assert turned.corners == pytest.approx(one.corners, rel=0.1)


def test_a_periodic_picture_repeats_and_another_does_not() -> None:
    assert traits_of(reference_of(periodic())).repeats
    assert not traits_of(reference_of(patchwork())).repeats


def test_contrast_is_the_standard_deviation_of_linear_light() -> None:
    picture = np.full((200, 240), 255, np.uint8)
    picture[:, :120] = 0
    picture[90:110, 100:140] = 128
    light = np.where(picture / 255 <= 0.04045, picture / 255 / 12.92, ((picture / 255 + 0.055) / 1.055) ** 2.4)
    assert traits_of(reference_of(picture)).contrast == pytest.approx(255 * light.std(), rel=0.01)


def test_flat_share_is_the_area_without_detail() -> None:
    picture = np.full((320, 320), 200, np.uint8)
    picture[:160, :160] = np.random.default_rng(2).integers(0, 256, (160, 160), np.uint8)
    assert traits_of(reference_of(picture)).flat_share == pytest.approx(0.75, abs=0.03)
    assert traits_of(reference_of(picture)).crowded_share == pytest.approx(0.25, abs=0.03)


def test_fine_pattern_is_lost_at_a_distance_and_a_coarse_one_is_not() -> None:
    rng = np.random.default_rng(1)
    fine, coarse = (
        np.kron(rng.integers(0, 2, (640 // n, 640 // n), np.uint8) * 255, np.ones((n, n), np.uint8)) for n in (4, 80)
    )
    assert traits_of(reference_of(fine)).lost_share > 0.5
    assert traits_of(reference_of(coarse)).lost_share < 0.15


def test_load_remarks_name_the_poor_ones_alone() -> None:
    pictures = {"ok": patchwork(), "turned": half_turn_symmetric(), "tiles": periodic(), "plain": plain()}
    said = load_remarks(reference_of(picture, name) for name, picture in pictures.items())
    assert set(said) == {"turned", "tiles", "plain"}
    assert "turned by 180 degrees" in said["turned"]
    assert "repeats" in said["tiles"]
    assert "few corners" in said["plain"]


@needs_aruco
def test_nothing_is_said_of_markers_at_load() -> None:
    assert load_remarks(make_references([marker_image("m", "tag36h11", 3, 0.1)], Parameters())) == {}


# Simulated views


def test_views_are_seen_where_their_truth_says() -> None:
    """The pipeline's homography, which knows nothing of the truth, is right to a small part of a px."""
    image = TargetImage("a", patchwork(), 0.2)
    (reference,) = make_references([image], SIMULATED)
    views = TrialViews(reference, image, DEFAULT_CAMERA)
    for view in (
        views.anywhere(250, math.radians(30), np.random.default_rng(4)),
        views.centred(250, math.radians(30), 0.5, 2.0, 3),
    ):
        assert view is not None
        found = Localizer(SIMULATED, [reference]).process(view.frame).first
        assert found.homography is not None
        seen, true = (H @ reference.outline_homogeneous for H in (found.homography.H, view.H))
        assert np.abs(seen[:2] / seen[2] - true[:2] / true[2]).max() < 0.1
        # The truth of the pose is that of the homography, and of the size.
        corners = reference.plane.to_metres(reference.outline_template)
        in_camera = np.column_stack((corners, np.zeros(4))) @ view.pose.R.T + view.pose.t
        K = view.frame.camera.K
        projected = in_camera @ K.T
        assert np.allclose(projected[:, :2] / projected[:, 2:], (true[:2] / true[2]).T, atol=1e-6)
        assert np.linalg.norm(view.pose.t) == pytest.approx(600 * 0.2 / 250, rel=1e-9)


def test_a_view_larger_than_the_frame_is_none() -> None:
    image = TargetImage("a", patchwork(), 0.2)
    (reference,) = make_references([image], SIMULATED)
    assert TrialViews(reference, image, DEFAULT_CAMERA).anywhere(900, 0.0, np.random.default_rng(0)) is None


@pytest.mark.parametrize(("ceiling", "middle"), [(1.0, 60.0), (1.0, 150.0), (0.5, 40.0)])
def test_the_curve_that_made_the_trials_is_fitted(ceiling: float, middle: float) -> None:
    rng = np.random.default_rng(8)
    trials = []
    for size in np.geomspace(24, 384, 400):
        tilt = rng.uniform(0, 60)
        share = ceiling / (1 + (middle / (size * math.cos(math.radians(tilt)))) ** (1 / SLOPE))
        trials.append(SearchTrial(size, tilt, bool(rng.random() < share), False))
    curve = fitted_curve(trials)
    assert curve.ceiling == pytest.approx(ceiling, abs=0.07)
    assert curve.middle_px == pytest.approx(middle, rel=0.08)


def test_smallest_size_has_the_share_that_it_promises() -> None:
    curve = FindingCurve((), 0.97, 70.0)
    smallest = curve.smallest_px(0.8)
    assert smallest is not None
    assert curve.share(smallest) == pytest.approx(0.8, abs=1e-9)
    assert curve.share(smallest * 1.5, tilt_deg=math.degrees(math.acos(1 / 1.5))) == pytest.approx(0.8, abs=1e-9)
    assert replace(curve, ceiling=0.7).smallest_px(0.8) is None


def test_score_is_the_share_of_sizes() -> None:
    assert score_of(FindingCurve((), 1.0, 32.0)) == 100
    assert score_of(FindingCurve((), 1.0, 128.0)) == 50
    assert score_of(FindingCurve((), 0.5, 128.0)) == 25
    assert score_of(FindingCurve((), 0.75, 32.0)) == DEPENDABLE - 1
    assert score_of(FindingCurve((), 1.0, 700.0)) == 0
    assert score_of(fitted_curve(())) == 0


def test_errors_grow_with_the_distance_and_are_those_of_frames() -> None:
    """Errors of fresh views, by the whole pipeline, have about the promised medians."""
    image = TargetImage("a", patchwork(), 0.2)
    (reference,) = make_references([image], SIMULATED)
    views = TrialViews(reference, image, DEFAULT_CAMERA)
    near, middle, far = expected_errors(reference, views, SIMULATED, (300, 170, 100))
    for few, many in ((near, middle), (middle, far)):
        assert few.position_m < many.position_m
        assert few.rotation_deg < many.rotation_deg
        assert few.distance_m < many.distance_m
    localizer = Localizer(parameters_from({"tracking.enabled": False}, SIMULATED), [reference])
    errors = []
    for seed in range(40):
        view = views.centred(170, math.radians(30), 0.3 * seed, 2.1 * seed, 900 + seed)
        pose = localizer.process(view.frame).first.pose
        if pose is not None:
            errors.append(float(np.linalg.norm(pose.t - view.pose.t)))
    assert len(errors) > 30
    # The promise is for other frames, with somewhat smaller errors.
    assert 0.5 * middle.position_m < np.median(errors) < 2 * middle.position_m


# The verdict


def test_a_good_target_is_dependable_without_reasons(good: TargetCheck) -> None:
    assert good.is_dependable
    assert good.score > 55
    assert not kinds_of(good) & {ReasonKind.SYMMETRIC, ReasonKind.REPEATS, ReasonKind.FEW_CORNERS, ReasonKind.ELONGATED}
    assert good.smallest_width_px is not None
    assert 20 < good.smallest_width_px < 120


def test_symmetric_and_plain_ones_are_not_dependable() -> None:
    for picture, kind in (
        (half_turn_symmetric(), ReasonKind.SYMMETRIC),
        (plain(), ReasonKind.FEW_CORNERS),
    ):  # fmt: skip
        check = checked(picture)
        assert not check.is_dependable
        assert check.score < DEPENDABLE
        assert check.reasons[0].kind in (kind, ReasonKind.NOT_USABLE)


def test_a_periodic_target_is_worse(good: TargetCheck) -> None:
    check = checked(periodic())
    assert ReasonKind.REPEATS in kinds_of(check)
    assert check.score < good.score - 10


def test_low_contrast_lowers_the_score(good: TargetCheck) -> None:
    check = checked(faint())
    assert ReasonKind.LOW_CONTRAST in kinds_of(check)
    assert check.score < good.score - 5


def test_score_does_not_depend_on_the_number_of_pixels(good: TargetCheck) -> None:
    larger = checked(cv2.resize(patchwork(), None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC))
    assert larger.score == pytest.approx(good.score, abs=10)
    assert larger.smallest_width_px == pytest.approx(good.smallest_width_px, rel=0.25)


def test_score_of_the_mirror_picture_is_the_same(good: TargetCheck) -> None:
    assert checked(np.ascontiguousarray(patchwork()[:, ::-1])).score == pytest.approx(good.score, abs=10)


def test_the_same_check_gives_the_same_numbers(good: TargetCheck) -> None:
    again = checked(patchwork())
    assert (again.score, again.smallest_width_px, again.errors) == (good.score, good.smallest_width_px, good.errors)


def test_scores_alone_are_those_of_the_whole_check(good: TargetCheck) -> None:
    images = [TargetImage("a", patchwork(), 0.2), TargetImage("blank", np.full((200, 300, 3), 200, np.uint8), 0.0)]
    assert target_scores(images, QUICK) == {"a": good.score, "blank": 0}


def test_unknown_width_gives_lengths_in_widths(good: TargetCheck) -> None:
    (check,) = check_targets([TargetImage("a", patchwork(), 0.0)], ["a.png"], QUICK, DEFAULT_CAMERA)
    for one, other in zip(check.errors, good.errors, strict=True):
        assert one.distance_m == pytest.approx(other.distance_m / 0.2)
        assert one.position_m == pytest.approx(other.position_m / 0.2, rel=0.1)


def test_elongated_small_files_and_notes_are_said() -> None:
    check = checked(patchwork(240, 60, count=70), notes=[["transparent: composed on white"]])
    assert {ReasonKind.ELONGATED, ReasonKind.FEW_PIXELS, ReasonKind.TRANSPARENT} <= kinds_of(check)


def test_targets_that_share_a_design_name_each_other() -> None:
    one, other, third = patchwork(), patchwork(), patchwork(seed=40)
    other[200:, 250:] = patchwork(seed=77)[200:, 250:]
    images = [TargetImage(name, each, 0.2) for name, each in (("one", one), ("other", other), ("third", third))]
    checks = check_targets(images, ["1", "2", "3"], QUICK, DEFAULT_CAMERA)
    assert [check.alike for check in checks] == [("other",), ("one",), ()]


@needs_aruco
def test_a_marker_is_a_good_target_whatever_its_corners_are() -> None:
    (check,) = check_targets(
        [marker_image("m", "tag36h11", 7, 0.1)], ["tag36h11:7"], QUICK, DEFAULT_CAMERA
    )  # fmt: skip
    assert check.score > 85
    assert check.reasons == ()
    # Its width is that of the black square.
    assert check.errors[0].distance_m == pytest.approx(600 * 0.1 / check.errors[0].seen_px)


@pytest.mark.parametrize("shape", [(16, 16), (16, 400), (300, 20)])
def test_strange_shapes_are_judged(shape: tuple[int, int]) -> None:
    picture = np.random.default_rng(0).integers(0, 256, shape, np.uint8)
    check = checked(picture)
    assert 0 <= check.score <= 100


def test_larger_views_come_first() -> None:
    assert list(SIZES_PX) == sorted(SIZES_PX, reverse=True)
    image = TargetImage("a", half_turn_symmetric(), 0.2)
    reference: Reference = make_references([image], SIMULATED)[0]
    curve = finding_curve(reference, TrialViews(reference, image, DEFAULT_CAMERA), SIMULATED)
    assert curve.large_share == 0
    assert any("not tried" in trial.reason for trial in curve.trials)
