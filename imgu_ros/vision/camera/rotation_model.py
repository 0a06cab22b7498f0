# SPDX-License-Identifier: Apache-2.0
"""The rotation between two views from one place, from correspondences of which some are wrong (IU 7.5, 8.1.5)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_integer, as_number, require_type
from imgu_ros.errors import DegenerateConfiguration, ShapeError, TooFewPoints
from imgu_ros.types import Floats, Indices, Mask, Matrix3, Points, as_points
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.rotation import exp_so3
from imgu_ros.vision.estimation.chance import pair_probability, shares_of_places
from imgu_ros.vision.estimation.covariance import propagated_covariance, selection_efficiency
from imgu_ros.vision.estimation.directions import DirectionsModel
from imgu_ros.vision.estimation.nonlinear import Linearisation, minimise
from imgu_ros.vision.estimation.ransac import ransac
from imgu_ros.vision.estimation.sampling import Sampler
from imgu_ros.vision.estimation.settling import InlierFit

#: Two directions determine a rotation.
_FEWEST_POINTS = 2
#: px, beyond which no picture reaches.
_LARGEST = 1e9


@dataclass(frozen=True, slots=True, eq=False)
class RotationEstimate:
    """An estimated rotation.

    Attributes
    ----------
    R : (3, 3) dst_from_src
    covariance : (3, 3) rad^2, R_true = Exp(delta) R
    inliers : (N,) the correspondences that it was fitted to: those that agree with it
    rms_px : root mean square residual of the inliers in the second view, px (per coordinate)
    iterations : samples drawn
    """

    R: Matrix3
    covariance: Floats
    inliers: Mask
    rms_px: float
    iterations: int


def estimate_rotation(
    src: ArrayLike,
    dst: ArrayLike,
    camera_src: Camera,
    camera_dst: Camera,
    rng: np.random.Generator | int,
    *,
    threshold_px: float = 3.0,
    sampler: Sampler | str = Sampler.UNIFORM,
    confidence: float = 0.9999,
    max_iterations: int = 2000,
) -> RotationEstimate:
    """Estimate the rotation of a camera that stayed in place, by sample consensus, refined by the error in `dst`.

    Parameters
    ----------
    src, dst : (N, 2) raw px of the two views, N >= 2
    camera_src, camera_dst : of the two views
    rng : source of the draws, or its seed
    threshold_px : largest error of an inlier in dst, px
    sampler, confidence, max_iterations : see `ransac`

    Raises
    ------
    TooFewPoints, NoConsensus
        If there are too few correspondences, too few agree, or as many would by chance.
    DegenerateConfiguration
        If those that agree lie in one direction.
    """
    require_type(camera_src, Camera, "camera_src")
    require_type(camera_dst, Camera, "camera_dst")
    threshold_px = as_number(threshold_px, "threshold_px")
    confidence = as_number(confidence, "confidence")
    max_iterations = as_integer(max_iterations, "max_iterations")
    model = RotationModel(src, dst, camera_src, camera_dst)
    consensus = ransac(
        model,
        threshold_px,
        rng,
        sampler=sampler,
        confidence=confidence,
        max_iterations=max_iterations,
        unit=" px",
    )
    start = consensus.hypothesis
    settled = InlierFit(
        lambda mask: minimise(_RotationProblem(model.rays_src[mask], model.dst[mask], camera_dst), start),
        lambda minimum: model.squared_errors(minimum.estimate[None])[0] <= threshold_px**2,
        _FEWEST_POINTS + 1,
        model.count,
    ).settled(consensus.inliers)
    minimum, inliers = settled.result, settled.inliers
    squares = float((minimum.linearisation.residuals**2).sum())
    count = int(np.count_nonzero(inliers))
    efficiency = selection_efficiency(2 * squares / (2 * count - 3), threshold_px)
    covariance = propagated_covariance(minimum) / efficiency**2
    rms = math.sqrt(squares / (2 * count))
    return RotationEstimate(minimum.estimate, covariance, inliers, rms, consensus.iterations)


class RotationModel:
    """The model of `ransac` for rotations: hypotheses are (B, 3, 3), errors squared px in the second view.

    Parameters
    ----------
    src, dst : (N, 2) raw px
    camera_src, camera_dst : of the two views
    """

    codimension = 2

    def __init__(self, src: ArrayLike, dst: ArrayLike, camera_src: Camera, camera_dst: Camera) -> None:
        require_type(camera_src, Camera, "camera_src")
        require_type(camera_dst, Camera, "camera_dst")
        src, self.dst = as_points(src, "src"), as_points(dst, "dst")
        if len(src) != len(self.dst):
            raise ShapeError(f"dst: {len(self.dst)} points; need {len(src)}, one for each of src")
        if len(src) < _FEWEST_POINTS:
            raise TooFewPoints(f"src, dst: {len(src)} points; need at least {_FEWEST_POINTS}")
        self._camera = camera_dst
        self.rays_src, valid_src = _rays(src, camera_src)
        rays_dst, valid_dst = _rays(self.dst, camera_dst)
        self._directions = DirectionsModel(self.rays_src, rays_dst)
        self._valid = valid_src & valid_dst

    @property
    def count(self) -> int:
        """Number of correspondences."""
        return len(self.dst)

    @property
    def sample_size(self) -> int:
        """Two directions determine a rotation."""
        return _FEWEST_POINTS

    def generate(self, samples: Indices) -> Floats:
        """Return the rotations, (B', 3, 3), of samples (B, 2)."""
        return self._directions.generate(samples[self._valid[samples].all(axis=1)])

    def squared_errors(self, hypotheses: Floats) -> Floats:
        """Return the squared errors (B, N) in px of the second view; inf for directions behind it."""
        turned = np.einsum("bij,nj->bni", hypotheses, self.rays_src)
        ahead = (turned[:, :, 2] > 1e-3) & self._valid
        squared = np.full(ahead.shape, np.inf)
        if ahead.any():
            measured = np.broadcast_to(self.dst, (len(hypotheses), *self.dst.shape))[ahead]
            try:
                squared[ahead] = np.minimum(((self._camera.project(turned[ahead]) - measured) ** 2).sum(axis=1), 1e30)
            except ShapeError:  # far off the axis the lens model overflows
                if len(hypotheses) == 1:
                    return np.full(ahead.shape, np.inf)
                return np.concatenate([self.squared_errors(hypothesis[None]) for hypothesis in hypotheses])
        return squared

    def shares(self, threshold: float) -> Floats:
        """Return what each correspondence counts, (N,): 1 / number of those within the threshold in dst."""
        return shares_of_places(self.dst, threshold)

    def agreement_probability(self, hypothesis: Floats, threshold: float) -> float:
        """Return the probability that a wrong correspondence agrees, told by wrong pairs of these points."""
        turned = self.rays_src @ hypothesis.T
        ahead = (turned[:, 2] > 1e-3) & self._valid
        try:
            seen = np.clip(self._camera.project(turned[ahead]), -_LARGEST, _LARGEST)
        except ShapeError:
            return 1.0
        return float(ahead.mean()) * pair_probability(seen, self.dst[ahead], threshold)

    def refit(self, hypothesis: Floats, inliers: Mask) -> Floats:
        """Return the rotation that best turns the inliers' directions."""
        return self._directions.refit(hypothesis, inliers)


class _RotationProblem:
    """Residuals projected - measured, (N, 2) px; the estimate is R, moved to Exp(r) R."""

    def __init__(self, rays: Floats, pixels: Points, camera: Camera) -> None:
        self._rays = rays
        self._pixels = pixels
        self._camera = camera

    def linearise(self, estimate: Floats) -> Linearisation:
        """Return residuals and their derivative by r."""
        turned = self._rays @ estimate.T
        if not turned[:, 2].min() > 0:
            raise DegenerateConfiguration("R: a direction lies behind the second view; need all in front")
        try:
            projected, by_ray = self._camera.project_with_jacobian(turned)
        except ShapeError as error:
            raise DegenerateConfiguration(f"R: {error}") from None
        x, y, z = turned.T
        zero = np.zeros_like(x)
        by_r = np.stack((zero, z, -y, -z, zero, x, y, -x, zero), axis=1).reshape(-1, 3, 3)  # -[v]x
        return Linearisation(projected - self._pixels, by_ray @ by_r)

    def step(self, estimate: Floats, delta: Floats) -> Floats:
        """Return Exp(delta) R."""
        return exp_so3(delta / max(1.0, float(np.abs(delta).max()))) @ estimate


def _rays(pixels: Points, camera: Camera) -> tuple[Floats, Mask]:
    normalized, valid = camera.undistort(pixels)
    if len(normalized) and np.abs(normalized).max() > 1e100:
        raise ShapeError("src, dst: overflow; need px of a picture")
    rays = np.column_stack((normalized, np.ones(len(normalized))))
    return rays / np.linalg.norm(rays, axis=1, keepdims=True), valid
