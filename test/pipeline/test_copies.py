# SPDX-License-Identifier: Apache-2.0
"""Targets that look like themselves when turned or shifted: known beforehand, and never found at the wrong place."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

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


def test_a_picture_without_order_has_no_copies() -> None:
    assert copies(procedural_texture(640, 480, 7)) == ()


@pytest.mark.parametrize("mark", [True, False])
def test_a_copy_is_never_taken_for_the_target(mark: bool) -> None:
    parameters = parameters_from({"tracking.enabled": False})
    pixels = turned_into_itself(mark)
    target = TargetImage("picture", pixels, 0.3)
    localizer = Localizer(parameters, prepare_references([target], parameters))
    for simulated in simulate_sequence(Simulation(640, 480, frames=6, seed=2), [target]):
        result = localizer.process(simulated.frame).first
        if mark:
            assert result.homography is not None, result.reason
            assert corner_error(result.homography.H, simulated.truths[0].H, (SIDE, SIDE), (640, 480)) < 1.0
        else:
            assert result.homography is None
            assert "the target looks the same turned by 180 degrees" in result.reason


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
def test_where_what_tells_is_hidden_nothing_is_found(hidden: bool) -> None:
    parameters = parameters_from({"tracking.enabled": False})
    pixels = pad()
    localizer = Localizer(parameters, prepare_references([TargetImage("pad", pixels, 0.3)], parameters))
    shown = pixels.copy()
    if hidden:
        cv2.ellipse(shown, (240, 400), (70, 50), 0, 0, 360, (60, 60, 150), -1, cv2.LINE_AA)
    for simulated in simulate_sequence(Simulation(640, 480, frames=6, seed=2), [TargetImage("pad", shown, 0.3)]):
        result = localizer.process(simulated.frame).first
        if hidden:
            assert result.homography is None
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
