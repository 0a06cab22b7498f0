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
_MOST_TRIES = 10_000


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
    size = float(np.linalg.norm(flat.max(axis=0) - flat.min(axis=0)))
    corners_px = np.array([(0.0, 0), (camera.width - 1.0, 0), (0, camera.height - 1.0)])
    normalized, valid = camera.undistort(np.vstack((corners_px, [camera.K[:2, 2]])))
    reach = float(np.clip(np.abs(normalized[valid]).max(initial=0), 0.05, 1.5))
    for _ in range(_MOST_TRIES):
        about = rng.uniform(0, 2 * math.pi)
        tilt = math.radians(rng.uniform(10, 50))
        R = exp_so3([0, 0, rng.uniform(-math.pi, math.pi)]) @ exp_so3(
            [math.cos(about) * tilt, math.sin(about) * tilt, 0]
        )
        depth = size / reach * rng.uniform(0.6, 1.6)
        centre = np.array([*rng.uniform(-reach, reach, 2) * depth, depth])
        points = (flat - middle) @ R.T + centre
        if points[:, 2].min() < 0.1 * depth:
            continue
        corners = camera.project(points)
        inside = (corners >= 8).all() and (corners < np.array([camera.width, camera.height]) - 9).all()
        # Beyond the lens model's fold a point has a picture that is not its own.
        if inside and np.allclose(camera.undistort(corners)[0], points[:, :2] / points[:, 2:], atol=1e-6):
            return ChessboardView(RigidTransform(R, centre - R @ middle), corners)
    raise ShapeError(f"camera: no view of the whole {board.columns}x{board.rows} board in {_MOST_TRIES} tries")


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
