# SPDX-License-Identifier: Apache-2.0
"""How exact the pose of a reference will be: what the estimator says of its error, in simulated views."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imgu_ros.check.trial_views import TrialView, TrialViews
from imgu_ros.config.components import DevelopmentParameters
from imgu_ros.config.parameters import Parameters
from imgu_ros.errors import EstimationError
from imgu_ros.image.frame_image import develop_frame
from imgu_ros.pose.planar_pose import distorting_camera
from imgu_ros.reference.reference import Reference
from imgu_ros.result import PoseStatus, ReferenceResult, Status
from imgu_ros.track.patch_alignment import align_patches
from imgu_ros.track.tracker import Followed, followed_result
from imgu_ros.types import Floats
from imgu_ros.vision.camera.rotation import log_so3

#: Tilt of the views, degrees: straight on depth and rotation are told worst, at 60 degrees the far side is small.
TILT_DEG = 30.0
#: Views of each size, with other rolls and directions of tilt; errors that are drawn from the covariance of each.
_VIEWS, _DRAWS = 8, 250
#: Median of chi-squared with 6 degrees of freedom: what squared errors in units of their covariance have.
_MEDIAN_SQUARE = 5.348
#: A view begins where tracking does: right to this, px.
_REACH_PX = 2.0
_GOLDEN = math.pi * (3 - math.sqrt(5))


@dataclass(frozen=True, slots=True)
class ExpectedError:
    """Expected error of the pose of one frame; random, without that of calibration and print.

    Attributes
    ----------
    seen_px : longer side, seen straight on
    distance_m : of the centre
    position_m, rotation_deg : medians of the lengths of the errors; None: no pose
    ambiguous_share : share of the views whose pose is ambiguous
    """

    seen_px: float
    distance_m: float
    position_m: float | None
    rotation_deg: float | None
    ambiguous_share: float


def expected_errors(
    reference: Reference, views: TrialViews, parameters: Parameters, sizes_px: Sequence[float], seed: int = 0
) -> tuple[ExpectedError, ...]:
    """Return the expected error at each size.

    The estimator aligns the reference with simulated views, from its true place, and says the covariance of each. Drawn
    from these, and scaled by how far the errors of all views of all sizes are from them, errors have the expected
    median.

    Parameters
    ----------
    reference : made with the same parameters, its width known
    views : of it
    parameters : of the pipeline
    sizes_px : longer sides, px
    seed : of the views
    """
    seen = [_views_of(reference, views, parameters, size, seed + index) for index, size in enumerate(sizes_px)]
    scale = _scale([error for errors in seen for error in errors])
    return tuple(
        _expected(size, views.distance_m(size), errors, scale) for size, errors in zip(sizes_px, seen, strict=True)
    )


@dataclass(frozen=True, slots=True, eq=False)
class _ViewError:
    """Of one view: what the estimator expects, (6, 6), its error, (6,), and whether it says two poses."""

    covariance: Floats
    error: Floats
    is_ambiguous: bool


def _views_of(
    reference: Reference, views: TrialViews, parameters: Parameters, seen_px: float, seed: int
) -> list[_ViewError]:
    first = float(np.random.default_rng([seed, 0xE]).uniform(0, 2 * math.pi))
    errors = []
    for index in range(_VIEWS):
        axis = first + index * math.pi / _VIEWS
        view = views.centred(seen_px, math.radians(TILT_DEG), axis, index * _GOLDEN, seed * _VIEWS + index)
        found = _pose(reference, view, parameters)
        if found is None or not found.solutions:
            continue
        # Of two solutions the right one: which it is is another question.
        pose = min(found.solutions, key=lambda each: abs(float(np.trace(each.R.T @ view.pose.R)) - 3))
        error = np.concatenate((view.pose.t - pose.t, log_so3(view.pose.R @ pose.R.T)))
        errors.append(_ViewError(pose.covariance, error, found.pose_status is PoseStatus.AMBIGUOUS))
    return errors


def _scale(errors: Sequence[_ViewError]) -> float:
    """Return by how much larger errors are than what their covariances say, of all views together."""
    if not errors:
        return 1.0
    squares = [float(each.error @ np.linalg.solve(each.covariance, each.error)) for each in errors]
    return math.sqrt(float(np.median(squares)) / _MEDIAN_SQUARE)


def _expected(seen_px: float, distance_m: float, errors: Sequence[_ViewError], scale: float) -> ExpectedError:
    if len(errors) <= _VIEWS // 2:
        return ExpectedError(seen_px, distance_m, None, None, 0.0)
    rng = np.random.default_rng(0xE)
    drawn = [
        rng.multivariate_normal(np.zeros(6), (each.covariance + each.covariance.T) / 2, _DRAWS, method="eigh")
        for each in errors
    ]
    e = scale * np.concatenate(drawn)
    position = float(np.median(np.linalg.norm(e[:, :3], axis=1)))
    rotation = math.degrees(float(np.median(np.linalg.norm(e[:, 3:], axis=1))))
    ambiguous = sum(each.is_ambiguous for each in errors) / len(errors)
    return ExpectedError(seen_px, distance_m, position, rotation, ambiguous)


def _pose(reference: Reference, view: TrialView, parameters: Parameters) -> ReferenceResult | None:
    p, frame = parameters, view.frame
    developed = develop_frame(frame, DevelopmentParameters.of(p))
    if developed.image is None:
        return None
    try:
        aligned = align_patches(
            developed.image, reference, view.H, distorting_camera(frame.camera), p.refinement,
            p.homography.min_inliers, _REACH_PX,
        )  # fmt: skip
        followed = followed_result(reference, Followed(aligned, 1.0), Status.DETECTED)
        return reference.pose(followed, aligned, frame)
    except EstimationError:
        return None
