# SPDX-License-Identifier: Apache-2.0
"""The pose of a camera before a plane, from points of the plane (IU 8.1.5; Collins & Bartoli 2014, IPPE).

A plane seen from afar fits two poses. Both are refined by reprojection error, and the quotient of the two errors
says how sure the choice is.
"""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_number, require_type
from imgu_ros.errors import DegenerateConfiguration, EstimationError, ShapeError
from imgu_ros.types import Floats, Points, as_matrix, as_plane_points, as_points
from imgu_ros.vision.camera.calibration_test import FREEDOM, LEAST_NOISE_PX, CalibrationTest
from imgu_ros.vision.camera.camera_covariance import covariance_factor
from imgu_ros.vision.camera.camera_derivatives import raw_by_camera
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.pose import PlanarPoses, Pose, ranked_poses_unchecked
from imgu_ros.vision.camera.pose_problem import PoseProblem, point_by_pose
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.camera.rotation import exp_so3
from imgu_ros.vision.estimation.covariance import propagated_covariance
from imgu_ros.vision.estimation.nonlinear import minimise
from imgu_ros.vision.projective.fit import require_spread

#: A second solution is dropped when its initial error is this many times that of the first. Measured:
#: Degrees of freedom of a noise that is known.
_KNOWN = 1e9
#: Of so few points, the homography leaves no residuals that would tell their noise.
_HOMOGRAPHY_POINTS = 4
#: Of a parameter's standard deviation at 1 px noise: a step this small is not taken.
_TOLERANCE = 1e-3


def planar_poses(
    plane_xy: ArrayLike,
    pixels: ArrayLike,
    camera: Camera,
    noise_px: float | None = None,
    correlation: Floats | None = None,
) -> PlanarPoses:
    """Estimate camera_from_plane from correspondences without outliers.

    Parameters
    ----------
    plane_xy : (N, 2) m, on the plane z = 0, N >= 4
    pixels : (N, 2) raw px, distortion and all
    camera : intrinsics; their covariance, when they have one, is in the poses'
    noise_px : standard deviation of a pixel coordinate; None: from the residuals
    correlation : (N, N) correlation of the errors of different points; None: independent

    Returns
    -------
    Poses with their covariance by `propagated_covariance`.

    Raises
    ------
    TooFewPoints, DegenerateConfiguration
        If the points do not determine a pose in front of the camera.
    """
    require_type(camera, Camera, "camera")
    noise_px = None if noise_px is None else as_number(noise_px, "noise_px")
    plane_xy, pixels = as_plane_points(plane_xy, "plane_xy"), as_points(pixels, "pixels")
    if len(plane_xy) != len(pixels):
        raise ShapeError(f"pixels: {len(pixels)} points; need {len(plane_xy)}, one for each of plane_xy")
    require_spread(plane_xy, "plane_xy")
    if correlation is not None:
        correlation = as_matrix(correlation, (len(pixels), len(pixels)), "correlation")
    if noise_px is not None and not 0 < noise_px < math.inf:
        raise ShapeError(f"noise_px: {noise_px}; need a positive number, or None")
    normalized, valid = camera.undistort(pixels)
    require_spread(normalized[valid], "pixels")
    among_valid = None if correlation is None else correlation[np.ix_(valid, valid)]
    problem = PoseProblem(plane_xy[valid], pixels[valid], camera)
    # OpenCV gives the better start first.
    poses = ranked_poses_unchecked(
        planar_pose_starts(plane_xy[valid], normalized[valid]),
        lambda start: _rms(problem.residuals(start.matrix)),
        lambda start: _refined(problem, start, noise_px, among_valid),
    )
    if not poses.solutions:
        raise DegenerateConfiguration(
            "pixels: no pose in front of the camera explains them; need a plane seen from its front"
        )
    enough = noise_px is not None or np.count_nonzero(valid) > _HOMOGRAPHY_POINTS

    def tested(pose: Pose) -> CalibrationTest:
        return _calibration_test(plane_xy[valid], pixels[valid], camera, pose.transform, noise_px, among_valid)

    if camera.covariance is None:
        try:
            return replace(poses, calibration=tested(poses.solutions[0]) if enough else None)
        except EstimationError:
            return poses  # as in `poses_of_homography`
    tests, factor = [tested(pose) for pose in poses.solutions], covariance_factor(camera)
    solutions = tuple(
        pose.with_shared_error(test.pose_by_camera @ factor) for pose, test in zip(poses.solutions, tests, strict=True)
    )
    return PlanarPoses(solutions, poses.ambiguity, tests[0] if enough else None)


