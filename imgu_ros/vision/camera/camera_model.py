"""A camera matrix from correspondences of which some are wrong: RANSAC over samples of six (notes 7.5, 8.1.5)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import ShapeError, TooFewPoints
from imgu_ros.types import Floats, Indices, Mask, as_points, as_rows
from imgu_ros.vision.camera.resection import (
    FEWEST_POINTS,
    ProjectionEstimate,
    design_matrix,
    fit_projection,
    projection_dlt,
)
from imgu_ros.vision.estimation.ransac import ransac
from imgu_ros.vision.estimation.sampling import Sampler

_RANK_TOLERANCE = 1e-6
_LARGEST = 1e100


def estimate_projection(
    world: ArrayLike,
    pixels: ArrayLike,
    rng: np.random.Generator,
    *,
    threshold_px: float = 3.0,
    sampler: Sampler | str = Sampler.UNIFORM,
    confidence: float = 0.9999,
    max_iterations: int = 5000,
) -> ProjectionEstimate:
    """Estimate P with pixels ~ P world by sample consensus, then refine it on the inliers.

    Parameters
    ----------
    world : (N, 3), N >= 6, not in one plane; best first when the sampler is prosac
    pixels : (N, 2) px, without lens distortion
    rng : source of the draws
    threshold_px : largest reprojection error of an inlier
    sampler, confidence, max_iterations : see `ransac`

    Raises
    ------
    TooFewPoints
        If there are fewer than six correspondences.
    NoConsensus
        If too few correspondences agree.
    DegenerateConfiguration
        If the inliers do not determine a camera.
    """
    model = ProjectionModel(world, pixels)
    consensus = ransac(
        model,
        threshold_px,
        rng,
        sampler=sampler,
        confidence=confidence,
        max_iterations=max_iterations,
        unit=" px",
    )
    inliers = consensus.inliers
    # The refined camera may gain points, which the first one left out by a hair.
    for _ in range(2):
        estimate = fit_projection(model.world[inliers], model.pixels[inliers])
        agreeing = model.squared_errors(estimate.P[None])[0] <= threshold_px**2
        if np.array_equal(agreeing, inliers) or np.count_nonzero(agreeing) < FEWEST_POINTS:
            break
        inliers = agreeing
    return ProjectionEstimate(estimate.P, estimate.covariance, inliers, estimate.rms_px, consensus.iterations)


class ProjectionModel:
    """The model of `ransac` for camera matrices: hypotheses are (B, 3, 4), errors squared px.

    Parameters
    ----------
    world : (N, 3)
    pixels : (N, 2) px

    Attributes
    ----------
    world, pixels : as given, checked
    """

    def __init__(self, world: ArrayLike, pixels: ArrayLike) -> None:
        self.world, self.pixels = as_rows(world, 3, "world"), as_points(pixels, "pixels")
        if len(self.world) != len(self.pixels):
            raise ShapeError(f"pixels: {len(self.pixels)} points; need {len(self.world)}, one for each of world")
        if len(self.world) < FEWEST_POINTS:
            raise TooFewPoints(f"world, pixels: {len(self.world)} points; need at least {FEWEST_POINTS}")
        largest = max(float(np.abs(self.world).max()), float(np.abs(self.pixels).max()))
        if largest > _LARGEST:
            raise ShapeError(f"world, pixels: up to {largest:g}; need numbers of the size of a scene and a picture")
        self._world_unit, self._pixel_unit = _unit(self.world), _unit(self.pixels)
        self._homogeneous = np.column_stack((self.world, np.ones(len(self.world))))

    @property
    def count(self) -> int:
        """Number of correspondences."""
        return len(self.world)

    @property
    def sample_size(self) -> int:
        """Six correspondences determine a camera."""
        return FEWEST_POINTS

    def generate(self, samples: Indices) -> Floats:
        """Return the camera matrices, (B', 3, 4), of samples (B, 6); degenerate ones give none."""
        world, pixels = self._world_unit[samples], self._pixel_unit[samples]
        _, singular, vectors = np.linalg.svd(design_matrix(world, pixels))
        regular = singular[:, 10] > _RANK_TOLERANCE * singular[:, 0]
        scaled = vectors[regular, 11].reshape(-1, 3, 4)
        return np.asarray(_unit_transform(self.pixels) @ scaled @ _unit_inverse(self.world), np.float64)

    def squared_errors(self, hypotheses: Floats) -> Floats:
        """Return the squared reprojection errors (B, N); inf for points behind the camera."""
        mapped = np.einsum("bij,nj->bni", hypotheses, self._homogeneous)
        mapped *= np.where(np.linalg.det(hypotheses[:, :, :3]) < 0, -1.0, 1.0)[:, None, None]
        in_front = mapped[:, :, 2] > 0
        with np.errstate(over="ignore", invalid="ignore"):
            xy = mapped[:, :, :2] / np.where(in_front, mapped[:, :, 2], 1.0)[:, :, None]
            squared = ((xy - self.pixels) ** 2).sum(axis=2)
        return np.where(in_front & np.isfinite(squared), squared, np.inf)

    def refit(self, hypothesis: Floats, inliers: Mask) -> Floats:
        """Return the camera matrix of all inliers, by the normalised DLT."""
        del hypothesis
        return projection_dlt(self.world[inliers], self.pixels[inliers])


def _unit(points: Floats) -> Floats:
    """Return points brought to centroid 0 and unit RMS, so that one design matrix serves all samples."""
    return (points - points.mean(axis=0)) / _spread(points)


def _spread(points: Floats) -> float:
    return float(np.sqrt(((points - points.mean(axis=0)) ** 2).mean())) or 1.0


def _unit_transform(points: Floats) -> Floats:
    """Return the inverse of what `_unit` does, as a homogeneous matrix."""
    size = points.shape[1]
    T = np.eye(size + 1)
    T[:size, :size] *= _spread(points)
    T[:size, size] = points.mean(axis=0)
    return T


def _unit_inverse(points: Floats) -> Floats:
    return np.asarray(np.linalg.inv(_unit_transform(points)), np.float64)
