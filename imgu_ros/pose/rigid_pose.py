# SPDX-License-Identifier: Apache-2.0
"""The pose of a rigid thing with several planes, from the homographies of those that are seen.

Each homography has eight degrees of freedom and a covariance; the pose has six. What is minimised is the sum of the
squared residuals of all homographies in units of their covariances, from every pose that one of the planes allows: of
one plane two poses often fit alike, and a second one at another angle tells which.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imgu_ros.errors import DegenerateConfiguration, EstimationError, ImguError
from imgu_ros.pose.plane import Plane
from imgu_ros.reasons import no_pose, why_ambiguous
from imgu_ros.result import PoseStatus, ReferenceResult
from imgu_ros.types import Floats
from imgu_ros.vision.camera.camera_covariance import covariance_factor
from imgu_ros.vision.camera.camera_derivatives import ideal_by_camera
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.camera.rotation import exp_so3, log_so3
from imgu_ros.vision.projective.homography import normalised_unchecked, tangent_basis_unchecked

#: Bounds the time of a start that leads nowhere; three to six steps are usual.
_MOST_STEPS = 30
#: A step that is a smaller share of the standard deviations, or lowers the squares by a smaller share, is the last.
_TOLERANCE, _NO_BETTER = 1e-3, 1e-9
#: Marquardt's damping at the start, its factor, and the most of it.
_FIRST_DAMPING, _FACTOR, _MOST_DAMPING = 1e-4, 10.0, 1e8
#: Two starts ended in the same minimum when their rotations differ by less, rad.
_SAME = 0.01
#: Squares that one in a hundred correct poses exceeds: the normal distribution's quantile, see Wilson and Hilferty.
_QUANTILE_99 = 2.3263


@dataclass(frozen=True, slots=True, eq=False)
class SeenPlane:
    """A plane of a rigid thing that was found.

    Attributes
    ----------
    found : with a homography
    plane : its metric frame
    place : `thing_from_plane`; its covariance is that of the place
    """

    found: ReferenceResult
    plane: Plane
    place: Pose


def rigid_pose(result: ReferenceResult, seen: Sequence[SeenPlane], camera: Camera, limit: float) -> ReferenceResult:
    """Return a result with the pose of a rigid thing.

    Parameters
    ----------
    result : of the thing, with what is known so far
    seen : at least one plane
    camera : that took the frame
    limit : the pose is ambiguous when the ratio of the errors of two poses exceeds this
    """
    if len(seen) == 1:
        return _of_one(result, seen[0])
    starts = [
        solution.transform.after(each.place.transform.inverse()) for each in seen for solution in each.found.solutions
    ]
    try:
        if not starts:
            raise DegenerateConfiguration("planes: none has a pose")
        fits = _distinct(starts, [_PlaneResiduals(each, camera.K, starts[0]) for each in seen])
    except EstimationError as error:
        return replace(result, pose=None, solutions=(), pose_status=PoseStatus.NONE, reason=no_pose(error))
    freedom = sum(each.freedom for each in fits[0].planes)
    ambiguity = 0.0
    if len(fits) > 1:
        ambiguity = math.sqrt((freedom + fits[0].squared) / (freedom + fits[1].squared))
    is_ambiguous = ambiguity > limit
    rms_px = max(solution.rms_px for each in seen for solution in each.found.solutions)
    solutions = tuple(fit.pose(rms_px) for fit in fits[:2])
    calibration = None
    tests = [each.found.calibration for each in seen if each.found.calibration is not None]
    if tests or camera.covariance is not None:
        try:
            by_camera = [fit.by_camera(camera) for fit in fits[:2]]
        except ImguError:
            by_camera = []  # a lens that folds at one of the points
        if by_camera and camera.covariance is not None:
            factor = covariance_factor(camera)
            solutions = tuple(
                pose.with_shared_error(by @ factor) for pose, by in zip(solutions, by_camera, strict=True)
            )
        if by_camera and tests and not is_ambiguous:
            calibration = replace(tests[0], pose_by_camera=by_camera[0])
    return replace(
        result,
        pose_status=PoseStatus.AMBIGUOUS if is_ambiguous else PoseStatus.METRIC,
        reason=why_ambiguous(ambiguity, limit) if is_ambiguous else "",
        pose=None if is_ambiguous else solutions[0],
        solutions=solutions,
        ambiguity=ambiguity,
        calibration=calibration,
    )


def _of_one(result: ReferenceResult, seen: SeenPlane) -> ReferenceResult:
    """Return the pose of a thing by one plane: ambiguous where that of the plane is."""
    back = seen.place.transform.inverse()

    def moved(pose: Pose) -> Pose:
        thing = pose.transform.after(back)
        J = np.eye(6)
        J[:3, 3:] = -_cross(pose.R @ back.t)
        turn = np.kron(np.eye(2), thing.R)
        covariance = J @ (pose.covariance + turn @ seen.place.covariance @ turn.T) @ J.T
        shared = None if pose.shared is None else J @ pose.shared
        return Pose(thing.R, thing.t, (covariance + covariance.T) / 2, pose.rms_px, shared)

    solutions = tuple(moved(pose) for pose in result.solutions)
    test = result.calibration
    if test is not None and result.solutions:
        J = np.eye(6)
        J[:3, 3:] = -_cross(result.solutions[0].R @ back.t)
        test = replace(test, pose_by_camera=J @ test.pose_by_camera)
    own = None if result.pose is None else moved(result.pose)
    return replace(result, pose=own, solutions=solutions, calibration=test)


class _PlaneResiduals:
    """The residuals of a plane's homography under a pose of the thing, in units of its covariance.

    Parameters
    ----------
    seen : the plane
    K : intrinsics
    near : a pose `camera_from_thing`, by which the uncertainty of the plane's place is seen
    """

    def __init__(self, seen: SeenPlane, K: Floats, near: RigidTransform) -> None:
        found, estimate = seen.found, seen.found.homography
        assert estimate is not None and found.matches is not None
        self.place, self.template_xy = seen.place.transform, found.matches.template_xy
        self.freedom = max(2.0 * np.count_nonzero(estimate.inliers) - 8, 1.0)
        src = _unit_similarity(self.template_xy)
        at = self.template_xy @ estimate.H[:, :2].T + estimate.H[:, 2]
        self._T = T = _unit_similarity(at[:, :2] / at[:, 2:])
        back = np.linalg.inv(src)
        raw = T @ estimate.H @ back
        self._scaled = normalised_unchecked(raw)
        self._basis = tangent_basis_unchecked(self._scaled)
        outer = (T[:, None, :, None] * back.T[None, :, None, :]).reshape(9, 9) / np.linalg.norm(raw)
        to_tangent = self._basis.T @ outer
        self._by_view = self._kron(T @ K, seen.plane.metres_from_template @ back)
        self._white: Floats = np.eye(8)
        covariance = to_tangent @ estimate.covariance @ to_tangent.T
        if seen.place.covariance.any():
            # An error of the place moves the plane, about its own origin.
            by_place = self.linearised(near, lever=False)[1] @ np.kron(np.eye(2), near.R)
            covariance = covariance + by_place @ seen.place.covariance @ by_place.T
        try:
            self._white = np.linalg.inv(np.linalg.cholesky((covariance + covariance.T) / 2))
        except np.linalg.LinAlgError:
            raise DegenerateConfiguration("H: its covariance has no inverse; need points that span the plane") from None

    @staticmethod
    def _kron(left: Floats, right: Floats) -> Floats:
        return np.asarray((left[:, None, :, None] * right.T[None, :, None, :]).reshape(9, 9), np.float64)

    def linearised(self, pose: RigidTransform, lever: bool = True) -> tuple[Floats, Floats]:
        """Return the residuals (8,) and their derivative (8, 6) by (x y z rx ry rz): t + xyz, Exp(r) R.

        Raises `DegenerateConfiguration` where the plane would lie behind the camera.
        """
        plane = pose.after(self.place)
        view = np.column_stack((plane.R[:, :2], plane.t))
        along = self._by_view @ view.ravel()
        scale = float(self._scaled.ravel() @ along)
        if not scale > 0:
            raise DegenerateConfiguration("pose: a plane is behind the camera; need it in front")
        by_step = np.zeros((3, 3, 6))
        by_step[:, 0, 3:], by_step[:, 1, 3:] = -_cross(plane.R[:, 0]), -_cross(plane.R[:, 1])
        by_step[:, 2, :3] = np.eye(3)
        if lever:
            by_step[:, 2, 3:] = -_cross(plane.t - pose.t)
        moved = self._by_view @ by_step.reshape(9, 6)
        residuals = self._basis.T @ along / scale
        derivative = (self._basis.T @ moved - np.outer(residuals, self._scaled.ravel() @ moved)) / scale
        return self._white @ residuals, self._white @ derivative

    def by_camera(self, camera: Camera) -> Floats:
        """Return how the measured homography moves with the camera's numbers, (8, P), in the residuals' units."""
        H = np.linalg.inv(self._T) @ self._scaled
        points = np.column_stack((self.template_xy, np.ones(len(self.template_xy))))
        normalised = points @ _unit_similarity(self.template_xy).T
        x, y, w = H @ normalised.T
        ideal = np.column_stack((x / w, y / w))
        u, v, _ = self._T @ np.vstack((ideal.T, np.ones(len(ideal))))
        by_H = np.zeros((len(points), 2, 9))
        by_H[:, 0, :3] = by_H[:, 1, 3:6] = normalised / (self._scaled @ normalised.T)[2][:, None]
        by_H[:, :, 6:] = -np.stack((u, v), axis=1)[:, :, None] * by_H[:, :1, :3]
        rows = by_H.reshape(-1, 9) @ self._basis
        moved = self._T[0, 0] * ideal_by_camera(camera, ideal)
        tangent = np.linalg.lstsq(rows, moved.reshape(len(rows), -1), rcond=None)[0]
        return np.asarray(self._white @ tangent, np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class _RigidFit:
    """A pose of least squares: its squares, the residuals' derivative, its covariance by them, and the planes."""

    transform: RigidTransform
    squared: float
    by_step: Floats
    covariance: Floats
    planes: Sequence[_PlaneResiduals]

    def pose(self, rms_px: float) -> Pose:
        """Return the pose with its covariance, which grows where the planes contradict each other (Birge 1932)."""
        covariance = self.covariance
        freedom = len(self.by_step) - 6
        part = 2 / (9 * freedom)
        if self.squared > freedom * (1 - part + _QUANTILE_99 * math.sqrt(part)) ** 3:
            covariance = covariance * (self.squared / freedom)
        return Pose(self.transform.R, self.transform.t, (covariance + covariance.T) / 2, rms_px)

    def by_camera(self, camera: Camera) -> Floats:
        """Return the derivative (6, P) of the pose's error by the camera's numbers, true less given."""
        moved = np.vstack([plane.by_camera(camera) for plane in self.planes])
        return np.asarray(self.covariance @ (self.by_step.T @ moved), np.float64)


