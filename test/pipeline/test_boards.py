# SPDX-License-Identifier: Apache-2.0
"""Boards of markers: poses against exact truth and single markers, what is hidden, and what is not the board."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from marker_scenes import FAMILY, FINE, HEIGHT, WIDTH, K, error_m, exposed, nees, placed, put_sheet, scene, sheet

from imgu_ros.config.parameters import Parameters
from imgu_ros.localizer import Localizer
from imgu_ros.reference.marker import MarkerReference, board_image, marker_image
from imgu_ros.reference.marker_layout import MarkerLayout, PlacedMarker, charuco_layout, grid_layout
from imgu_ros.reference_kinds import make_references
from imgu_ros.result import PoseStatus, Status
from imgu_ros.types import Floats, Image
from imgu_ros.vision.markers.dictionaries import marker_codes

pytestmark = pytest.mark.skipif(not hasattr(cv2, "aruco"), reason="this OpenCV has no aruco module")

GRID = grid_layout(FAMILY, 2, 3, 0.08, 0.02, range(6))
IDS = tuple(range(6))


def board_scene(layout: MarkerLayout, R: Floats, t: Floats) -> Image:
    light = scene()
    put_sheet(light, *sheet(layout.markers), R, t)
    return light


def hide(light: Image, left: float, top: float, right: float, bottom: float, value: float = 0.2) -> None:
    """Cover a part of the frame, px, with something of a texture of its own."""
    part = light[round(top * FINE) : round(bottom * FINE), round(left * FINE) : round(right * FINE)]
    noise = np.random.default_rng(0).uniform(-0.1, 0.1, (9, 12)).astype(np.float32)
    part[:] = value + cv2.resize(noise, part.shape[::-1], interpolation=cv2.INTER_CUBIC)


def localizer(layout: MarkerLayout = GRID, *others: int) -> Localizer:
    images = [board_image("board", layout), *(marker_image(f"m{number}", FAMILY, number, 0.08) for number in others)]
    return Localizer(Parameters(), make_references(images, Parameters()))


def test_a_board_is_found_and_tracked_more_exactly_than_its_markers() -> None:
    """Beside single markers of the same frames, each judged by the error of its own centre."""
    own = localizer()
    singles = Localizer(
        Parameters(), make_references([marker_image(f"m{n}", FAMILY, n, 0.08) for n in IDS], Parameters())
    )
    errors, others, squared, statuses = [], [], [], []
    for index in range(6):
        R, t = placed(0.03 + 0.01 * index, -0.02, 1.2, 30 + 2 * index, 10 * index + 4)
        frame = exposed(board_scene(GRID, R, t), seed=index, index=index)
        found = own.process(frame).first
        statuses.append(found.status)
        errors.append(error_m(found, t))
        squared.append(nees(found, R, t))
        for marker, result in zip(GRID.markers, singles.process(frame), strict=True):
            at = R @ (marker.x, marker.y, 0) + t
            others.append(float(np.linalg.norm(result.solutions[0].t - at)) if result.solutions else np.inf)
    assert statuses == [Status.DETECTED, *[Status.TRACKED] * 5]
    assert max(errors) < 3e-4
    assert np.median(errors) < np.median(others) / 2
    assert np.median(squared) < 12.59


def test_turned_markers_of_several_sizes_and_families_with_an_origin_of_their_own() -> None:
    layout = MarkerLayout(
        (
            PlacedMarker(FAMILY, 3, 0.08, 0.1, 0.1, 1),
            PlacedMarker("aruco_4x4_50", 7, 0.05, 0.0, 0.0, 2),
            PlacedMarker("tag25h9", 4, 0.06, 0.2, 0.0, 3),
        )
    )
    R, t = placed(-0.1, 0.02, 0.8, 35)
    found = localizer(layout).process(exposed(board_scene(layout, R, t))).first
    assert error_m(found, t) < 5e-4
    assert nees(found, R, t) < 22.5
    assert found.outline is not None
    corners = np.array([[-0.025, 0.14], [0.23, 0.14], [0.23, -0.03], [-0.025, -0.03]])
    seen = (corners @ R[:, :2].T + t) @ K.T
    assert np.abs(found.outline - seen[:, :2] / seen[:, 2:]).max() < 0.1


def test_a_charuco_board() -> None:
    layout = charuco_layout("aruco_4x4_50", 5, 4, 0.05, 0.035, range(10), is_legacy=True)
    # That the picture is OpenCV's is another test's matter: here it is the print.
    template = board_image("b", layout).template
    px_m = (template.outline[2] - template.outline[0]) / 0.25
    plane_from_px = np.array([[1 / px_m, 0, -0.125 + 0.5 / px_m], [0, -1 / px_m, 0.1 - 0.5 / px_m], [0, 0, 1]])
    R, t = placed(0.02, 0.01, 0.7, 40)
    light = scene()
    put_sheet(light, template.drawn(1.0), plane_from_px, R, t)
    found = localizer(layout).process(exposed(light)).first
    assert error_m(found, t) < 3e-4
    assert nees(found, R, t) < 22.5


@pytest.mark.parametrize("side", ["left", "right", "top"])
def test_half_covered_it_is_detected_and_tracked(side: str) -> None:
    R, t = placed(0.0, 0.0, 0.9, 25)
    box = {"left": (0, 0, 320, HEIGHT), "right": (320, 0, WIDTH, HEIGHT), "top": (0, 0, WIDTH, 240)}[side]
    tracked = localizer()
    assert tracked.process(exposed(board_scene(GRID, R, t))).first.status is Status.DETECTED
    covered = board_scene(GRID, R, t)
    hide(covered, *box)
    for own, expected in ((tracked, Status.TRACKED), (localizer(), Status.DETECTED)):
        found = own.process(exposed(covered, 1, index=1)).first
        assert found.status is expected, found.reason
        assert error_m(found, t) < 1e-3
        assert found.confirmed_share is not None and found.confirmed_share < 0.9


def test_something_moves_across_it() -> None:
    """What covers it never bends a pose: every one that goes out is exact."""
    own = localizer()
    count = 0
    for index in range(18):
        R, t = placed(0.004 * index - 0.04, -0.01, 0.8, 25 + 0.6 * index, 10 + index)
        light = board_scene(GRID, R, t)
        left = 32 * index - 60
        hide(light, max(left, 0), 0, min(max(left + 130, 1), WIDTH), HEIGHT)
        found = own.process(exposed(light, index, index=index)).first
        if found.pose is not None:
            count += 1
            assert error_m(found, t) < 2e-4
            assert nees(found, R, t) < 30
    assert count >= 14


def test_one_marker_in_view_is_enough_to_start() -> None:
    R, t = placed(0.0, 0.0, 0.6, 15)
    light = board_scene(GRID, R, t)
    first = GRID.markers[0]
    corners = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) * 0.05 + (first.x, first.y)
    seen = (corners @ R[:, :2].T + t) @ K.T
    (left, top), (right, bottom) = (f(seen[:, :2] / seen[:, 2:], axis=0) for f in (np.min, np.max))
    for box in ((0, 0, left, HEIGHT), (right, 0, WIDTH, HEIGHT), (0, 0, WIDTH, top), (0, bottom, WIDTH, HEIGHT)):
        hide(light, *box)
    found = localizer().process(exposed(light)).first
    assert found.status is Status.DETECTED, found.reason
    assert np.linalg.norm(found.solutions[0].t - t) < 5e-3


def test_half_out_of_view_it_is_tracked() -> None:
    own = localizer()
    statuses = []
    for index in range(8):
        R, t = placed(0.12 + 0.025 * index, 0, 0.6, 20)
        found = own.process(exposed(board_scene(GRID, R, t), index, index=index)).first
        statuses.append(found.status)
        assert error_m(found, t) < 1e-3
    # In the last frame its middle is at 0.295 m, beyond the border at 0.282 m.
    assert statuses == [Status.DETECTED, *[Status.TRACKED] * 7]


@pytest.mark.parametrize("number", [77, 586, "opposite"])
def test_another_id_at_a_place_of_it_is_not_the_board(number: int | str) -> None:
    """Detected, and tracked when it is exchanged; also one most of whose cells have the opposite colour."""
    if number == "opposite":
        codes = 2.0 * marker_codes(FAMILY).reshape(587, -1) - 1
        number = int(np.argmin(codes @ codes[4]))
    R, t = placed(0, 0, 0.7, 25)
    other = MarkerLayout((*GRID.markers[:4], PlacedMarker(FAMILY, int(number), 0.08, 0.0, -0.05), GRID.markers[5]))
    own = localizer()
    assert own.process(exposed(board_scene(GRID, R, t))).first.status is Status.DETECTED
    for each in (own, localizer()):
        found = each.process(exposed(board_scene(other, R, t), 1, index=1)).first
        assert found.status is Status.LOST
        assert found.pose is None
        assert found.reason


def test_markers_at_other_places_are_not_the_board() -> None:
    """The same ids, otherwise arranged."""
    R, t = placed(0, 0, 0.7, 25)
    other = grid_layout(FAMILY, 2, 3, 0.08, 0.02, [5, 3, 1, 0, 2, 4])
    found = localizer().process(exposed(board_scene(other, R, t))).first
    assert found.status is Status.LOST


def test_two_of_the_same_board_are_reported() -> None:
    small = grid_layout(FAMILY, 1, 2, 0.06, 0.02, range(2))
    light = scene()
    for x in (-0.12, 0.12):
        put_sheet(light, *sheet(small.markers), *placed(x, 0, 0.7, 20))
    found = localizer(small).process(exposed(light)).first
    assert found.status is Status.LOST
    assert "2 markers with its id are in view" in found.reason


def test_a_stray_marker_with_one_of_its_ids_does_not_matter() -> None:
    R, t = placed(-0.05, 0, 0.8, 25)
    light = board_scene(GRID, R, t)
    put_sheet(light, *sheet([PlacedMarker(FAMILY, 2, 0.08)]), *placed(0.22, 0.1, 0.8, 10))
    assert error_m(localizer().process(exposed(light)).first, t) < 5e-4


def test_boards_and_markers_in_one_list() -> None:
    R, t = placed(-0.05, 0, 0.8, 25)
    light = board_scene(GRID, R, t)
    place = placed(0.22, 0.1, 0.8, 10)
    put_sheet(light, *sheet([PlacedMarker(FAMILY, 99, 0.08)]), *place)
    board, marker, absent = localizer(GRID, 99, 100).process(exposed(light))
    assert error_m(board, t) < 5e-4
    assert np.linalg.norm(marker.solutions[0].t - place[1]) < 2e-3
    assert absent.status is Status.LOST


def test_far_away_and_straight_on_it_is_ambiguous() -> None:
    """Two poses are weighed and reported; neither goes out."""
    small = grid_layout(FAMILY, 1, 2, 0.035, 0.01, range(2))
    R, t = placed(0, 0, 1.0, 2)
    found = localizer(small).process(exposed(board_scene(small, R, t))).first
    assert found.pose_status is PoseStatus.AMBIGUOUS
    assert found.pose is None and len(found.solutions) == 2
    assert min(np.linalg.norm(cv2.Rodrigues(R @ pose.R.T)[0]) for pose in found.solutions) < 0.1


def test_templates_are_the_same_whatever_the_width() -> None:
    (one,) = make_references([board_image("board", GRID)], Parameters())
    (two,) = make_references([board_image("other", GRID, 0.5)], Parameters())
    (three,) = make_references([board_image("board", grid_layout(FAMILY, 2, 3, 0.08, 0.03, IDS))], Parameters())
    assert isinstance(one, MarkerReference)
    assert one.has_template_of(two) and not one.has_template_of(three)
    assert (one.kind, one.image.kind) == ("marker", "board")


def test_a_board_of_one_marker_is_that_marker() -> None:
    R, t = placed(0.05, 0.02, 0.7, 30)
    light = board_scene(MarkerLayout((PlacedMarker(FAMILY, 7, 0.1),)), R, t)
    alone = MarkerLayout((PlacedMarker(FAMILY, 7, 0.1),))
    images = [board_image("board", alone)], [marker_image("board", FAMILY, 7, 0.1)]
    first, second = (
        Localizer(Parameters(), make_references(each, Parameters())).process(exposed(light)).first for each in images
    )
    assert first.pose is not None and second.pose is not None
    assert np.allclose(first.pose.t, second.pose.t, rtol=0, atol=1e-9)
    assert np.allclose(first.pose.covariance, second.pose.covariance, rtol=1e-6)
