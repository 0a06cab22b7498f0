# SPDX-License-Identifier: Apache-2.0
"""Dots of a calibration board, drawn by themselves."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from imgu_ros.errors import ShapeError
from imgu_ros.vision.camera.dot_grid import find_dots


def drawn(columns: int, rows: int, is_shifted: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return a picture of dots, seen obliquely, and their centres, row by row."""
    row, column = np.divmod(np.arange(rows * columns), columns)
    x = column * (2.0 if is_shifted else 1.0) + is_shifted * (row % 2)
    at = 40 * np.column_stack((x, row)) + 80
    flat = np.full((40 * rows + 160, int(at[:, 0].max()) + 120), 230, np.uint8)
    for centre in at:
        cv2.circle(flat, np.rint(centre).astype(int).tolist(), 12, 30, -1, cv2.LINE_AA)
    H = np.array([[0.9, 0.1, 10], [-0.1, 0.8, 60], [2e-4, 3e-4, 1]])
    seen = np.column_stack((at, np.ones(len(at)))) @ H.T
    picture = cv2.warpPerspective(flat, H, (640, 480), borderValue=230)
    return cv2.GaussianBlur(picture, (0, 0), 0.8), seen[:, :2] / seen[:, 2:]


@pytest.mark.parametrize(("columns", "rows", "is_shifted"), [(6, 5, False), (5, 5, False), (4, 7, True)])
def test_dots_are_found_where_they_were_drawn(columns: int, rows: int, is_shifted: bool) -> None:
    picture, at = drawn(columns, rows, is_shifted)
    found = find_dots(picture, columns, rows, is_shifted)
    assert found is not None
    nearest = np.linalg.norm(found[:, None] - at, axis=2)
    assert nearest.min(axis=1).max() < 0.5 and len(set(nearest.argmin(axis=1))) == len(at)


def test_another_grid_is_none() -> None:
    picture, _ = drawn(6, 5, False)
    assert find_dots(picture, 7, 5) is None
    assert find_dots(np.full((100, 100), 200, np.uint8), 4, 4) is None


def test_wrong_arguments() -> None:
    with pytest.raises(ShapeError, match="columns, rows: 2, 4; need 3 to 100"):
        find_dots(np.zeros((9, 9), np.uint8), 2, 4)
