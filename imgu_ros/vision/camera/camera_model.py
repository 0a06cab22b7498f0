"""A camera matrix from correspondences of which some are wrong: RANSAC over samples of six (notes 7.5, 8.1.5)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_integer, as_number
from imgu_ros.types import Floats, Indices, Mask
from imgu_ros.vision.camera.correspondences import as_correspondences
from imgu_ros.vision.camera.resection import (
    FEWEST_POINTS,
    ProjectionEstimate,
    design_matrix,
    fit_projection,
    projection_dlt,
)
from imgu_ros.vision.estimation.ransac import ransac
from imgu_ros.vision.estimation.sampling import Sampler
from imgu_ros.vision.projective.dlt import normalisation

_RANK_TOLERANCE = 1e-6


def estimate_projection(
    world: ArrayLike,
    pixels: ArrayLike,
    rng: np.random.Generator | int,
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
    rng : source of the draws, or its seed
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
    threshold_px = as_number(threshold_px, "threshold_px")
    confidence = as_number(confidence, "confidence")
    max_iterations = as_integer(max_iterations, "max_iterations")
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
    else:
        estimate = fit_projection(model.world[inliers], model.pixels[inliers])
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
        self.world, self.pixels = as_correspondences(world, pixels, FEWEST_POINTS, "world")
        self._T_world, self._T_pixels = normalisation(self.world, "world"), normalisation(self.pixels, "pixels")
        # Normalised once, so that one scale serves all samples.
        self._world_unit = self.world @ self._T_world[:3, :3] + self._T_world[:3, 3]
        self._pixel_unit = self.pixels @ self._T_pixels[:2, :2] + self._T_pixels[:2, 2]
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
        return np.asarray(np.linalg.inv(self._T_pixels) @ scaled @ self._T_world, np.float64)

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
