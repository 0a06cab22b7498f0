# SPDX-License-Identifier: Apache-2.0
"""Rigid transforms, and the seven numbers that stand for them in files and parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Matrix3, as_matrix
from imgu_ros.vision.camera.rotation import from_quaternion, quaternion

#: A quaternion with smaller components was not filled in, and is not one to normalise.
_SHORTEST_QUATERNION = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class RigidTransform:
    """`dst_from_src`: x_dst = R x_src + t.

    Attributes
    ----------
    R : (3, 3) rotation
    t : (3,) m
    """

    R: Matrix3
    t: Floats

    @property
    def matrix(self) -> Floats:
        """The homogeneous matrix, (4, 4)."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.R, self.t
        return matrix

    def after(self, first: RigidTransform) -> RigidTransform:
        """Return the transform that applies `first`, then this one."""
        return RigidTransform(self.R @ first.R, self.R @ first.t + self.t)

    def inverse(self) -> RigidTransform:
        """Return `src_from_dst`."""
        return RigidTransform(self.R.T, -self.R.T @ self.t)

    def numbers(self) -> Floats:
        """Return (7,): tx ty tz (m), qx qy qz qw with qw >= 0; the inverse of `rigid_transform`."""
        return np.concatenate((self.t, quaternion(self.R)))


def rigid_transform(numbers: ArrayLike, name: str = "transform") -> RigidTransform:
    """Return the transform of seven numbers: tx ty tz (m), qx qy qz qw (brought to unit length).

    Raises
    ------
    ShapeError
        If they are not seven finite numbers, or the quaternion is zero; it calls them by `name`.
    """
    values = as_matrix(numbers, (7,), name)
    if np.abs(values[3:]).max() < _SHORTEST_QUATERNION:
        raise ShapeError(f"{name}: quaternion {values[3:].tolist()}; need one of unit length")
    return RigidTransform(from_quaternion(values[3:]), values[:3].copy())


def rigid_transforms(numbers: ArrayLike, name: str = "transforms") -> tuple[RigidTransform, ...]:
    """Return the transforms of a flat list, seven numbers each; see `rigid_transform`.

    Raises
    ------
    ShapeError
        If their count is no multiple of seven, or seven of them are no transform: `name[index]`.
    """
    try:
        raw = np.asarray(numbers)
        values = raw.astype(np.float64).ravel() if raw.dtype.kind in "biufO" else None
    except (TypeError, ValueError, OverflowError):
        values = None
    if values is None:
        raise ShapeError(f"{name}: {type(numbers).__name__}; need seven numbers a transform: x y z qx qy qz qw")
    if values.size % 7:
        raise ShapeError(f"{name}: {values.size} numbers; need seven a transform: x y z qx qy qz qw")
    return tuple(rigid_transform(row, f"{name}[{i}]") for i, row in enumerate(values.reshape(-1, 7)))
