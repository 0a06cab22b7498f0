# SPDX-License-Identifier: Apache-2.0
"""The pose of a calibrated camera before a plane, from the plane's homography (IU 8.1.5; Collins & Bartoli 2014).

A homography of a plane has eight degrees of freedom, a pose six. The homography's normal equations give the error of
each pose at a cost that does not depend on the number of points.
"""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import require_type, shown_value
from imgu_ros.errors import DegenerateConfiguration, EstimationError, ShapeError
from imgu_ros.types import Floats, Matrix3, Points, as_matrix, as_points
from imgu_ros.vision.camera.calibration_test import LEAST_NOISE_PX, CalibrationTest
from imgu_ros.vision.camera.camera_covariance import covariance_factor
from imgu_ros.vision.camera.camera_derivatives import ideal_by_camera
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.pose import PlanarPoses, Pose, ranked_poses_unchecked
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.projective.homography import HomographyNormalEquations

#: Smallest step, as a share of the parameters' standard deviations at 1 px noise.
_TOLERANCE = 5e-3
#: Bounds the time of a problem that does not converge; three to six steps are usual.
_MOST_STEPS = 30
#: Marquardt's damping at the start, and its limits.
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-4, 1e-12, 1e12
#: A nearly undamped step that promises to lower the cost by less than this share, and fails, is rounding.
_ROUNDING = 1e-12


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


