# SPDX-License-Identifier: Apache-2.0
"""A valid call of every public function of the room, for the hostile test."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from imgu_ros.vision.camera.angle_of_view import angle_of_view, intrinsic_matrix, intrinsic_matrix_of_lens
from imgu_ros.vision.camera.bundle import BundleProblem
from imgu_ros.vision.camera.calibration import calibrate
from imgu_ros.vision.camera.camera_model import ProjectionModel, estimate_projection
from imgu_ros.vision.camera.chessboard import Chessboard, find_chessboard
from imgu_ros.vision.camera.correspondences import as_correspondences
from imgu_ros.vision.camera.decomposition import decompose_projection, rq
from imgu_ros.vision.camera.distortion import distort, distort_with_derivatives, fold_radius, undistort
from imgu_ros.vision.camera.distortion_model import DistortionModel, as_coefficients, as_distortion_model
from imgu_ros.vision.camera.dot_grid import find_dots
from imgu_ros.vision.camera.euler import euler_angles, from_euler
from imgu_ros.vision.camera.intrinsics import Camera, make_camera
from imgu_ros.vision.camera.planar_pose import planar_pose_starts, planar_poses
from imgu_ros.vision.camera.plane_view import plane_homography, pose_from_plane_homography
from imgu_ros.vision.camera.pose import PlanarPoses
from imgu_ros.vision.camera.pose_estimate import PoseModel, estimate_pose, fit_pose
from imgu_ros.vision.camera.pose_problem import PoseProblem, point_by_pose
from imgu_ros.vision.camera.projection import (
    as_intrinsic_matrix,
    camera_centre,
    camera_to_world,
    depths,
    finite_camera,
    project,
    projection_matrix,
    world_to_camera,
)
from imgu_ros.vision.camera.resection import design_matrix, fit_projection, projection_dlt
from imgu_ros.vision.camera.rigid import rigid_transform, rigid_transforms
from imgu_ros.vision.camera.rotation import (
    as_rotation,
    exp_so3,
    from_quaternion,
    log_so3,
    nearest_rotation,
    quaternion,
)
from imgu_ros.vision.camera.rotation_model import RotationModel, estimate_rotation
from imgu_ros.vision.camera.rotation_view import rotation_from_homography, rotation_homography
from imgu_ros.vision.camera.sensor_tilt import tilt_derivatives, tilt_matrix
from imgu_ros.vision.camera.view_choice import board_turns, choose_views, without_copies

Generator = np.random.Generator

MODEL = DistortionModel.PLUMB_BOB
BOARD = Chessboard(4, 3, 0.03)
TURNS = ((0.5, 0, 0.1), (0, 0.5, -0.2), (-0.5, 0.2, 0), (0.3, -0.5, 0.5))


def K() -> np.ndarray:
    return np.array([[500.0, 0, 320], [0, 490, 240], [0, 0, 1]])


def lens() -> np.ndarray:
    return np.array([-0.2, 0.05, 0.001, -0.0005, 0.01])


def camera() -> Camera:
    return make_camera(K(), lens(), "plumb_bob", 640, 480)


def turn(rng: Generator) -> np.ndarray:
    return exp_so3(rng.uniform(-0.4, 0.4, 3))


def shift() -> np.ndarray:
    return np.array([0.1, -0.05, 2.0])


def box(rng: Generator, count: int = 12) -> np.ndarray:
    return rng.uniform(-0.5, 0.5, (count, 3))


def matrix(rng: Generator) -> np.ndarray:
    return projection_matrix(K(), turn(rng), shift())


def pictured(rng: Generator) -> dict[str, Any]:
    P, world = matrix(rng), box(rng)
    return {"world": world, "pixels": project(P, world) + rng.normal(0, 0.1, (12, 2))}


def posed(rng: Generator) -> dict[str, Any]:
    points = box(rng)
    pixels = camera().project(points @ turn(rng).T + shift()) + rng.normal(0, 0.1, (12, 2))
    return {"points": points, "pixels": pixels, "camera": camera()}


def flat(rng: Generator, count: int = 12) -> dict[str, Any]:
    plane_xy = rng.uniform(-0.4, 0.4, (count, 2))
    pixels = camera().project(plane_xy @ exp_so3([0.5, 0.3, 0.1])[:, :2].T + shift())
    return {"plane_xy": plane_xy, "pixels": pixels + rng.normal(0, 0.1, (count, 2))}


def board_views(rng: Generator) -> list[np.ndarray]:
    xy = BOARD.corners()
    return [
        camera().project(xy @ exp_so3(vector)[:, :2].T + [-0.05, -0.03, 0.3]) + rng.normal(0, 0.05, (12, 2))
        for vector in TURNS
    ]


def starts(rng: Generator) -> dict[str, Any]:
    plane = flat(rng)
    return {"plane_xy": plane["plane_xy"], "normalized": camera().undistort(plane["pixels"])[0]}


def turned_pixels(rng: Generator) -> dict[str, Any]:
    src = rng.uniform(100, 400, (12, 2))
    rays = np.column_stack((camera().undistort(src)[0], np.ones(12)))
    return {"src": src, "dst": camera().project(rays @ turn(rng).T) + rng.normal(0, 0.1, (12, 2))}


def picture(_: Generator) -> np.ndarray:
    squares = np.kron((np.indices((4, 5)).sum(axis=0) % 2).astype(np.uint8) * 255, np.ones((20, 20), np.uint8))
    return np.asarray(cv2.copyMakeBorder(squares, 20, 20, 20, 20, cv2.BORDER_CONSTANT, value=255), np.uint8)


def best_of(plane_xy: np.ndarray, pixels: np.ndarray, noise_px: float, correlation: np.ndarray) -> PlanarPoses:
    return planar_poses(plane_xy, pixels, camera(), noise_px, correlation)


def dots(rng: np.random.Generator) -> np.ndarray:
    """A grid of 5 x 4 dots on noise."""
    row, column = np.indices((120, 150))
    away = np.hypot((column + 15) % 30 - 15, (row + 15) % 30 - 15)
    inside = (np.abs(column - 75) < 74) & (np.abs(row - 60) < 59) & (away < 8) & (column > 15) & (row > 15)
    return np.where(inside, 40, 220).astype(np.uint8) + rng.integers(0, 20, row.shape, np.uint8)


CALLS: dict[Callable[..., Any], Callable[[Generator], dict[str, Any]]] = {
    intrinsic_matrix: lambda rng: {"width": 640, "height": 480, "angle_of_view_rad": 1.2},
    intrinsic_matrix_of_lens: lambda rng: {"width": 640, "height": 480, "focal_length_m": 4e-3, "pixel_m": 5e-6},
    angle_of_view: lambda rng: {"K": K(), "width": 640, "height": 480},
    as_intrinsic_matrix: lambda rng: {"K": K()},
    projection_matrix: lambda rng: {"K": K(), "R": turn(rng), "t": shift()},
    project: lambda rng: {"P": matrix(rng), "world": box(rng)},
    camera_centre: lambda rng: {"P": matrix(rng)},
    depths: lambda rng: {"P": matrix(rng), "world": box(rng)},
    finite_camera: lambda rng: {"P": matrix(rng)},
    world_to_camera: lambda rng: {"R": turn(rng), "t": shift(), "world": box(rng)},
    camera_to_world: lambda rng: {"R": turn(rng), "t": shift(), "points": box(rng)},
    decompose_projection: lambda rng: {"P": matrix(rng)},
    rq: lambda rng: {"matrix": rng.normal(size=(3, 3)) + 3 * np.eye(3)},
    plane_homography: lambda rng: {"K": K(), "R": turn(rng), "t": shift()},
    pose_from_plane_homography: lambda rng: {"K": K(), "H": plane_homography(K(), turn(rng), shift())},
    rotation_homography: lambda rng: {"R": turn(rng), "K_src": K(), "K_dst": K()},
    rotation_from_homography: lambda rng: {"H": rotation_homography(turn(rng), K()), "K_src": K(), "K_dst": K()},
    exp_so3: lambda rng: {"vector": rng.normal(size=3)},
    log_so3: lambda rng: {"R": turn(rng)},
    quaternion: lambda rng: {"R": turn(rng)},
    from_quaternion: lambda rng: {"q": quaternion(turn(rng))},
    as_rotation: lambda rng: {"R": turn(rng)},
    nearest_rotation: lambda rng: {"matrix": turn(rng) + rng.normal(0, 0.01, (3, 3))},
    from_euler: lambda rng: {"angles": rng.uniform(-1, 1, 3), "order": "xyz"},
    euler_angles: lambda rng: {"R": turn(rng), "order": "zyx"},
    rigid_transform: lambda rng: {"numbers": np.r_[shift(), quaternion(turn(rng))]},
    rigid_transforms: lambda rng: {"numbers": np.r_[shift(), quaternion(turn(rng)), shift(), quaternion(turn(rng))]},
    as_distortion_model: lambda rng: {"model": "plumb_bob"},
    as_coefficients: lambda rng: {"coefficients": lens(), "model": MODEL},
    distort: lambda rng: {"model": MODEL, "coefficients": lens(), "xy": rng.uniform(-0.5, 0.5, (6, 2))},
    distort_with_derivatives: lambda rng: {
        "model": MODEL,
        "coefficients": lens(),
        "xy": rng.uniform(-0.5, 0.5, (6, 2)),
    },
    undistort: lambda rng: {"model": MODEL, "coefficients": lens(), "distorted": rng.uniform(-0.5, 0.5, (6, 2))},
    fold_radius: lambda rng: {"model": MODEL, "coefficients": np.array([-0.5, 0, 0, 0, 0.01])},
    tilt_matrix: lambda rng: {"tau_x": 0.1, "tau_y": -0.05},
    tilt_derivatives: lambda rng: {"tau_x": 0.1, "tau_y": -0.05},
    make_camera: lambda rng: {"K": K(), "distortion": lens(), "model": "plumb_bob", "width": 640, "height": 480},
    Camera.project: lambda rng: {"self": camera(), "points": box(rng) + (0, 0, 2)},
    Camera.project_with_jacobian: lambda rng: {"self": camera(), "points": box(rng) + (0, 0, 2)},
    Camera.distort: lambda rng: {"self": camera(), "normalized": rng.uniform(-0.5, 0.5, (6, 2))},
    Camera.undistort: lambda rng: {"self": camera(), "pixels": rng.uniform(0, 480, (6, 2))},
    Camera.ideal_pixels: lambda rng: {"self": camera(), "pixels": rng.uniform(0, 480, (6, 2))},
    Camera.raw_pixels: lambda rng: {"self": camera(), "ideal": rng.uniform(0, 480, (6, 2))},
    point_by_pose: lambda rng: {"points": box(rng), "t": shift()},
    planar_pose_starts: starts,
    PoseProblem: posed,
    PoseModel: posed,
    ProjectionModel: pictured,
    RotationModel: lambda rng: turned_pixels(rng) | {"camera_src": camera(), "camera_dst": camera()},
    BundleProblem: lambda rng: {"plane_xy": BOARD.corners(), "views": board_views(rng), "model": MODEL},
    planar_poses: lambda rng: flat(rng) | {"camera": camera()},
    best_of: lambda rng: flat(rng) | {"noise_px": 0.1, "correlation": np.eye(12)},
    fit_projection: lambda rng: pictured(rng) | {"noise_px": 0.1},
    as_correspondences: lambda rng: {"points": rng.normal(size=(6, 3)), "pixels": rng.normal(size=(6, 2)), "fewest": 6},
    projection_dlt: pictured,
    design_matrix: pictured,
    estimate_projection: lambda rng: pictured(rng) | {"rng": np.random.default_rng(1), "threshold_px": 3.0},
    fit_pose: lambda rng: posed(rng) | {"noise_px": 0.1},
    estimate_pose: lambda rng: posed(rng) | {"rng": np.random.default_rng(1), "threshold_px": 3.0},
    estimate_rotation: lambda rng: (
        turned_pixels(rng)
        | {"camera_src": camera(), "camera_dst": camera(), "rng": np.random.default_rng(1), "threshold_px": 3.0}
    ),
    choose_views: lambda rng: {"views": board_views(rng), "width": 640, "height": 480},
    without_copies: lambda rng: {"board_xy": BOARD.corners(), "views": board_views(rng), "width": 640, "height": 480},
    board_turns: lambda rng: {"board_xy": BOARD.corners()},
    calibrate: lambda rng: {"board_xy": BOARD.corners(), "views": board_views(rng), "width": 640, "height": 480},
    find_chessboard: lambda rng: {"grey": picture(rng), "board": BOARD},
    find_dots: lambda rng: {"grey": dots(rng), "columns": 5, "rows": 4, "is_shifted": False},
}

#: A lens model without a fold.
INFINITE = {fold_radius}
