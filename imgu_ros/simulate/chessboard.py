# SPDX-License-Identifier: Apache-2.0
"""Views of a chessboard with known corners, through any lens: for calibration's tests, benchmark and pictures."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Image, Points
from imgu_ros.vision.camera.chessboard import Chessboard
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.camera.rotation import exp_so3

_DARK, _LIGHT, _AROUND = 30.0, 220.0, 90.0
_SUPERSAMPLING = 4  # rays a pixel, in each direction
_STEP = 2
#: Where a pixel without a ray looks: beside every board.
_NOWHERE = 1e6
_MOST_TRIES = 400


@dataclass(frozen=True, slots=True, eq=False)
class ChessboardView:
    """A true view: camera_from_board, and where the inner corners are, (N, 2) raw px."""

    pose: RigidTransform
    corners: Points


def random_chessboard_view(board: Chessboard, camera: Camera, rng: np.random.Generator) -> ChessboardView:
    """Return a view of the whole board, tilted by 10 to 50 degrees, turned and placed at random in the picture.

    Raises
    ------
    ShapeError
        If no such view is found.
    """
    flat = np.column_stack((board.corners(), np.zeros(board.columns * board.rows)))
    middle = flat.mean(axis=0)
    outer = flat[[0, board.columns - 1, -board.columns, -1]] - middle
    diagonal = float(np.linalg.norm(outer[3] - outer[0]))
    size = np.array([camera.width, camera.height])
    for _ in range(_MOST_TRIES):
        ray = camera.undistort(rng.uniform(0.15, 0.85, (1, 2)) * size)[0][0]
        tilt, about, turn = math.radians(rng.uniform(10, 50)), rng.uniform(0, 2 * math.pi), rng.uniform(0, 2 * math.pi)
        R = exp_so3([0, 0, turn]) @ exp_so3([math.cos(about) * tilt, math.sin(about) * tilt, 0])
        # The diagonal of a board straight ahead takes 0.5 to 1.1 of the picture's height.
        depth = diagonal * float(camera.K[1, 1]) / (rng.uniform(0.5, 1.1) * camera.height)
        centre = np.array([*ray, 1.0]) * depth
        if not _is_seen(outer @ R.T + centre, camera, 0.1 * depth):
            continue
        points = (flat - middle) @ R.T + centre
        if _is_seen(points, camera, 0.1 * depth):
            return ChessboardView(RigidTransform(R, centre - R @ middle), camera.project(points))
    raise ShapeError(f"camera: no view of the whole {board.columns}x{board.rows} board in {_MOST_TRIES} tries")


def _is_seen(points: Floats, camera: Camera, nearest: float) -> bool:
    """Whether all points have a picture, 8 px and more from the edge."""
    if points[:, 2].min() < nearest:
        return False
    pixels = camera.project(points)
    inside = (pixels >= 8).all() and (pixels < np.array([camera.width, camera.height]) - 9).all()
    # Beyond the lens model's fold a point has a picture that is not its own.
    return bool(inside and np.allclose(camera.undistort(pixels)[0], points[:, :2] / points[:, 2:], atol=1e-6))


def draw_chessboard(
    board: Chessboard, camera: Camera, pose: RigidTransform, noise: float = 0.0, rng: np.random.Generator | None = None
) -> Image:
    """Draw a view of a board on a white sheet, every pixel the mean of 4 x 4 rays.

    Parameters
    ----------
    board : with one square of white around its outer squares
    camera : through which it is seen
    pose : camera_from_board
    noise : standard deviation of the pixels, grey levels of 255; 0: none
    rng : source of the noise

    Returns
    -------
    (height, width) uint8
    """
    # The lens is followed exactly at every other pixel, and linearly between: right to a thousandth of a pixel.
    columns, rows = -(-camera.width // _STEP) + 1, -(-camera.height // _STEP) + 1
    nodes = np.stack(np.meshgrid(np.arange(columns) * _STEP - 0.5, np.arange(rows) * _STEP - 0.5), axis=-1)
    normalized, valid = camera.undistort(nodes.reshape(-1, 2))
    normalized[~valid] = _NOWHERE
    grid = normalized.reshape(rows, columns, 2)
    fine = (np.arange(_STEP * _SUPERSAMPLING) + 0.5) / (_STEP * _SUPERSAMPLING)
    bands = []
    for row in range(rows - 1):
        down = grid[row] * (1 - fine)[:, None, None] + grid[row + 1] * fine[:, None, None]
        across = down[:, :-1, None] * (1 - fine)[:, None] + down[:, 1:, None] * fine[:, None]
        shade = _shade(board, pose, across.reshape(len(fine), -1, 2))
        bands.append(cv2.resize(shade, ((columns - 1) * _STEP, _STEP), interpolation=cv2.INTER_AREA))
    picture = np.vstack(bands)[: camera.height, : camera.width]
    if noise and rng is not None:
        picture = picture + rng.normal(0, noise, picture.shape)
    return np.asarray(np.clip(np.round(picture), 0, 255), np.uint8)


def _shade(board: Chessboard, pose: RigidTransform, normalized: Floats) -> Image:
    rays = normalized @ pose.R[:2] + pose.R[2]  # in the board's frame
    centre = -pose.R.T @ pose.t
    meets = rays[..., 2] * centre[2] < 0
    along = np.where(meets, -centre[2] / np.where(meets, rays[..., 2], 1.0), 0.0)
    squares_xy = (centre[:2] + along[..., None] * rays[..., :2]) / board.square_m
    column, row = (np.floor(np.clip(squares_xy[..., i], -9, 999)).astype(np.int32) for i in (0, 1))
    sheet = meets & (column >= -2) & (column <= board.columns) & (row >= -2) & (row <= board.rows)
    squares = sheet & (column >= -1) & (column < board.columns) & (row >= -1) & (row < board.rows)
    dark = squares & ((column + row) % 2 == 0)
    return np.where(dark, _DARK, np.where(sheet, _LIGHT, _AROUND))
