# SPDX-License-Identifier: Apache-2.0
"""Chessboards and grids of dots: exact poses, every turn that looks the same said, and others that are not taken."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from marker_scenes import FINE, HEIGHT, exposed, nees, placed, put_sheet, scene

from imgu_ros.config.parameters import Parameters, TargetsParameters
from imgu_ros.config.values import parameters_from
from imgu_ros.files.target_images import load_target_images
from imgu_ros.frame import Frame
from imgu_ros.localizer import Localizer
from imgu_ros.reference.dot_layout import DotLayout
from imgu_ros.reference.marker_layout import MarkerLayout, PlacedSquares
from imgu_ros.reference.pattern import pattern_image
from imgu_ros.reference_kinds import make_references
from imgu_ros.result import PoseStatus, ReferenceResult, Status
from imgu_ros.types import Floats, Image

PX_M = 4000.0
Board = MarkerLayout | DotLayout


def chessboard(columns: int, rows: int, square: float = 0.03) -> MarkerLayout:
    return MarkerLayout((), PlacedSquares(columns, rows, square, first_is_black=True))


def localizer(board: Board, **values: object) -> Localizer:
    parameters = parameters_from({name.replace("__", "."): value for name, value in values.items()})
    return Localizer(parameters, make_references([pattern_image("board", board)], parameters))


def printed(board: Board, margin: float = 0.02) -> tuple[Image, Floats]:
    """Return a print, white 1 and black 0, and metres on its plane of its px: of every px's own middle."""
    if isinstance(board, DotLayout):
        rows, columns = np.indices((board.rows, board.columns))
        x = columns * (2 if board.is_shifted else 1) + board.is_shifted * (rows % 2)
        centres = board.spacing * np.stack((x - x.max() / 2, (board.rows - 1) / 2 - rows), axis=-1).reshape(-1, 2)
        half = np.abs(centres).max(axis=0) + board.diameter / 2 + margin
    else:
        squares = board.squares
        assert squares is not None
        half = squares.side * np.array((squares.columns, squares.rows)) / 2 + margin
    width, height = np.rint(2 * half * PX_M).astype(int)
    x = (np.arange(width) + 0.5) / PX_M - half[0]
    y = half[1] - (np.arange(height) + 0.5) / PX_M
    if isinstance(board, DotLayout):
        away = np.full((height, width), np.inf)
        for cx, cy in centres:
            np.minimum(away, np.hypot(x - cx, y[:, None] - cy), out=away)
        paper = np.clip((away - board.diameter / 2) * PX_M + 0.5, 0, 1).astype(np.float32)
    else:
        column = np.floor((x + half[0] - margin) / squares.side).astype(int)
        row = np.floor((half[1] - margin - y) / squares.side).astype(int)
        inside = ((row >= 0) & (row < squares.rows))[:, None] & (column >= 0) & (column < squares.columns)
        paper = np.where(inside & ((row[:, None] + column) % 2 == 0), 0, 1).astype(np.float32)
    return paper, np.array([[1 / PX_M, 0, x[0]], [0, -1 / PX_M, y[0]], [0, 0, 1]])


def frame_of(board: Board, R: Floats, t: Floats, index: int = 0, hidden_px: int = 0) -> Frame:
    light = scene()
    put_sheet(light, *printed(board), R, t)
    if hidden_px:
        texture = np.random.default_rng(0).uniform(0.1, 0.6, (12, 12)).astype(np.float32)
        light[:, : hidden_px * FINE] = cv2.resize(texture, (hidden_px * FINE, HEIGHT * FINE))
    return exposed(light, seed=index, index=index)


def errors_m(found: ReferenceResult, R: Floats, t: Floats) -> list[float]:
    """Return by how much each pose of a result puts three points of the plane elsewhere, m."""
    points = 0.1 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    return [
        float(np.abs(points @ pose.R.T + pose.t - points @ R.T - t).max())
        for pose in found.solutions
        if pose is not None
    ]


#: A board, and by what it may be turned and looks the same, degrees.
TURNS: list[tuple[Board, list[int]]] = [
    (chessboard(8, 5), []),
    (chessboard(7, 6), []),
    (chessboard(9, 7), [180]),
    (chessboard(8, 6), [180]),
    (chessboard(7, 7), [90, 180, 270]),
    (chessboard(6, 6), [180]),
    (DotLayout(7, 5, 0.03, 0.018), [180]),
    (DotLayout(6, 6, 0.03, 0.018), [90, 180, 270]),
    (DotLayout(4, 11, 0.02, 0.014, is_shifted=True), []),
    (DotLayout(4, 10, 0.02, 0.014, is_shifted=True), [180]),
]


def name_of(value: object) -> str:
    if isinstance(value, DotLayout):
        return f"{value.columns}x{value.rows} dots"
    if isinstance(value, MarkerLayout):
        return f"{value.squares.columns}x{value.squares.rows} squares"
    return "-".join(map(str, value))


