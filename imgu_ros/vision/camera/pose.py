# SPDX-License-Identifier: Apache-2.0
"""The pose of a camera before a plane."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Matrix3, as_floats
from imgu_ros.vision.camera.rigid import RigidTransform

#: Squares of larger numbers, summed, overflow.
_LARGEST = 1e100


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
