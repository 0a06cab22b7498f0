# SPDX-License-Identifier: Apache-2.0
"""A calibrated camera's pose from points in space, with or without wrong correspondences (IU 8.1.5, 7.5).

The start is SQPnP (Terzakis & Lourakis 2020) or, in samples of three, P3P, both from OpenCV; the refinement and the
covariance are ours. For points of one plane, `planar_pose` also tells the second solution.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_integer, as_number, require_type
from imgu_ros.errors import DegenerateConfiguration, ShapeError, TooFewPoints
from imgu_ros.types import Floats, Indices, Mask, Points
from imgu_ros.vision.camera.camera_covariance import covariance_factor
from imgu_ros.vision.camera.camera_derivatives import raw_by_camera
from imgu_ros.vision.camera.correspondences import as_correspondences
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.camera.pose_problem import PoseProblem
from imgu_ros.vision.camera.rotation import exp_so3
from imgu_ros.vision.estimation.chance import pair_probability, shares_of_places
from imgu_ros.vision.estimation.covariance import propagated_covariance, selection_efficiency
from imgu_ros.vision.estimation.nonlinear import minimise
from imgu_ros.vision.estimation.ransac import ransac
from imgu_ros.vision.estimation.settling import InlierFit

#: Three points leave up to four poses; the fourth chooses.
_FEWEST_POINTS = 4
#: The three points of a sample agree with its pose; three more must confirm it.
_FEWEST_INLIERS = 6
#: Smallest extent of the points across their main line, as a share of the largest (both RMS).
_NARROWEST = 1e-3
#: Larger numbers are no coordinates of a scene or a picture, m or px.
_LARGEST = 1e9


def fit_pose(points: ArrayLike, pixels: ArrayLike, camera: Camera, noise_px: float | None = None) -> Pose:
    """Estimate camera_from_object from correspondences without outliers.

    Parameters
    ----------
    points : (N, 3) m, N >= 4, not on a line
    pixels : (N, 2) raw px, distortion and all
    camera : intrinsics; their covariance, when they have one, is in the pose's
    noise_px : standard deviation of a pixel coordinate; None: from the residuals

    Raises
    ------
    ShapeError
        If an array has another shape or is not finite.
    TooFewPoints
        If there are fewer than four points (within the lens model's range).
    DegenerateConfiguration
        If the points do not determine a pose with all of them in front of the camera.

    Examples
    --------
    >>> from imgu_ros.vision.camera import make_camera
    >>> camera = make_camera([[500, 0, 320], [0, 500, 240], [0, 0, 1]], (), "plumb_bob", 640, 480)
    >>> points = np.array([[0, 0, 0], [0.2, 0, 0], [0, 0.2, 0], [0, 0, 0.2], [0.2, 0.2, 0.1]])
    >>> fit_pose(points, camera.project(points + [0.1, 0.05, 1.0]), camera).t.round(9).tolist()
    [0.1, 0.05, 1.0]
    """
    require_type(camera, Camera, "camera")
    noise_px = None if noise_px is None else as_number(noise_px, "noise_px")
    points, pixels = as_correspondences(points, pixels, _FEWEST_POINTS, largest=_LARGEST)
    if noise_px is not None and not 0 < noise_px < math.inf:
        raise ShapeError(f"noise_px: {noise_px}; need a positive number, or None")
    normalized, valid = camera.undistort(pixels)
    points, pixels, normalized = points[valid], pixels[valid], normalized[valid]
    if len(points) < _FEWEST_POINTS:
        raise TooFewPoints(f"pixels: {len(points)} within the lens model's range; need at least {_FEWEST_POINTS}")
    singular = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if not singular[1] > _NARROWEST * singular[0]:
        raise DegenerateConfiguration(f"points: {len(points)} on a line; need points that span a plane at least")
    minimum = minimise(PoseProblem(points, pixels, camera), _sqpnp(points, normalized), max_iterations=30)
    R, t = minimum.estimate[:3, :3], minimum.estimate[:3, 3]
    rms = math.sqrt(float((minimum.linearisation.residuals**2).mean()))
    pose = Pose(R, t, propagated_covariance(minimum, noise_px), rms)
    if camera.covariance is None:
        return pose
    by_pose = minimum.linearisation.jacobian.reshape(-1, 6)
    by_camera = raw_by_camera(camera, points @ R.T + t).reshape(len(by_pose), -1)
    of_camera = -np.linalg.solve(by_pose.T @ by_pose, by_pose.T @ by_camera)
    return pose.with_shared_error(of_camera @ covariance_factor(camera))


def estimate_pose(
    points: ArrayLike,
    pixels: ArrayLike,
    camera: Camera,
    rng: np.random.Generator | int,
    *,
    threshold_px: float = 3.0,
    confidence: float = 0.9999,
    max_iterations: int = 2000,
) -> PoseEstimate:
    """Estimate camera_from_object by sample consensus, then refine it on the inliers.

    Parameters
    ----------
    points, pixels, camera : as in `fit_pose`
    rng : source of the draws, or its seed
    threshold_px : largest reprojection error of an inlier
    confidence, max_iterations : see `ransac`

    Returns
    -------
    The pose of the inliers that are returned; its covariance allows for what the threshold cut off
    (`selection_efficiency`).

    Raises
    ------
    TooFewPoints, NoConsensus, DegenerateConfiguration
        If the correspondences, or those that agree, do not determine a pose, or as many agree by chance.
    """
    require_type(camera, Camera, "camera")
    threshold_px = as_number(threshold_px, "threshold_px")
    confidence = as_number(confidence, "confidence")
    max_iterations = as_integer(max_iterations, "max_iterations")
    model = PoseModel(points, pixels, camera)
    consensus = ransac(
        model,
        threshold_px,
        rng,
        confidence=confidence,
        max_iterations=max_iterations,
        min_inliers=_FEWEST_INLIERS,
        unit=" px",
    )
    settled = InlierFit(
        lambda mask: fit_pose(model.points[mask], model.pixels[mask], camera),
        lambda pose: model.squared_errors(np.column_stack((pose.R, pose.t))[None])[0] <= threshold_px**2,
        _FEWEST_INLIERS,
        model.count,
    ).settled(consensus.inliers)
    pose, inliers = settled.result, settled.inliers
    count = int(np.count_nonzero(inliers))
    variance = pose.rms_px**2 * 2 * count / (2 * count - 6)
    noise_px = math.sqrt(variance) / selection_efficiency(2 * variance, threshold_px)
    if noise_px > 0:  # points that agree to the last digit tell of no noise
        pose = fit_pose(model.points[inliers], model.pixels[inliers], camera, noise_px)
    return PoseEstimate(pose, inliers, consensus.iterations)


@dataclass(frozen=True, slots=True, eq=False)
class PoseEstimate:
    """A pose, and what agrees with it.

    Attributes
    ----------
    pose : camera_from_object
    inliers : (N,) the correspondences that it was fitted to: those that agree with it
    iterations : samples drawn
    """

    pose: Pose
    inliers: Mask
    iterations: int


class PoseModel:
    """The model of `ransac` for poses of a calibrated camera: hypotheses are [R | t], (B, 3, 4), errors squared px.

    Parameters
    ----------
    points, pixels, camera : as in `fit_pose`
    """

    codimension = 2

    def __init__(self, points: ArrayLike, pixels: ArrayLike, camera: Camera) -> None:
        require_type(camera, Camera, "camera")
        self.points, self.pixels = as_correspondences(points, pixels, _FEWEST_POINTS, largest=_LARGEST)
        self._camera = camera
        self._normalized, self._valid = camera.undistort(self.pixels)

    @property
    def count(self) -> int:
        """Number of correspondences."""
        return len(self.points)

    @property
    def sample_size(self) -> int:
        """Three correspondences leave up to four poses."""
        return 3

    def generate(self, samples: Indices) -> Floats:
        """Return the poses, (B', 3, 4), of samples (B, 3): up to four of each."""
        poses = []
        for sample in samples[self._valid[samples].all(axis=1)]:
            poses += _p3p(self.points[sample], self._normalized[sample])
        return np.stack(poses) if poses else np.zeros((0, 3, 4))

    def squared_errors(self, hypotheses: Floats) -> Floats:
        """Return the squared reprojection errors (B, N) in raw px; inf for points behind the camera."""
        turned = np.einsum("bij,nj->bni", hypotheses[:, :, :3], self.points) + hypotheses[:, None, :, 3]
        in_front = turned[:, :, 2] > 1e-9 * np.abs(turned).max(axis=2)
        squared = np.full(in_front.shape, np.inf)
        if in_front.any():
            try:
                seen = self._camera.project(turned[in_front])
            except ShapeError:  # a wild hypothesis: points so far off the axis that the lens model overflows
                if len(hypotheses) == 1:
                    return squared
                return np.concatenate([self.squared_errors(hypothesis[None]) for hypothesis in hypotheses])
            measured = np.broadcast_to(self.pixels, (len(hypotheses), *self.pixels.shape))[in_front]
            squared[in_front] = np.minimum(((seen - measured) ** 2).sum(axis=1), 1e30)
        return squared

    def shares(self, threshold: float) -> Floats:
        """Return what each correspondence counts, (N,): 1 / number of those whose pixels are within the threshold."""
        return shares_of_places(self.pixels, threshold)

    def agreement_probability(self, hypothesis: Floats, threshold: float) -> float:
        """Return the probability that a wrong correspondence agrees, told by wrong pairs of these points."""
        turned = self.points @ hypothesis[:, :3].T + hypothesis[:, 3]
        in_front = turned[:, 2] > 1e-9 * np.abs(turned).max(axis=1)
        try:
            seen = np.clip(self._camera.project(turned[in_front]), -_LARGEST, _LARGEST)
        except ShapeError:
            return 1.0
        return float(in_front.mean()) * pair_probability(seen, self.pixels[in_front], threshold)

    def refit(self, hypothesis: Floats, inliers: Mask) -> Floats:
        """Return the refined pose of all inliers."""
        del hypothesis
        pose = fit_pose(self.points[inliers], self.pixels[inliers], self._camera)
        return np.column_stack((pose.R, pose.t))


def _sqpnp(points: Floats, normalized: Points) -> Floats:
    """Return the best start, a rigid transform (4, 4)."""
    try:
        done, rvec, tvec = cv2.solvePnP(
            points, np.ascontiguousarray(normalized), np.eye(3), np.zeros(4), flags=cv2.SOLVEPNP_SQPNP
        )
    except cv2.error as error:
        raise DegenerateConfiguration(f"points: no pose ({' '.join(str(error.err).split())})") from None
    if not (done and np.isfinite(rvec).all() and np.isfinite(tvec).all()):
        raise DegenerateConfiguration("points: no pose in front of the camera explains them; need points in its view")
    start = np.eye(4)
    start[:3, :3] = exp_so3(np.asarray(rvec, np.float64).ravel())
    start[:3, 3] = np.asarray(tvec, np.float64).ravel()
    return start


def _p3p(points: Floats, normalized: Points) -> list[Floats]:
    try:
        _, rotations, translations = cv2.solveP3P(
            points, np.ascontiguousarray(normalized), np.eye(3), np.zeros(4), flags=cv2.SOLVEPNP_AP3P
        )
    except cv2.error:
        return []  # a degenerate sample
    poses = []
    for rvec, tvec in zip(rotations, translations, strict=True):
        if np.isfinite(rvec).all() and np.isfinite(tvec).all():
            R = exp_so3(np.asarray(rvec, np.float64).ravel())
            poses.append(np.column_stack((R, np.asarray(tvec, np.float64).ravel())))
    return poses
