# SPDX-License-Identifier: Apache-2.0
"""Poses with their covariance, and the one or two poses that the view of a plane allows."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from imgu_ros.errors import EstimationError, ShapeError
from imgu_ros.types import Floats, Matrix3, as_floats
from imgu_ros.vision.camera.calibration_test import CalibrationTest
from imgu_ros.vision.camera.rigid import RigidTransform

#: Squares of larger numbers, summed, overflow.
_LARGEST = 1e100
#: benchmarks/thresholds.py, study ambiguity.
_REFUTED = 5.0

_Start = TypeVar("_Start")


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """A rigid transform `dst_from_src` with its covariance.

    Attributes
    ----------
    R : (3, 3) rotation
    t : (3,) m
    covariance : (6, 6) of (x y z rx ry rz), m and rad, in the destination's axes: R_true = Exp(delta) R
    rms_px : root mean square reprojection error it was estimated with, px (per coordinate)
    shared : (6, k) F: the part F F^T of the covariance is of k independent errors, of variance 1, that other poses by
        the same camera share, in the same order; None: nothing is
    """

    R: Matrix3
    t: Floats
    covariance: Floats
    rms_px: float
    shared: Floats | None = None

    @property
    def transform(self) -> RigidTransform:
        """The pose without its covariance."""
        return RigidTransform(self.R, self.t)

    def with_shared_error(self, factor: Floats) -> Pose:
        """Return the pose with one more error, of covariance F F^T, that other poses share.

        Parameters
        ----------
        factor : (6, k) F

        Raises
        ------
        ShapeError
            If it is not that, or not finite.
        """
        factor = as_floats(factor, "factor")
        if factor.ndim != 2 or len(factor) != 6 or not np.abs(factor).max(initial=0) < _LARGEST:
            raise ShapeError(f"factor: shape {factor.shape}; need (6, k) numbers of the size of a pose's errors")
        shared = factor if self.shared is None else np.hstack((self.shared, factor))
        return replace(self, covariance=self.covariance + factor @ factor.T, shared=shared)

    def inverse(self) -> Pose:
        """Return `src_from_dst`, its covariance about the new destination's axes.

        With R_true = Exp(d) R and t_true = t + e, the true inverse is, to first order in d and e,

            R_true^T = Exp(-R^T d) R^T
            -R_true^T t_true = -R^T t - R^T e - R^T [t]x d

        so that the errors (e, d) of the pose become J (e, d), J = -[[R^T, R^T [t]x], [0, R^T]]: but for the sign, the
        adjoint of the inverse (Barfoot, State Estimation for Robotics, 7.1.4) with translation first, as ROS orders it.
        """
        inverse = self.transform.inverse()
        x, y, z = self.t
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        J = np.zeros((6, 6))
        J[:3, :3] = J[3:, 3:] = -inverse.R
        J[:3, 3:] = -inverse.R @ cross
        shared = None if self.shared is None else J @ self.shared
        return Pose(inverse.R, inverse.t, J @ self.covariance @ J.T, self.rms_px, shared)


@dataclass(frozen=True, slots=True, eq=False)
class PlanarPoses:
    """The poses that the view of a plane allows.

    Attributes
    ----------
    solutions : one or two refined poses camera_from_plane, best first; a second one that is refuted clearly, by five
        times the error, is left out
    ambiguity : best / second-best RMS reprojection error, 0 (clear) to 1; 0 when only one pose lies before the camera
    calibration : what the best one leaves unexplained, and how that depends on the camera; None: not asked for, or
        there are no more points than a homography needs
    """

    solutions: tuple[Pose, ...]
    ambiguity: float
    calibration: CalibrationTest | None = None


def ranked_poses_unchecked(
    starts: Iterable[_Start], start_rms_px: Callable[[_Start], float], refined: Callable[[_Start], Pose]
) -> PlanarPoses:
    """Refine the poses that the view of a plane allows, and rank them by their error.

    Parameters
    ----------
    starts : poses camera_from_plane, the better one first: most second ones are refuted without refinement
    start_rms_px : root mean square error of a start, px; may raise EstimationError
    refined : the pose of least error near a start; may raise EstimationError

    Returns
    -------
    Without solutions when every start failed.
    """
    found: list[Pose] = []
    refuted_px = math.inf
    for start in starts:
        try:
            if found:
                start_px = start_rms_px(start)
                if start_px > _REFUTED * found[0].rms_px:
                    refuted_px = start_px
                    continue
            found.append(refined(start))
        except EstimationError:
            continue  # a start behind the camera or at a grazing angle is no solution
    if not found:
        return PlanarPoses((), 0.0)
    if len(found) > 1:
        found.sort(key=lambda pose: pose.rms_px)
        if _same(found[0], found[1]):
            found = found[:1]
    second_px = found[1].rms_px if len(found) > 1 else refuted_px
    return PlanarPoses(tuple(found), found[0].rms_px / second_px if second_px > 0 else 0.0)


def _same(a: Pose, b: Pose) -> bool:
    """Whether two refinements ended in the same minimum, to 0.1 mrad and a ten thousandth of the distance."""
    angle = math.acos(min(1.0, max(-1.0, (float(np.trace(a.R.T @ b.R)) - 1) / 2)))
    return angle < 1e-4 and float(np.linalg.norm(a.t - b.t)) < 1e-4 * float(np.linalg.norm(a.t))
