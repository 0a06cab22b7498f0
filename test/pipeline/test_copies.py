# SPDX-License-Identifier: Apache-2.0
"""Targets that look like themselves when turned or shifted: known beforehand, and never found at the wrong place."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imgu_ros.config.components import DevelopmentParameters
from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.detect.copies import require_no_better_copy
from imgu_ros.errors import EstimationError, LooksAlike
from imgu_ros.image.frame_image import FrameImage, develop_frame
from imgu_ros.localizer import Localizer
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.self_similarity import Copy
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.result import PoseStatus
from imgu_ros.simulate.sequence import Simulation, simulate_sequence
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.simulate.truth import corner_error
from imgu_ros.track.patch_alignment import align_patches
from imgu_ros.track.sample_refinement import PatchAlignment

SIDE = 480
#: A period of a pattern of four tiles.
SHIFT = np.array([[1, 0, 120.0], [0, 1, 0], [0, 0, 1]])


def turned_into_itself(mark: bool) -> np.ndarray:
    """A picture that looks the same turned by half a circle, but for a mark."""
    half = procedural_texture(SIDE, SIDE // 2, 3)
    picture = np.ascontiguousarray(np.vstack((half, half[::-1, ::-1])))
    if mark:
        cv2.rectangle(picture, (300, 60), (400, 160), (255, 255, 255), -1)
    return picture


def reference(pixels: np.ndarray) -> Reference:
    return prepare_references([TargetImage("picture", pixels, 0.3)], Parameters())[0]


def copies(pixels: np.ndarray) -> tuple[Copy, ...]:
    return reference(pixels).copies(linear=True)


def test_a_turn_is_known_beforehand() -> None:
    found = copies(turned_into_itself(mark=False))
    assert [copy.turn_deg for copy in found] == [180.0]
    assert found[0].similarity > 0.95 and found[0].differing_share < 0.1 and found[0].shift_px < 1.0
    at = found[0].H @ (100.0, 50.0, 1.0)
    assert at[:2] / at[2] == pytest.approx((SIDE - 101.0, SIDE - 51.0), abs=1.0)


def test_a_period_is_known_beforehand() -> None:
    tile = procedural_texture(120, 480, 5)
    found = copies(np.ascontiguousarray(np.hstack((tile,) * 4)))
    assert {copy.turn_deg for copy in found} == {0.0}
    assert found[0].shift_px == pytest.approx(120, abs=6)


@pytest.mark.parametrize("period", [13, 17, 24])
def test_a_fine_period_is_known_beforehand(period: int) -> None:
    """A screen of dots, of a few hundredths of the width."""
    y, x = np.mgrid[0:SIDE, 0:SIDE]
    dots = (x % period - period / 2) ** 2 + (y % period - period / 2) ** 2 < (period / 3.5) ** 2
    picture = cv2.GaussianBlur(np.where(dots, 30, 220).astype(np.uint8), (0, 0), 1.0)
    shifts = [copy.H[:2, 2] for copy in copies(picture) if not copy.turn_deg]
    for expected in ((period, 0), (0, period)):
        assert min(np.abs(np.abs(shift) - expected).max() for shift in shifts) < 1.5


def test_a_picture_without_order_has_no_copies() -> None:
    assert copies(procedural_texture(640, 480, 7)) == ()


def test_a_symmetry_is_exact_and_a_mark_ends_it() -> None:
    (half,) = copies(turned_into_itself(mark=False))
    assert half.is_symmetry
    # As the picture is stored: its corners are each other's.
    assert pytest.approx((SIDE - 1, SIDE - 1, 1)) == half.H @ (0, 0, 1)
    assert not any(copy.is_symmetry for copy in copies(turned_into_itself(mark=True)))
    assert not any(copy.is_symmetry for copy in copies(pad()))
    assert sorted(copy.turn_deg for copy in copies(star(3)) if copy.is_symmetry) == [120.0, 240.0]


def rosette(order: int) -> np.ndarray:
    """A sector of a texture about a centre, as often as the order, in a circle: corners would tell how it is turned."""
    y, x = np.mgrid[0:SIDE, 0:SIDE] - (SIDE - 1) / 2
    angle, radius = np.arctan2(y, x) % (2 * np.pi / order), np.hypot(x, y)
    at = [(radius * each + SIDE / 2).astype(np.float32) for each in (np.cos(angle), np.sin(angle))]
    texture = cv2.GaussianBlur(procedural_texture(SIDE + 200, SIDE + 200, 3), (0, 0), 2.0)
    image = cv2.GaussianBlur(cv2.remap(texture, at[0], at[1], cv2.INTER_LINEAR), (0, 0), 1.5)
    image[radius > SIDE / 2 - 4] = 230
    return image


def star(order: int) -> np.ndarray:
    """Blades about a centre, as many as the order, that no mirror maps to each other."""
    image = np.full((SIDE, SIDE), 240, np.uint8)
    blade = np.array([[0, -20], [232, -10], [200, 60], [150, 20], [90, 90], [10, 20]], float)
    for k in range(order):
        c, s = np.cos(2 * np.pi * k / order), np.sin(2 * np.pi * k / order)
        at = blade @ np.array([[c, s], [-s, c]]) + (SIDE - 1) / 2
        cv2.fillPoly(image, [np.rint(at * 16).astype(np.int32)], 20, cv2.LINE_AA, 4)
    return image


@pytest.mark.parametrize("tracking", [False, True])
@pytest.mark.parametrize(
    ("pixels", "turns"), [(turned_into_itself(False), (180,)), (rosette(3), (120, 240)), (rosette(4), (90, 180, 270))]
)
def test_a_symmetric_target_has_a_pose_for_each_turn(pixels: np.ndarray, turns: tuple, tracking: bool) -> None:
    parameters = parameters_from({"tracking.enabled": tracking})
    target = TargetImage("picture", pixels, 0.3)
    localizer = Localizer(parameters, prepare_references([target], parameters))
    squared = []
    for simulated in simulate_sequence(Simulation(640, 480, frames=8, seed=2), [target]):
        result, truth = localizer.process(simulated.frame).first, simulated.truths[0]
        assert result.pose is None
        if result.homography is None:
            continue
        assert result.pose_status is PoseStatus.AMBIGUOUS
        assert "looks the same turned by " + " or ".join(map(str, turns)) in result.reason
        assert result.ambiguity == 1.0
        assert len(result.solutions) % (1 + len(turns)) == 0
        errors = [
            corner_error(result.homography.H @ S, truth.H, (SIDE, SIDE), (640, 480)) for S in (np.eye(3), *result.alike)
        ]
        assert min(errors) < 1.0 and sorted(errors)[1] > 50
        away = [Rotation.from_matrix(truth.pose.R @ pose.R.T).as_rotvec() for pose in result.solutions]
        best = int(np.argmin(np.linalg.norm(away, axis=1)))
        pose = result.solutions[best]
        error = np.concatenate((truth.pose.t - pose.t, away[best]))
        squared.append(error @ np.linalg.solve(pose.covariance, error))
    assert len(squared) >= 7
    assert np.median(squared) < 12.6  # the 95 % point


def test_what_was_hidden_tells_the_copies_of_a_track_apart() -> None:
    """A mark that is covered at first; from the frame on that shows it the pose is one, and stays one."""
    known, covered = turned_into_itself(mark=False), turned_into_itself(mark=True)
    target = TargetImage("picture", covered, 0.3)
    localizer = Localizer(Parameters(), prepare_references([target], Parameters()))
    localizer.prepare()
    seen = []
    sequences = [
        list(simulate_sequence(Simulation(640, 480, frames=12, seed=4), [TargetImage("picture", pixels, 0.3)]))
        for pixels in (known, covered)
    ]
    for index in range(12):
        result = localizer.process(sequences[index >= 4][index].frame).first
        seen.append(result.pose_status)
        if result.pose is not None:
            error = corner_error(result.homography.H, sequences[1][index].truths[0].H, (SIDE, SIDE), (640, 480))
            assert error < 1.0
    assert PoseStatus.METRIC not in seen[:4]
    assert seen[6:] == [PoseStatus.METRIC] * 6


def test_a_neighbour_in_the_map_tells_how_a_symmetric_target_is_turned() -> None:
    names = {"targets.images": ["a.png", "b.png"], "targets.widths_m": [0.3, 0.3]}
    other = TargetImage("other", procedural_texture(SIDE, SIDE, 9), 0.3)
    targets = [TargetImage("picture", turned_into_itself(mark=False), 0.3), other]
    frames = list(simulate_sequence(Simulation(640, 480, frames=8, seed=3), targets))
    first, second = (truth.pose for truth in frames[0].truths)
    place = first.inverse().after(second).numbers()
    poses = [0, 0, 0, 0, 0, 0, 1, *place.tolist()]
    parameters = parameters_from({**names, "targets.poses": poses})
    localizer = Localizer(parameters, prepare_references(targets, parameters))
    found = 0
    for simulated in frames:
        results, truth = localizer.process(simulated.frame).references, simulated.truths[0]
        result = results["picture"]
        if results["other"].pose is None:
            continue
        assert result.pose_status is PoseStatus.METRIC, result.reason
        assert result.homography is not None and result.pose is not None and result.outline is not None
        assert corner_error(result.homography.H, truth.H, (SIDE, SIDE), (640, 480)) < 1.0
        corner = truth.H @ (-0.5, -0.5, 1)
        assert result.outline[0] == pytest.approx(corner[:2] / corner[2], abs=1.0)
        turn = Rotation.from_matrix(truth.pose.R @ result.pose.R.T).magnitude()
        assert turn < 0.05 and np.linalg.norm(truth.pose.t - result.pose.t) < 0.02
        found += 1
    assert found >= 6


def test_a_mark_tells_how_the_target_is_turned() -> None:
    parameters = parameters_from({"tracking.enabled": False})
    target = TargetImage("picture", turned_into_itself(mark=True), 0.3)
    localizer = Localizer(parameters, prepare_references([target], parameters))
    for simulated in simulate_sequence(Simulation(640, 480, frames=6, seed=2), [target]):
        result = localizer.process(simulated.frame).first
        assert result.homography is not None, result.reason
        assert corner_error(result.homography.H, simulated.truths[0].H, (SIDE, SIDE), (640, 480)) < 1.0


def pad() -> np.ndarray:
    """A ring, bars that half a turn maps to themselves, and two figures below them."""
    image = np.full((SIDE, SIDE, 3), (70, 110, 90), np.uint8)
    cv2.circle(image, (240, 240), 215, (245, 245, 245), 22, cv2.LINE_AA)
    for left, top, right, bottom in ((150, 120, 190, 360), (290, 120, 330, 360), (150, 220, 330, 260)):
        cv2.rectangle(image, (left, top), (right, bottom - 1), (245, 245, 245), -1)
    cv2.putText(image, "62", (206, 420), cv2.FONT_HERSHEY_SIMPLEX, 1.7, (245, 245, 245), 7, cv2.LINE_AA)
    return image


def test_a_copy_is_known_to_a_fraction_of_a_pixel() -> None:
    turned = next(copy for copy in copies(pad()) if copy.turn_deg == 180.0)
    corners = np.array([[0, SIDE - 1, 0], [0, 0, SIDE - 1], [1, 1, 1.0]])
    at = turned.H @ corners
    assert np.abs(at[:2] / at[2] - (SIDE - 1 - corners[:2])).max() < 1.0


@pytest.mark.parametrize("hidden", [False, True])
def test_where_what_tells_is_hidden_there_is_no_pose(hidden: bool) -> None:
    parameters = parameters_from({"tracking.enabled": False})
    pixels = pad()
    localizer = Localizer(parameters, prepare_references([TargetImage("pad", pixels, 0.3)], parameters))
    shown = pixels.copy()
    if hidden:
        cv2.ellipse(shown, (240, 400), (70, 50), 0, 0, 360, (60, 60, 150), -1, cv2.LINE_AA)
    for simulated in simulate_sequence(Simulation(640, 480, frames=6, seed=2), [TargetImage("pad", shown, 0.3)]):
        result = localizer.process(simulated.frame).first
        assert (result.pose is None) == hidden
        if hidden:
            assert "turned" in result.reason and (result.homography is None or len(result.alike) == 1)
        else:
            assert result.homography is not None, result.reason
            assert corner_error(result.homography.H, simulated.truths[0].H, (SIDE, SIDE), (640, 480)) < 1.0


def aligned_patches(image: FrameImage, known: Reference, start: np.ndarray) -> PatchAlignment | None:
    try:
        return align_patches(image, known, start, None, Parameters().refinement, 8, 8.0)
    except EstimationError:
        return None


def test_a_track_that_began_a_period_away_ends() -> None:
    """Most of a pattern confirms it there."""
    tile = procedural_texture(120, 480, 5)
    pixels = np.ascontiguousarray(np.hstack((tile,) * 4))
    cv2.circle(pixels, (60, 380), 50, (250, 40, 40), -1, cv2.LINE_AA)
    target = TargetImage("picture", pixels, 0.3)
    localizer = Localizer(Parameters(), prepare_references([target], Parameters()))
    known = localizer.references[0]
    for simulated in simulate_sequence(Simulation(640, 480, frames=4, seed=2), [target]):
        H = simulated.truths[0].H
        image = develop_frame(simulated.frame, DevelopmentParameters.of(Parameters())).image
        assert image is not None
        right, wrong = (aligned_patches(image, known, start) for start in (H, H @ SHIFT))
        require_no_better_copy(image, known, right, None)
        if wrong is not None and corner_error(wrong.homography.H, H, known.size, (640, 480)) > 10:
            with pytest.raises(LooksAlike):
                require_no_better_copy(image, known, wrong, None)
            break
    else:
        pytest.fail("no start a period away was aligned")
