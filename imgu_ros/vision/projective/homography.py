# SPDX-License-Identifier: Apache-2.0
"""A homography with what is known about it."""

from __future__ import annotations

from dataclasses import dataclass

from imgu_ros.types import Choice, Floats, Mask, Matrix3


class Orientation(Choice):
    """From which side a plane may be seen."""

    FRONT = "front"  #: turning the same way in both sets of points, as a picture and a photograph of it do
    MIRRORED = "mirrored"  #: turning the other way: y up in one and down in the other, or a plane seen from behind
    ANY = "any"  #: either: for an estimate of wrong and right matches, the one that more agree on


@dataclass(frozen=True, slots=True, eq=False)
class HomographyEstimate:
    """An estimated homography.

    Attributes
    ----------
    H : (3, 3), unit Frobenius norm, w > 0 at the points: det H > 0, or < 0 where the plane is seen mirrored
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