#: Rounding may make a square a little negative.
_ROUNDED = 1e-9
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
    """Estimate camera_from_plane from the normal equations of a homography.

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

    >>> from imgu_ros.vision.camera.rotation import exp_so3
    >>> from imgu_ros.vision.projective import PlaneMotion, homography_normal_equations
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
    K, plane_from_src = as_matrix(K, (3, 3), "K"), as_matrix(plane_from_src, (3, 3), "plane_from_src")
    src_xy = None if src_xy is None else as_points(src_xy, "src_xy")
    return poses_of_homography_unchecked(homography, K, plane_from_src, camera, src_xy)


def poses_of_homography_unchecked(
    homography: HomographyNormalEquations,
    K: Matrix3,
    plane_from_src: Matrix3,
    camera: Camera | None = None,
    src_xy: Points | None = None,
) -> PlanarPoses:
    """`poses_of_homography` without the checks of its arguments."""
    src_from_plane = _inverse(plane_from_src, "plane_from_src")
    problem = _PoseOfHomography(homography, K, src_from_plane)
    # In the middle of the points the two poses are nearest to the best ones.
    x, y, w = problem.plane_from_points[:, 2].tolist()
    normalised_from_plane = _inverse(homography.T_dst @ K, "K") @ homography.scaled @ homography.T_src @ src_from_plane
    starts = _poses_about_point(normalised_from_plane, x / w, y / w)
    poses = ranked_poses_unchecked(sorted(starts, key=problem.start_px), problem.rms_px, problem.refined)
    if not poses.solutions:
        raise DegenerateConfiguration("H: no pose in front of the camera explains it; need a plane seen from its front")
    if camera is None:
        return poses
    if camera.covariance is None:
        try:
            moved = problem.tangent_by_camera(camera, src_xy)
            return replace(poses, calibration=problem.calibration(poses.solutions[0], moved))
        except EstimationError:
            return poses  # a lens that folds at one of the points says nothing of itself there; the pose stands
    moved = problem.tangent_by_camera(camera, src_xy)
    tests, factor = [problem.calibration(pose, moved) for pose in poses.solutions], covariance_factor(camera)
    solutions = tuple(
        pose.with_shared_error(test.pose_by_camera @ factor) for pose, test in zip(poses.solutions, tests, strict=True)
    )
    return PlanarPoses(solutions, poses.ambiguity, tests[0])


class _PoseOfHomography:
    """Whitened residuals (8,) of the homography that a pose, (4, 4) camera_from_plane, gives."""

    def __init__(self, homography: HomographyNormalEquations, K: Matrix3, src_from_plane: Matrix3) -> None:
        self._homography = homography
        # H = A [r1 r2 t] M^-1, so that vec H = (A x M^-T) vec [r1 r2 t], row-major.
        self.plane_from_points = M_inverse = _inverse(homography.T_src @ src_from_plane, "plane_from_src")
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

    def linearised(self, estimate: Floats) -> tuple[Floats, Floats]:
        """Return the residuals (8,) and their derivative (8, 6) by (x y z rx ry rz): t + xyz, Exp(r) R."""
        residuals, scale = self._residuals(estimate)
        by_step = self._by_pose @ (_BY_STEP @ estimate[:3].ravel() + _BY_TRANSLATION).reshape(9, 6)
        return residuals, (by_step[:8] - residuals[:, None] * by_step[8]) / scale

    def start_px(self, start: Floats) -> float:
        """Return the points' root mean square residual under a pose; infinite where it is none."""
        try:
            return self.rms_px(start)
        except EstimationError:
            return math.inf

    def rms_px(self, estimate: Floats) -> float:
        """Return the points' root mean square residual under a pose, per coordinate."""
        residuals = self._residuals(estimate)[0]
        return self._rms_px(float(residuals @ residuals))

    def refined(self, start: Floats) -> Pose:
        """Return the pose of least error near a start, with its covariance."""
        homography = self._homography
        estimate, residuals, by_step = self._minimised(start)
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
        return Pose(estimate[:3, :3], estimate[:3, 3], (covariance + covariance.T) / 2, rms_px)

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def _minimised(self, start: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the pose (4, 4) of least error, its residuals and their derivative, by Levenberg-Marquardt.

        As `minimise` does it, of which six parameters and eight residuals would be a small part of its time.
        """
        estimate, damping, tolerance = start, _FIRST_DAMPING, _TOLERANCE * self._unit
        residuals, by_step = self.linearised(estimate)
        cost = float(residuals @ residuals)
        if not math.isfinite(cost):
            raise DegenerateConfiguration("pose: residuals that are not finite; need another start")
        for _ in range(_MOST_STEPS):
            normal, gradient = by_step.T @ by_step, by_step.T @ residuals
            scale = np.sqrt(normal.diagonal())
            if not (math.isfinite(float(normal.sum())) and scale.min() > 0):
                raise DegenerateConfiguration("pose: nothing determines it; need a plane that is not seen edge-on")
            damped = normal / (scale[:, None] * scale)
            damped.ravel()[::7] += damping
            # For a few rows, OpenCV is three times as fast as NumPy.
            regular, step = cv2.solve(damped, (gradient / scale)[:, None], flags=cv2.DECOMP_CHOLESKY)
            if not regular:
                raise DegenerateConfiguration("pose: nothing determines it; need a plane that is not seen edge-on")
            delta = -step[:, 0] / scale
            length = float(delta @ normal @ delta)
            if length <= tolerance**2:
                break
            try:
                moved = _moved(estimate, delta)
                new_residuals, new_by_step = self.linearised(moved)
                new_cost = float(new_residuals @ new_residuals)
            except EstimationError:
                new_cost = math.inf  # a step too long
            if new_cost <= cost:
                is_small = cost - new_cost <= tolerance * cost
                estimate, residuals, by_step, cost = moved, new_residuals, new_by_step, new_cost
                damping = max(damping / 10, _LEAST_DAMPING)
                if is_small:
                    break
            elif damping > _MOST_DAMPING or (damping <= 1 and length <= _ROUNDING * cost):
                break
            else:
                damping *= 10
        return estimate, residuals, by_step

    def calibration(self, pose: Pose, tangent_by_camera: Floats) -> CalibrationTest:
        """Return what the homography says of the camera's numbers, at a pose that fits best."""
        homography = self._homography
        residuals, by_step = self.linearised(pose.transform.matrix)
        # The last two columns are orthogonal to those of the derivative.
        across = np.linalg.qr(by_step, mode="complete")[0][:, 6:]
        of_noise = np.linalg.solve(self._whitening, across)
        return CalibrationTest.of_residuals(
            residuals,
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
        moved = _BY_K @ (_inverse(h.T_dst @ camera.K, "K") @ h.scaled)
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


def poses_about_point(H: ArrayLike, point: ArrayLike) -> tuple[RigidTransform, RigidTransform]:
    """Return the two poses camera_from_plane that have a homography's value and derivative at a point.

    Of an exact homography one of them is its pose; how unlike they are says how much perspective there is.

    Parameters
    ----------
    H : (3, 3) ideal normalised coordinates x / z, y / z from metres on the plane z = 0
    point : (2,) metres on the plane

    Raises
    ------
    DegenerateConfiguration
        If H is singular at the point, or maps it to infinity.

    Examples
    --------
    A plane one metre ahead, seen straight on; about a point off the axis it could also be tilted the other way:

    >>> first, second = poses_about_point(np.eye(3), [0.0, 0.0])
    >>> (first.t.round(9) + 0.0).tolist(), bool(np.allclose(first.R, np.eye(3)) and np.allclose(second.R, np.eye(3)))
    ([0.0, 0.0, 1.0], True)
    """
    x, y = as_matrix(point, (2,), "point").tolist()
    first, second = _poses_about_point(as_matrix(H, (3, 3), "H"), x, y)
    return RigidTransform(first[:3, :3], first[:3, 3]), RigidTransform(second[:3, :3], second[:3, 3])


def _poses_about_point(H: Matrix3, x0: float, y0: float) -> list[Floats]:
    """Return the same as two matrices (4, 4)."""
    scale = float(np.abs(H).max())
    (h00, h01, h02), (h10, h11, h12), (h20, h21, h22) = (H / scale if scale > 0 else H).tolist()
    w = h20 * x0 + h21 * y0 + h22
    if not abs(w) > _ROUNDED * (abs(h20 * x0) + abs(h21 * y0) + abs(h22)):
        raise DegenerateConfiguration("H: it maps the point to infinity; need a point off the vanishing line")
    p, q = (h00 * x0 + h01 * y0 + h02) / w, (h10 * x0 + h11 * y0 + h12) / w
    # The derivative of the homography at the point.
    j00, j01 = (h00 - p * h20) / w, (h01 - p * h21) / w
    j10, j11 = (h10 - q * h20) / w, (h11 - q * h21) / w
    # The rotation that turns the optical axis to the direction (p, q, 1) by the shortest way.
    length = math.sqrt(p * p + q * q + 1)
    u, v, z = p / length, q / length, 1 / length
    k = 1 / (1 + z)
    to_view = [[1 - k * u * u, -k * u * v, u], [-k * u * v, 1 - k * v * v, v], [-u, -v, z]]
    # B = [I | -v] R_v restricted to the first two columns; A = B^-1 J is the upper left of R, over the depth.
    b00, b01 = to_view[0][0] - p * to_view[2][0], to_view[0][1] - p * to_view[2][1]
    b10, b11 = to_view[1][0] - q * to_view[2][0], to_view[1][1] - q * to_view[2][1]
    det = b00 * b11 - b01 * b10
    a00, a01 = (b11 * j00 - b01 * j10) / det, (b11 * j01 - b01 * j11) / det
    a10, a11 = (b00 * j10 - b10 * j00) / det, (b00 * j11 - b10 * j01) / det
    # Its larger singular value is that of a rotation's part with one column of length 1: the inverse depth.
    s00, s01, s11 = a00 * a00 + a01 * a01, a00 * a10 + a01 * a11, a10 * a10 + a11 * a11
    inverse_depth = math.sqrt(0.5 * (s00 + s11 + math.hypot(s00 - s11, 2 * s01)))
    if not (inverse_depth > 0 and math.isfinite(inverse_depth) and abs(a00 * a11 - a01 * a10) > 0):
        raise DegenerateConfiguration("H: singular at the point; need a plane that is not seen edge-on")
    r00, r01, r10, r11 = a00 / inverse_depth, a01 / inverse_depth, a10 / inverse_depth, a11 / inverse_depth
    # Columns of length 1 and at right angles: the third row up to its sign.
    r20 = math.sqrt(max(0.0, 1 - r00 * r00 - r10 * r10))
    r21 = math.copysign(math.sqrt(max(0.0, 1 - r01 * r01 - r11 * r11)), -(r00 * r01 + r10 * r11))
    depth = 1 / inverse_depth
    at_point = np.array([p * depth, q * depth, depth])
    view = np.array(to_view)
    poses = []
    for c, f in ((r20, r21), (-r20, -r21)):
        a, b, d, e = r00, r10, r01, r11
        R = view @ np.array([[a, d, b * f - c * e], [b, e, c * d - a * f], [c, f, a * e - b * d]])
        # Where the third row is nearly 0, its root has half the digits: a Newton step to the nearest rotation.
        R = R @ (1.5 * np.eye(3) - 0.5 * (R.T @ R))
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = R, at_point - x0 * R[:, 0] - y0 * R[:, 1]
        poses.append(pose)
    return poses


def _moved(pose: Floats, delta: Floats) -> Floats:
    """Return a pose (4, 4) moved by (x y z rx ry rz): t + xyz, Exp(r) R."""
    vector = delta[3:] / max(1.0, float(np.abs(delta[3:]).max()) / 1e3)
    angle = math.sqrt(float(vector @ vector))
    # Exp(r) as `exp_so3` computes it: Rodrigues, both quotients without cancellation.
    sine, versine = (math.sin(angle) / angle, 2 * (math.sin(angle / 2) / angle) ** 2) if angle > 1e-150 else (1.0, 0.5)
    x, y, z = vector.tolist()
    turn = sine * np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    square = np.array(
        [[-(y * y) - z * z, x * y, x * z], [x * y, -(x * x) - z * z, y * z], [x * z, y * z, -(x * x) - y * y]]
    )
    moved = pose.copy()
    moved[:3, :3] = (np.eye(3) + turn + versine * square) @ pose[:3, :3]
    moved[:3, 3] += delta[:3]
    return moved


def _inverse(matrix: Matrix3, name: str) -> Matrix3:
    """Return the inverse of a (3, 3) matrix, several times as fast as NumPy; `name` is what errors call it."""
    regular, inverse = cv2.invert(matrix)
    if not regular or not math.isfinite(np.vdot(inverse, inverse)):
        raise DegenerateConfiguration(f"{name}: singular or nearly so; need a regular matrix")
    return np.asarray(inverse, np.float64)
