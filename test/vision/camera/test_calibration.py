# SPDX-License-Identifier: Apache-2.0
"""Calibration: exact, with an honest covariance, with outliers, and refusing what does not determine a camera."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from imgu_ros.errors import DegenerateConfiguration, EstimationError, ShapeError, TooFewPoints
from imgu_ros.simulate.chessboard import draw_chessboard, random_chessboard_view
from imgu_ros.vision.camera.calibration import Calibration, calibrate
from imgu_ros.vision.camera.chessboard import Chessboard, find_chessboard
from imgu_ros.vision.camera.intrinsics import Camera, make_camera
from imgu_ros.vision.camera.rotation import exp_so3
from imgu_ros.vision.camera.view_choice import board_turns, choose_views

BOARD = Chessboard(9, 6, 0.025)
XY = BOARD.corners()


def camera(model: str, k: tuple[float, ...], focal: float) -> Camera:
    return make_camera([[focal, 0, 655.0], [0, 0.98 * focal, 350], [0, 0, 1]], k, model, 1280, 720)


PLUMB_BOB = camera("plumb_bob", (-0.26, 0.09, 0.0008, -0.0005, -0.01), 900)
LENSES = {
    "plumb_bob": PLUMB_BOB,
    "telephoto": camera("plumb_bob", (0.05, 0.1, 0.0, 0.001, 0.0), 3500),
    "rational_polynomial": camera("rational_polynomial", (0.35, 0.08, 0.0006, -0.0004, 0.01, 0.62, 0.16, 0.01), 600),
    "equidistant": camera("equidistant", (-0.03, 0.008, -0.004, 0.001), 550),
}


def views(lens: Camera, count: int, seed: int, noise: float) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [random_chessboard_view(BOARD, lens, rng).corners + rng.normal(0, noise, XY.shape) for _ in range(count)]


def main_error(found: Calibration, truth: Camera) -> np.ndarray:
    return np.array([found.camera.K[i] - truth.K[i] for i in ((0, 0), (1, 1), (0, 2), (1, 2))])


@pytest.mark.parametrize("name", LENSES)
def test_exact_views_give_the_lens_back(name: str) -> None:
    lens = LENSES[name]
    found = calibrate(XY, views(lens, 8, 1, 0.0), 1280, 720, lens.model)
    # Judged where the lens is seen: rational coefficients nearly cancel each other.
    x, y = np.meshgrid(np.linspace(200, 1100, 7), np.linspace(150, 600, 5))
    rays = lens.undistort(np.column_stack((x.ravel(), y.ravel())))[0]
    assert_allclose(found.camera.distort(rays), lens.distort(rays), atol=0.02)
    assert_allclose(main_error(found, lens), 0, atol=0.01)
    assert found.rms_px < 1e-3
    assert not found.outliers


def test_normalised_squared_error_of_fifty_sets_is_that_of_four_degrees_of_freedom() -> None:
    squared = []
    for seed in range(50):
        found = calibrate(XY, views(PLUMB_BOB, 15, seed, 0.1), 1280, 720)
        error = main_error(found, PLUMB_BOB)
        squared.append(error @ np.linalg.solve(found.covariance[:4, :4], error))
        assert found.rms_px == pytest.approx(0.1, abs=0.01)
    assert 3 < np.mean(squared) < 5


def test_views_that_do_not_agree_are_refused() -> None:
    seen = views(PLUMB_BOB, 12, 3, 0.1)
    rng = np.random.default_rng(0)
    seen[4] = seen[4] + rng.normal(0, 2.0, XY.shape)
    seen[9] = np.roll(seen[9], 1, axis=0)  # corners counted from the wrong one
    found = calibrate(XY, seen, 1280, 720)
    assert [view.index for view in found.outliers] == [4, 9]
    assert [view.index for view in found.views] == [0, 1, 2, 3, 5, 6, 7, 8, 10, 11]
    error = main_error(found, PLUMB_BOB)
    assert error @ np.linalg.solve(found.covariance[:4, :4], error) < 20
    seen[9] = views(PLUMB_BOB, 1, 8, 0.1)[0]
    kept = calibrate(XY, seen, 1280, 720, refuse_outliers=False)
    assert not kept.outliers
    assert kept.rms_px > 5 * found.rms_px


def test_parallel_views_do_not_determine_the_focal_length() -> None:
    flat = np.column_stack((XY - XY.mean(axis=0), np.zeros(len(XY))))
    rng = np.random.default_rng(0)
    pinhole = make_camera(PLUMB_BOB.K, (), "plumb_bob", 1280, 720)
    parallel = [pinhole.project(flat + (0, 0, z)) + rng.normal(0, 0.1, XY.shape) for z in (0.3, 0.4, 0.5, 0.6)]
    with pytest.raises(DegenerateConfiguration, match="tilted"):
        calibrate(XY, parallel, 1280, 720)
    tilted = pinhole.project(flat @ exp_so3([0.5, 0.1, 0]).T + (0, 0, 0.5))
    with pytest.raises(EstimationError, match="views"):
        calibrate(XY, [tilted + rng.normal(0, 0.1, XY.shape) for _ in range(3)], 1280, 720, "rational_polynomial")


def held(turn: tuple[float, float, float], at: tuple[float, float, float]) -> np.ndarray:
    """The board turned about its centre, seen through the lens without noise."""
    flat = np.column_stack((XY - XY.mean(axis=0), np.zeros(len(XY))))
    return PLUMB_BOB.project(flat @ exp_so3(turn).T + at)


COPIES = {
    "the same file": lambda view, rng: view,
    "the next frames": lambda view, rng: view + rng.normal(0, 0.3, view.shape),
    "a tripod that shakes": lambda view, rng: view + rng.normal(0, 0.3, 2) + rng.normal(0, 0.1, view.shape),
    "counted from the other end": lambda view, rng: view[:: rng.choice((-1, 1))] + rng.normal(0, 0.1, view.shape),
}


@pytest.mark.parametrize("kind", COPIES)
@pytest.mark.parametrize("count", [6, 40])
def test_copies_of_a_view_count_as_one(kind: str, count: int) -> None:
    """Six copies of one view gave a focal length 83 px off, with a sigma of 8."""
    rng = np.random.default_rng(4)
    one = held((0.5, 0.2, 0.1), (0, 0, 0.4)) + rng.normal(0, 0.1, XY.shape)
    copies = [COPIES[kind](one, rng) for _ in range(count)]
    with pytest.raises(TooFewPoints, match=rf"{count} show 1 different one; need at least 3"):
        calibrate(XY, copies, 1280, 720)
    seen = views(PLUMB_BOB, 6, 1, 0.1)
    alone, crowded = calibrate(XY, [*seen, one], 1280, 720), calibrate(XY, [*seen, one, *copies], 1280, 720)
    assert crowded.copies == tuple(range(7, 7 + count))
    assert [view.index for view in crowded.views] == list(range(7))
    assert_allclose(crowded.covariance, alone.covariance, rtol=1e-9)


def test_two_views_held_for_long_are_two() -> None:
    rng = np.random.default_rng(0)
    two = [held((0.5, 0.2, 0.1), (0, 0, 0.4)), held((-0.4, 0.3, 0), (0.05, 0, 0.5))]
    with pytest.raises(TooFewPoints, match="40 show 2 different ones"):
        calibrate(XY, [view + rng.normal(0, 0.2, view.shape) for view in two for _ in range(20)], 1280, 720)


def test_a_square_board_counted_from_any_corner_is_one_view() -> None:
    square = Chessboard(7, 7, 0.025).corners()
    turns = board_turns(square)
    assert sorted(turn[0] for turn in turns) == [0, 6, 42, 48]
    flat = np.column_stack((square - square.mean(axis=0), np.zeros(49)))
    view = PLUMB_BOB.project(flat @ exp_so3((0.4, 0.2, 0)).T + (0, 0, 0.4))
    with pytest.raises(TooFewPoints, match="4 show 1 different one"):
        calibrate(square, [view[turn] for turn in turns], 1280, 720)
    assert choose_views([view[turn] for turn in turns], 1280, 720, board_xy=square) == (0,)
    assert len(choose_views([view[turn] for turn in turns], 1280, 720)) == 2
    with pytest.raises(ShapeError, match="board_xy: 54 points; need 49"):
        choose_views([view], 1280, 720, board_xy=XY)


@pytest.mark.parametrize("seed", range(5))
def test_one_tilt_is_refused_or_its_sigma_is_honest(seed: int) -> None:
    """A board that is moved about without being tilted, and one that wobbles in the hand."""
    rng = np.random.default_rng(seed)
    moved = [
        held((0.5, 0, 0), (x, y, 0.5)) + rng.normal(0, 0.1, XY.shape) for x in (-0.1, 0, 0.1) for y in (-0.04, 0.04)
    ]
    flat = [held((0, 0, 0), (x, y, 0.5)) + rng.normal(0, 0.1, XY.shape) for x in (-0.1, 0, 0.1) for y in (-0.04, 0.04)]
    wobbling = [
        held(tuple(rng.normal(0, 0.05, 3) + (0.5, 0, 0)), tuple(rng.normal(0, 0.01, 3) + (0, 0, 0.4)))
        + rng.normal(0, 0.1, XY.shape)
        for _ in range(12)
    ]
    for seen in (moved, flat, wobbling):
        try:
            found = calibrate(XY, seen, 1280, 720)
        except DegenerateConfiguration:
            continue
        error = main_error(found, PLUMB_BOB)
        assert error @ np.linalg.solve(found.covariance[:4, :4], error) < 25


def test_bad_input() -> None:
    seen = views(PLUMB_BOB, 3, 0, 0.1)
    with pytest.raises(TooFewPoints, match="need at least 3"):
        calibrate(XY, seen[:2], 1280, 720)
    with pytest.raises(ShapeError, match=r"views\[1\]: 53 points"):
        calibrate(XY, [seen[0], seen[1][:53], seen[2]], 1280, 720)
    with pytest.raises(ShapeError, match="distortion model"):
        calibrate(XY, seen, 1280, 720, "fisheye")
    with pytest.raises(DegenerateConfiguration, match="on a line"):
        calibrate(XY * (1, 0), seen, 1280, 720)
    with pytest.raises(ShapeError, match="size"):
        calibrate(XY, seen, 0, 720)
    with pytest.raises(ShapeError, match="px of a picture"):
        calibrate(XY, [*seen[:2], seen[2] * 1e60], 1280, 720)
    with pytest.raises(ShapeError, match="size of a board"):
        calibrate(XY * 1e60, seen, 1280, 720)
    for arguments, message in (((2, 6, 0.1), "inner corners"), ((9, 6, 0.0), "square"), ((9, 6, np.nan), "square")):
        with pytest.raises(ShapeError, match=message):
            Chessboard(*arguments)


@pytest.mark.parametrize("name", ["plumb_bob", "equidistant"])
def test_corners_are_found_to_a_few_hundredths_of_a_pixel(name: str) -> None:
    rng = np.random.default_rng(2)
    lens = make_camera([[450, 0, 325], [0, 450, 236], [0, 0, 1]], LENSES[name].distortion, name, 640, 480)
    view = random_chessboard_view(BOARD, lens, rng)
    corners = find_chessboard(draw_chessboard(BOARD, lens, view.pose, 2.0, rng), BOARD)
    assert corners is not None
    error = min(np.abs(corners - view.corners).max(), np.abs(corners[::-1] - view.corners).max())
    assert error < 0.25
    assert np.abs(np.mean(corners - view.corners, axis=0)).max() < 0.03  # no offset of half a pixel


def test_no_board_in_sight() -> None:
    rng = np.random.default_rng(0)
    assert find_chessboard(rng.integers(0, 255, (240, 320), np.uint8), BOARD) is None
    assert find_chessboard(np.full((3, 3), 7, np.uint8), BOARD) is None
    with pytest.raises(ShapeError):
        find_chessboard(np.full((20, 20), 200.0), BOARD)


def test_different_views_are_chosen() -> None:
    seen = views(PLUMB_BOB, 5, 0, 0.0)
    rng = np.random.default_rng(0)
    # A video: every view held for a while, the board now and then counted from the other end.
    video = [(view + rng.normal(0, 0.5, view.shape))[:: rng.choice((-1, 1))] for view in seen for _ in range(8)]
    chosen = choose_views(video, 1280, 720)
    assert [index // 8 for index in chosen] == [0, 1, 2, 3, 4]
    assert len(choose_views(video, 1280, 720, most=3)) == 3
    assert choose_views([], 1280, 720) == ()
    with pytest.raises(ShapeError, match="same number"):
        choose_views([seen[0], seen[1][:4]], 1280, 720)


def test_real_views(data_dir: Path) -> None:
    """13 of OpenCV's samples: 0.1954 px a corner with its detectors and a window of 11 px, by calibrateCamera."""
    files = sorted((data_dir / "chessboard").glob("left??.jpg"))
    if not files:
        pytest.skip("no chessboard pictures")
    seen = [find_chessboard(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE), BOARD) for file in files]
    assert all(corners is not None for corners in seen)
    found = calibrate(XY, seen, 640, 480)
    assert len(found.views) == 13
    assert found.rms_corner_px < 0.19
    flat = np.column_stack((XY, np.zeros(len(XY)))).astype(np.float32)
    pixels = [np.ascontiguousarray(corners[:, None], np.float32) for corners in seen]
    rms, K, *_ = cv2.calibrateCamera([flat] * len(seen), pixels, (640, 480), None, None)
    assert found.rms_corner_px == pytest.approx(rms, abs=1e-4)  # on the same corners: the same minimum
    assert np.abs(found.camera.K - K).max() < 0.05 * found.sigma[:4].min()
