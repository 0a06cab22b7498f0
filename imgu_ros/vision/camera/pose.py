"""The pose of a camera before a plane."""

from __future__ import annotations

from dataclasses import dataclass

from imgu_ros.types import Floats, Matrix3


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """A rigid transform `dst_from_src` with its covariance.

    Attributes
    ----------
    R : (3, 3) rotation
    t : (3,) m
    covariance : (6, 6) of (x y z rx ry rz), m and rad, in the destination's axes: R_true = Exp(delta) R
    rms_px : root mean square reprojection error it was estimated with, px (per coordinate)
    """

    R: Matrix3
    t: Floats
    covariance: Floats
    rms_px: float
