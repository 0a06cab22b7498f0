"""A homography with what is known about it."""

from __future__ import annotations

from dataclasses import dataclass

from imgu_ros.types import Floats, Mask, Matrix3


@dataclass(frozen=True, slots=True, eq=False)
class HomographyEstimate:
    """An estimated homography.

    Attributes
    ----------
    H : (3, 3), unit Frobenius norm, det H > 0
    covariance : (9, 9) of H's elements, row-major, rank 8 (nothing along H itself)
    inliers : (N,) which of the points it was estimated from agree with it
    rms_px : root mean square residual of the inliers in the destination image, px (per coordinate)
    iterations : samples drawn by the robust search
    """

    H: Matrix3
    covariance: Floats
    inliers: Mask
    rms_px: float
    iterations: int
