# SPDX-License-Identifier: Apache-2.0
"""What the picture of a plane says about the camera's calibration: two numbers a frame beyond the pose's six.

A homography has eight degrees of freedom, a calibrated camera's pose before a plane six. In the two directions that no
pose explains, residuals are noise when the calibration is right (the same constraint that Zhang 2000 calibrates from).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from imgu_ros.errors import DegenerateConfiguration
from imgu_ros.types import Floats

#: Directions of a homography that no pose explains.
FREEDOM = 2
#: No pixel coordinate is known better than this.
LEAST_NOISE_PX = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationTest:
    """A linear model of the misfit of a plane's homography and of a pose, about the calibration that was used.

    With c the camera's numbers fx, fy, cx, cy and the distortion coefficients, true less given ones:
    residual = by_camera c + noise, and the pose's error (true less estimated) is pose_by_camera c + its own noise.

    Attributes
    ----------
    residual : (2,) without unit: what is left in the two directions that no pose explains
    covariance : (2, 2) of its noise
    by_camera : (2, P)
    pose_by_camera : (6, P)
    """

    residual: Floats
    covariance: Floats
    by_camera: Floats
    pose_by_camera: Floats

    @property
    def chi_squared(self) -> float:
        """The squared residual in units of its covariance: 2 on average when the calibration is right."""
        return float(self.residual @ np.linalg.solve(self.covariance, self.residual))

    @classmethod
    def of_residuals(
        cls, residuals: Floats, by_pose: Floats, across: Floats, by_camera: Floats, covariance: Floats, freedom: float
    ) -> Self:
        """Split whitened residuals into what a pose explains and what none does.

        Parameters
        ----------
        residuals : (N,) modelled less measured, at the best pose, with errors of like size
        by_pose : (N, 6) their derivative by the pose
        across : (N, 2) orthonormal, of the homography's directions that are orthogonal to the columns of `by_pose`
        by_camera : (N, P) their derivative by the camera's numbers, true less given, with the opposite sign
        covariance : (2, 2) of the residuals' noise along `across`
        freedom : degrees of freedom that the noise was estimated with

        Raises
        ------
        DegenerateConfiguration
            If the residuals do not determine the pose, or have no noise.
        """
        try:
            of_pose = np.linalg.solve(by_pose.T @ by_pose, by_pose.T)
        except np.linalg.LinAlgError:
            raise DegenerateConfiguration(
                "pose: nothing determines it; need a plane that is not seen edge-on"
            ) from None
        residual = across.T @ residuals
        a, b, d = covariance[0, 0], (covariance[0, 1] + covariance[1, 0]) / 2, covariance[1, 1]
        determinant = a * d - b * b
        if not determinant > 0:
            raise DegenerateConfiguration("pose: the residuals have no noise; need measured points")
        squared = float(d * residual[0] ** 2 - 2 * b * residual[0] * residual[1] + a * residual[1] ** 2) / determinant
        # Of few points the noise is not known well: a misfit is worth as much as a chi-squared one as improbable
        # (the F distribution of 2 and `freedom` degrees of freedom has a closed form).
        worth = 1.0
        if squared > 0:
            worth = freedom * math.log1p(squared / freedom) / squared
        symmetric = np.array([[a, b], [b, d]])
        return cls(residual, symmetric / max(worth, 1e-300), across.T @ by_camera, of_pose @ by_camera)