def planar_pose_starts(plane_xy: ArrayLike, normalized: ArrayLike) -> list[RigidTransform]:
    """Return up to two poses camera_from_plane by infinitesimal plane-based pose estimation (OpenCV), not refined.

    Parameters
    ----------
    plane_xy : (N, 2) m, on the plane z = 0, N >= 4
    normalized : (N, 2) ideal coordinates x / z, y / z

    Raises
    ------
    DegenerateConfiguration
        If the points do not determine a pose.
    """
    plane_xy, normalized = as_points(plane_xy, "plane_xy", 4), as_points(normalized, "normalized", 4)
    if len(plane_xy) != len(normalized):
        raise ShapeError(f"normalized: {len(normalized)} points; need {len(plane_xy)}, one for each of plane_xy")
    plane = np.column_stack((plane_xy, np.zeros(len(plane_xy))))
    try:
        count, rotations, translations, _ = cv2.solvePnPGeneric(
            plane, np.ascontiguousarray(normalized), np.eye(3), np.zeros(4), flags=cv2.SOLVEPNP_IPPE
        )
    except cv2.error as error:
        raise DegenerateConfiguration(
            f"pixels: no planar pose ({' '.join(str(error.err).split())}); need a plane seen from its front"
        ) from None
    starts = []
    for rvec, tvec in zip(rotations[:count], translations[:count], strict=True):
        if np.isfinite(rvec).all() and np.isfinite(tvec).all():
            t = np.asarray(tvec, np.float64).ravel()
            starts.append(RigidTransform(exp_so3(np.asarray(rvec, np.float64).ravel()), t))
    return starts


def _refined(problem: PoseProblem, start: RigidTransform, noise_px: float | None, correlation: Floats | None) -> Pose:
    minimum = minimise(problem, start.matrix, max_iterations=30, tolerance=_TOLERANCE)
    R, t = minimum.estimate[:3, :3], minimum.estimate[:3, 3]
    return Pose(R, t, propagated_covariance(minimum, noise_px, correlation), _rms(minimum.linearisation.residuals))


def _calibration_test(
    plane_xy: Points,
    pixels: Points,
    camera: Camera,
    camera_from_plane: RigidTransform,
    noise_px: float | None = None,
    correlation: Floats | None = None,
) -> CalibrationTest:
    """Return what points say of the camera's numbers, at the pose that fits them best.

    Parameters
    ----------
    plane_xy : (N, 2) m, on the plane z = 0, N >= 4, not on a line
    pixels : (N, 2) raw px, distortion and all
    camera, camera_from_plane : with which they were fitted
    noise_px : standard deviation of a pixel coordinate; None: from the residuals of the best homography, N > 4
    correlation : (N, N) correlation of the errors of different points; None: independent

    Raises
    ------
    DegenerateConfiguration
        If a point is so far off the axis that the lens model overflows, or the points determine no pose.
    """
    t = camera_from_plane.t
    points = plane_xy @ camera_from_plane.R[:, :2].T + t
    try:
        projected, by_point = camera.project_with_jacobian(points)
        by_camera = raw_by_camera(camera, points)
    except ShapeError as error:
        raise DegenerateConfiguration(f"pose: {error}") from None
    by_pose = (by_point @ point_by_pose(points, t)).reshape(-1, 6)
    # A homography moves the points of the plane by a (3, 3) matrix; a pose by some of these motions.
    centred = plane_xy - plane_xy.mean(axis=0)
    homogeneous = np.column_stack((centred / np.sqrt((centred**2).mean()), np.ones(len(points))))
    by_homography = (by_point[:, :, :, None] * homogeneous[:, None, None, :]).reshape(-1, 9)
    explained, _ = np.linalg.qr(by_pose)
    beyond = by_homography - explained @ (explained.T @ by_homography)
    across = np.linalg.svd(beyond, full_matrices=False)[0][:, :FREEDOM]
    residuals = (projected - pixels).ravel()
    variance, freedom = (0.0, _KNOWN) if noise_px is None else (noise_px**2, _KNOWN)
    if noise_px is None:
        along = across.T @ residuals
        freedom = max(len(residuals) - 8.0, 1.0)
        variance = max(float(residuals @ residuals - along @ along), 0.0) / freedom
    noise = np.eye(FREEDOM)
    if correlation is not None:
        by_axis = across.reshape(len(points), 2, FREEDOM)
        noise = np.einsum("nda,ndb->ab", by_axis, np.tensordot(correlation, by_axis, 1))
    return CalibrationTest.of_residuals(
        residuals,
        by_pose,
        across,
        -by_camera.reshape(len(residuals), -1),
        max(variance, LEAST_NOISE_PX**2) * noise,
        freedom,
    )


def _rms(residuals: Floats) -> float:
    return math.sqrt(float((residuals**2).mean()))
