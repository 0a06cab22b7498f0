# SPDX-License-Identifier: Apache-2.0
"""The pose of a calibrated camera before a plane, from the plane's homography (IU 8.1.5; Collins & Bartoli 2014).

A homography of a plane has eight degrees of freedom, a pose six: what a condensed homography knows of its points
decides which pose fits best, at a cost that does not depend on their number.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import require_type, shown_value
from imgu_ros.errors import DegenerateConfiguration, EstimationError, ShapeError
from imgu_ros.types import Floats, Matrix3, Points, as_matrix, as_points
from imgu_ros.vision.camera.calibration_test import LEAST_NOISE_PX, CalibrationTest
from imgu_ros.vision.camera.camera_covariance import covariance_factor
from imgu_ros.vision.camera.camera_derivatives import ideal_by_camera
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.ippe import poses_about_point
from imgu_ros.vision.camera.planar_pose import PlanarPoses, weighed_poses
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.camera.rotation import exp_so3
from imgu_ros.vision.estimation.nonlinear import Linearisation, minimise
from imgu_ros.vision.projective.homography import HomographyNormalEquations
from imgu_ros.vision.projective.transform import inverse3

#: Of a parameter's standard deviation at 1 px noise: a step this small is not taken.
_TOLERANCE = 5e-3


def _by_step() -> tuple[Floats, Floats]:
    """Return what makes the derivative of [r1 r2 t], row-major, by (x y z rx ry rz): (54, 12) of [R t], and (54,)."""
    of_pose, constant = np.zeros((3, 3, 6, 3, 4)), np.zeros((3, 3, 6))
    for axis in range(3):
        constant[axis, 2, axis] = 1
        # d (Exp(r) v) / dr = -[v]x
        after, before = (axis + 1) % 3, (axis + 2) % 3
        for column in (0, 1):
            of_pose[axis, column, 3 + after, before, column] = 1
            of_pose[axis, column, 3 + before, after, column] = -1
    return of_pose.reshape(54, 12), constant.ravel()


_BY_STEP, _BY_TRANSLATION = _by_step()
#: A grid of normalised points that covers the plane where the points themselves are not given: 1.7 standard deviations
#: is the half side of a uniform distribution.
_ALL_OVER = np.array([[x, y, 1.0] for y in np.linspace(-1.7, 1.7, 5) for x in np.linspace(-1.7, 1.7, 5)])
#: The derivatives of K by fx, fy, cx and cy.
_BY_K = np.zeros((4, 3, 3))
_BY_K[(0, 1, 2, 3), (0, 1, 0, 1), (0, 1, 2, 2)] = 1


def poses_of_homography(
    homography: HomographyNormalEquations,
    K: ArrayLike,
    plane_from_src: ArrayLike,
    camera: Camera | None = None,
    src_xy: ArrayLike | None = None,
) -> PlanarPoses:
    """Estimate camera_from_plane from a homography's condensed correspondences.

    The same as `planar_poses` of the correspondences, to second order in the residuals.

    Parameters
    ----------
    homography : of ideal pixels from the plane's picture
    K : (3, 3) intrinsics
    plane_from_src : (3, 3) affine: metres on the plane z = 0 from the picture's px
    camera : the camera with this K; when given, its covariance is in the poses', and `calibration` says what the
        homography tells of its numbers
    src_xy : (N, 2) px of the picture, the correspondences' points, which a lens that distorts sees each in its own way;
        None: all over

    Raises
    ------
    DegenerateConfiguration
        If no pose in front of the camera explains it, or a matrix is singular.
    ShapeError
        If K or plane_from_src is no (3, 3) of finite numbers.

    Examples
    --------
    Points of a picture printed at a centimetre a pixel, two metres ahead and tilted by half a radian:

    >>> from imgu_ros.vision.projective import homography_normal_equations
    >>> from imgu_ros.vision.projective import PlaneMotion
    >>> K, plane_from_px, R = np.diag([500.0, 500, 1]), np.diag([0.01, 0.01, 1]), exp_so3([0.5, 0, 0])
    >>> H = K @ np.column_stack((R[:, :2], [0, 0, 2])) @ plane_from_px
    >>> motions, still = PlaneMotion([[-30, -30], [30, -30], [30, 30], [-30, 30], [10, 2], [-3, 9]]), np.zeros((6, 2))
    >>> seen = homography_normal_equations(motions, still, motions.fit(still, np.ones(6, bool)), H, np.eye(3))
    >>> best = poses_of_homography(seen, K, plane_from_px).solutions[0]
    >>> (best.t.round(6) + 0.0).tolist(), bool(np.allclose(best.R, R))
    ([0.0, 0.0, 2.0], True)
    """
    if not isinstance(camera, Camera | None):
        raise ShapeError(f"camera: {shown_value(camera)}; need a Camera, or None")
    require_type(homography, HomographyNormalEquations, "homography")
    K = as_matrix(K, (3, 3), "K")
    src_from_plane = inverse3(as_matrix(plane_from_src, (3, 3), "plane_from_src"), "plane_from_src")
    problem = _PoseOfHomography(homography, K, src_from_plane)
    # In the middle of the points the two poses are nearest to the best ones.
    plane_from_points = inverse3(homography.T_src @ src_from_plane, "plane_from_src")
    normalised_from_plane = inverse3(homography.T_dst @ K, "K") @ homography.scaled @ homography.T_src @ src_from_plane
    starts = poses_about_point(normalised_from_plane, plane_from_points[:2, 2] / plane_from_points[2, 2])
    poses = weighed_poses(
        sorted(starts, key=problem.start_px), lambda start: problem.rms_px(start.matrix), problem.refined
    )
    if not poses.solutions:
        raise DegenerateConfiguration("H: no pose in front of the camera explains it; need a plane seen from its front")
    if camera is None:
        return poses
    xy = None if src_xy is None else as_points(src_xy, "src_xy")
    if camera.covariance is None:
        try:
            moved = problem.tangent_by_camera(camera, xy)
            return replace(poses, calibration=problem.calibration(poses.solutions[0], moved))
        except EstimationError:
            return poses  # a lens that folds at one of the points says nothing of itself there; the pose stands
    moved = problem.tangent_by_camera(camera, xy)
    tests, factor = [problem.calibration(pose, moved) for pose in poses.solutions], covariance_factor(camera)
    solutions = tuple(
        pose.with_shared_error(test.pose_by_camera @ factor) for pose, test in zip(poses.solutions, tests, strict=True)
    )
    return PlanarPoses(solutions, poses.ambiguity, tests[0])


class _PoseOfHomography:
    """Residuals (8, 1) of the homography that a pose, (4, 4) camera_from_plane, gives, weighed as its points would."""

    def __init__(self, homography: HomographyNormalEquations, K: Matrix3, src_from_plane: Matrix3) -> None:
        self._homography = homography
        # H = A [r1 r2 t] M^-1, so that vec H = (A x M^-T) vec [r1 r2 t], row-major.
        M_inverse = inverse3(homography.T_src @ src_from_plane, "plane_from_src")
        A = homography.T_dst @ K
        by_pose = (A[:, None, :, None] * M_inverse.T[None, :, None, :]).reshape(9, 9)
        try:
            self._whitening = np.linalg.cholesky(homography.normal).T
        except np.linalg.LinAlgError:
            raise DegenerateConfiguration(
                "H: its points do not determine it; need points that span the plane"
            ) from None
        # Eight whitened rows across the fitted homography, and one along it, which tells the scale.
        self._by_pose = np.empty((9, 9))
        self._by_pose[:8] = self._whitening @ (homography.basis.T @ by_pose)
        self._by_pose[8] = homography.scaled.ravel() @ by_pose
        # The same for [r1 r2 r3 t], of which r3 plays no part.
        by_rigid = np.zeros((9, 3, 4))
        by_rigid[:, :, [0, 1, 3]] = self._by_pose.reshape(9, 3, 3)
        self._by_rigid = by_rigid.reshape(9, 12)
        self._unit = float(homography.T_dst[0, 0])

    def linearise(self, estimate: Floats) -> Linearisation:
        """Return the whitened residuals and their derivative by (x y z rx ry rz): t + xyz, Exp(r) R."""
        residuals, scale = self._residuals(estimate)
        by_step = self._by_pose @ (_BY_STEP @ estimate[:3].ravel() + _BY_TRANSLATION).reshape(9, 6)
        jacobian = (by_step[:8] - residuals[:, None] * by_step[8]) / scale
        return Linearisation(residuals[:, None], jacobian[:, None, :])

    def step(self, estimate: Floats, delta: Floats) -> Floats:
        """Return the transform moved by (x y z rx ry rz)."""
        moved = estimate.copy()
        turn = delta[3:] / max(1.0, float(np.abs(delta[3:]).max()) / 1e3)
        moved[:3, :3] = exp_so3(turn) @ estimate[:3, :3]
        moved[:3, 3] += delta[:3]
        return moved

    def start_px(self, start: RigidTransform) -> float:
        """Return the points' root mean square residual under a pose; infinite where it is none."""
        try:
            return self.rms_px(start.matrix)
        except EstimationError:
            return math.inf

    def rms_px(self, estimate: Floats) -> float:
        """Return the points' root mean square residual under a pose, per coordinate."""
        residuals = self._residuals(estimate)[0]
        return self._rms_px(float(residuals @ residuals))

    def refined(self, start: RigidTransform) -> Pose:
        """Return the pose of least error near a start, with its covariance."""
        homography = self._homography
        minimum = minimise(self, start.matrix, max_iterations=30, tolerance=_TOLERANCE * self._unit)
        R, t = minimum.estimate[:3, :3], minimum.estimate[:3, 3]
        by_step = minimum.linearisation.jacobian[:, 0]
        residuals = minimum.linearisation.residuals.ravel()
        # The whitened errors of the homography have the covariance W^-T middle W^-1.
        try:
            gain = np.linalg.solve(self._whitening, by_step)
            of_pose = np.linalg.solve(by_step.T @ by_step, gain.T)
        except np.linalg.LinAlgError:
            raise DegenerateConfiguration(
                "pose: nothing determines it; need a plane that is not seen edge-on"
            ) from None
        covariance = homography.noise**2 * of_pose @ homography.middle @ of_pose.T
        rms_px = self._rms_px(float(residuals @ residuals))
        return Pose(R, t, (covariance + covariance.T) / 2, rms_px)

    def calibration(self, pose: Pose, tangent_by_camera: Floats) -> CalibrationTest:
        """Return what the homography says of the camera's numbers, at a pose that fits best."""
        homography = self._homography
        linear = self.linearise(pose.transform.matrix)
        by_step = linear.jacobian[:, 0]
        # The last two columns are orthogonal to those of the derivative.
        across = np.linalg.qr(by_step, mode="complete")[0][:, 6:]
        of_noise = np.linalg.solve(self._whitening, across)
        return CalibrationTest.of_residuals(
            linear.residuals.ravel(),
            by_step,
            across,
            self._whitening @ tangent_by_camera,
            max(homography.noise, LEAST_NOISE_PX * self._unit) ** 2 * of_noise.T @ homography.middle @ of_noise,
            max(2.0 * np.count_nonzero(homography.estimate.inliers) - 8, 1.0),
        )

    def tangent_by_camera(self, camera: Camera, src_xy: Points | None) -> Floats:
        """Return how the fitted homography moves with the camera's numbers, (8, P), in coordinates of its basis."""
        h = self._homography
        if not camera.is_distorted and camera.covariance is None:
            return self._tangent_by_pinhole(camera)
        if src_xy is None:
            points = _ALL_OVER
        else:
            # All of them: a lens moves points as no homography does, and which one is nearest depends on the points.
            points = np.column_stack((src_xy, np.ones(len(src_xy)))) @ h.T_src.T
        x, y, w = h.scaled @ points.T
        seen = np.column_stack((x / w, y / w))
        by_H = np.zeros((len(points), 2, 9))
        by_H[:, 0, :3] = by_H[:, 1, 3:6] = points / w[:, None]
        by_H[:, :, 6:] = -seen[:, :, None] * by_H[:, :1, :3]
        rows = by_H.reshape(-1, 9) @ h.basis
        try:
            moved = self._unit * ideal_by_camera(camera, (seen - h.T_dst[:2, 2]) / self._unit)
            return np.asarray(np.linalg.solve(rows.T @ rows, rows.T @ moved.reshape(len(rows), -1)), np.float64)
        except ShapeError as error:
            raise DegenerateConfiguration(f"pose: {error}") from None
        except np.linalg.LinAlgError:
            raise DegenerateConfiguration(
                "src_xy: the points do not determine a homography; need points that span the plane"
            ) from None

    def _tangent_by_pinhole(self, camera: Camera) -> Floats:
        """Return the same where no lens distorts: with K, all points move as a homography moves them."""
        h = self._homography
        moved = _BY_K @ (inverse3(h.T_dst @ camera.K, "K") @ h.scaled)
        tangent = np.zeros((8, 4 + len(camera.distortion)))
        tangent[:, :4] = -h.basis.T @ (h.T_dst @ moved).reshape(4, 9).T
        return tangent

    def _rms_px(self, more_squares: float) -> float:
        count = 2 * np.count_nonzero(self._homography.estimate.inliers)
        return math.sqrt((self._homography.squares + more_squares) / count) / self._unit

    def _residuals(self, estimate: Floats) -> tuple[Floats, float]:
        """Return the whitened residuals, and by how much the pose's homography is longer than the fitted one."""
        along = self._by_rigid @ estimate[:3].ravel()
        scale = float(along[8])
        if not scale > 0:
            raise DegenerateConfiguration("pose: the plane is behind the camera; need it in front")
        return along[:8] / scale, scale