@pytest.mark.parametrize(("board", "turns"), TURNS, ids=name_of)
def test_turns_that_look_the_same_are_known_and_said(board: Board, turns: list[int]) -> None:
    """By the parity of rows and columns; the pose, or one of those of its turns, is exact, detected and tracked."""
    own = localizer(board)
    (reference,) = own.references
    known = sorted(round(np.degrees(np.arctan2(S[1, 0], S[0, 0]))) % 360 for S in reference.symmetries)
    assert known == turns
    statuses = []
    for index in range(4):
        R, t = placed(0.01 * index, -0.02, 0.75, 30 + index, 20 + 2 * index)
        found = own.process(frame_of(board, R, t, index)).first
        statuses.append(found.status)
        errors = errors_m(found, R, t)
        assert min(errors) < 3e-4, (found.status, found.reason)
        if turns:
            assert found.pose_status is PoseStatus.AMBIGUOUS and found.pose is None
            assert len(found.solutions) % (len(turns) + 1) == 0 and "looks the same" in found.reason
        else:
            assert found.pose_status is PoseStatus.METRIC
            assert nees(found, R, t) < 22.5
    assert statuses == [Status.DETECTED, *[Status.TRACKED] * 3]


@pytest.mark.parametrize("board", [chessboard(8, 5), DotLayout(4, 11, 0.02, 0.014, is_shifted=True)], ids=name_of)
def test_views_of_all_kinds(board: Board) -> None:
    """Tilted, turned, near and far: found in each, none wrong."""
    own, rng = localizer(board, tracking__enabled=False), np.random.default_rng(5)
    for index in range(10):
        R, t = placed(*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.6, 1.1), rng.uniform(0, 50), rng.uniform(0, 360))
        found = own.process(frame_of(board, R, t, index)).first
        assert found.status is Status.DETECTED, found.reason
        assert min(errors_m(found, R, t)) < 1e-3
        if found.pose is not None:
            assert errors_m(found, R, t)[0] < 1e-3


@pytest.mark.parametrize(
    ("known", "shown"),
    [
        (chessboard(7, 5), chessboard(9, 7)),
        (chessboard(9, 7), chessboard(7, 5)),
        (chessboard(8, 5), chessboard(8, 6)),
        (DotLayout(5, 5, 0.03, 0.018), DotLayout(7, 5, 0.03, 0.018)),
        (DotLayout(4, 9, 0.02, 0.014, is_shifted=True), DotLayout(4, 11, 0.02, 0.014, is_shifted=True)),
    ],
)
def test_a_board_of_another_size_is_not_taken_for_it(known: Board, shown: Board) -> None:
    own = localizer(known)
    for index in range(3):
        R, t = placed(0.01, -0.02, 0.7, 20 + 10 * index)
        found = own.process(frame_of(shown, R, t, index)).first
        assert not found.status.found and found.reason


def test_a_part_that_is_hidden_or_out_of_view() -> None:
    """A track goes on, or ends; what goes out is right."""
    board, tracked = chessboard(8, 5), 0
    own = localizer(board)
    for index in range(12):
        R, t = placed(-0.02 * index, 0.0, 0.7, 25)
        found = own.process(frame_of(board, R, t, index, hidden_px=20 * index)).first
        tracked += found.status.found
        assert not found.status.found or min(errors_m(found, R, t)) < 1e-3
    assert tracked >= 7


def test_a_grid_may_be_seen_from_any_corner_but_not_mirrored() -> None:
    (reference,) = localizer(chessboard(8, 5)).references
    points, columns = reference.grid
    assert columns == 7 and len(points) == 28
    seen = points @ np.array([[0.0, 1], [-1, 0]]) + (300, 10)
    assert any(np.allclose(each, seen) for each in reference.turned(seen[::-1].copy()))
    mirrored = points * (-1, 1)
    assert not any(np.allclose(each, mirrored) for each in reference.turned(mirrored))


def test_entries_of_targets(tmp_path: Path) -> None:
    texts = {
        "wall.yaml": "chessboard: {columns: 8, rows: 5, square: 0.03}",
        "floor.yaml": "dots: {columns: 4, rows: 11, spacing: 0.02, diameter: 0.014, shifted: true}",
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    images = tuple(str(tmp_path / name) for name in texts)
    wall, floor = load_target_images(TargetsParameters(images=images, widths_m=(0.0, 0.28)))
    assert wall.layout == chessboard(8, 5) and wall.width_m == pytest.approx(0.24)
    assert floor.layout == DotLayout(4, 11, 0.02, 0.014, is_shifted=True) and floor.width_m == 0.28
    references = make_references([wall, floor], Parameters())
    # From edge to edge of what is black: seven steps of 20 mm and a dot.
    assert floor.layout.width == pytest.approx(7 * 0.02 + 0.014)
    assert [each.kind for each in references] == ["pattern", "pattern"]
