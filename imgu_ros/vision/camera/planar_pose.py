"""The pose of a camera before a plane, from points of the plane (notes 8.1.5; Collins & Bartoli 2014, IPPE).

A plane seen from afar fits two poses. Both are refined by reprojection error, and the quotient of the two errors
says how sure the choice is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import DegenerateConfiguration, EstimationError, ShapeError
from imgu_ros.types import Floats, Points, as_matrix, as_points
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.camera.pose_problem import PoseProblem
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.camera.rotation import exp_so3
from imgu_ros.vision.estimation.covariance import propagated_covariance
from imgu_ros.vision.estimation.nonlinear import minimise
from imgu_ros.vision.projective.estimate import require_spread


@dataclass(frozen=True, slots=True, eq=False)
class PlanarPoses:
    """The poses that a plane's picture allows.

    Attributes
    ----------
    solutions : one or two refined poses camera_from_plane, best first
    ambiguity : best / second-best RMS reprojection error, 0 (clear) to 1; 0 when there is one solution
    """

    solutions: tuple[Pose, ...]
    ambiguity: float


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
    camera : intrinsics
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
    plane_xy, pixels = as_points(plane_xy, "plane_xy"), as_points(pixels, "pixels")
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
    refined = []
    for start in planar_pose_starts(plane_xy[valid], normalized[valid]):
        try:
            refined.append(_refined(plane_xy[valid], pixels[valid], camera, start, noise_px, among_valid))
        except EstimationError:
            continue  # a start behind the camera or at a grazing angle is no solution
    if not refined:
        raise DegenerateConfiguration(
            "pixels: no pose in front of the camera explains them; need a plane seen from its front"
        )
    refined.sort(key=lambda pose: pose.rms_px)
    if len(refined) > 1 and _same(refined[0], refined[1]):
        refined = refined[:1]
    ambiguity = refined[0].rms_px / refined[1].rms_px if len(refined) > 1 and refined[1].rms_px > 0 else 0.0
    return PlanarPoses(tuple(refined), ambiguity)


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


def _refined(
    plane_xy: Points,
    pixels: Points,
    camera: Camera,
    start: RigidTransform,
    noise_px: float | None,
    correlation: Floats | None,
) -> Pose:
    estimate = np.eye(4)
    estimate[:3, :3], estimate[:3, 3] = start.R, start.t
    minimum = minimise(PoseProblem(plane_xy, pixels, camera), estimate, max_iterations=30)
    R, t = minimum.estimate[:3, :3], minimum.estimate[:3, 3]
    rms = math.sqrt(float((minimum.linearisation.residuals**2).mean()))
    return Pose(R, t, propagated_covariance(minimum, noise_px, correlation), rms)


def _same(a: Pose, b: Pose) -> bool:
    """Whether two refinements ended in the same minimum."""
    angle = math.acos(min(1.0, max(-1.0, (float(np.trace(a.R.T @ b.R)) - 1) / 2)))
    return angle < 1e-4 and float(np.linalg.norm(a.t - b.t)) < 1e-4 * float(np.linalg.norm(a.t))