def _distinct(starts: Sequence[RigidTransform], planes: Sequence[_PlaneResiduals]) -> list[_RigidFit]:
    """Return the different poses that starts lead to, best first; DegenerateConfiguration where none leads to one."""
    fits: list[_RigidFit] = []
    for start in starts:
        try:
            fits.append(_minimised(start, planes))
        except (EstimationError, np.linalg.LinAlgError):
            continue  # a start behind the camera, or one that is seen edge-on
    if not fits:
        raise DegenerateConfiguration("planes: no pose in front of the camera fits them")
    fits.sort(key=lambda fit: fit.squared)
    kept = fits[:1]
    for fit in fits[1:]:
        if all(np.linalg.norm(log_so3(fit.transform.R @ other.transform.R.T)) > _SAME for other in kept):
            kept.append(fit)
    return kept


def _minimised(start: RigidTransform, planes: Sequence[_PlaneResiduals]) -> _RigidFit:
    """Return the pose of least squares near a start, by Levenberg-Marquardt."""
    at, damping = start, _FIRST_DAMPING
    residuals, by_step = _linearised(at, planes)
    squared = float(residuals @ residuals)
    for _ in range(_MOST_STEPS):
        normal, gradient = by_step.T @ by_step, by_step.T @ residuals
        step = -np.linalg.solve(normal + damping * np.diag(np.diag(normal)), gradient)
        if float(step @ normal @ step) < _TOLERANCE**2:
            break
        moved = RigidTransform(exp_so3(step[3:]) @ at.R, at.t + step[:3])
        try:
            new_residuals, new_by_step = _linearised(moved, planes)
            new_squared = float(new_residuals @ new_residuals)
        except EstimationError:
            new_squared = math.inf
        if new_squared <= squared:
            is_last = squared - new_squared <= _NO_BETTER * squared
            at, residuals, by_step, squared = moved, new_residuals, new_by_step, new_squared
            damping /= _FACTOR
            if is_last:
                break
        elif damping > _MOST_DAMPING:
            break
        else:
            damping *= _FACTOR
    covariance = np.linalg.inv(by_step.T @ by_step)
    if not (math.isfinite(squared) and np.isfinite(covariance).all()):
        raise DegenerateConfiguration("planes: residuals that are not finite; need another start")
    return _RigidFit(at, squared, by_step, covariance, planes)


def _linearised(pose: RigidTransform, planes: Sequence[_PlaneResiduals]) -> tuple[Floats, Floats]:
    parts = [plane.linearised(pose) for plane in planes]
    return np.concatenate([residuals for residuals, _ in parts]), np.vstack([by_step for _, by_step in parts])


def _cross(v: Floats) -> Floats:
    x, y, z = v.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _unit_similarity(points: Floats) -> Floats:
    x, y = centre = points.mean(axis=0)
    factor = 1 / math.sqrt(float(((points - centre) ** 2).mean()))
    return np.array([[factor, 0, -factor * x], [0, factor, -factor * y], [0, 0, 1]])
