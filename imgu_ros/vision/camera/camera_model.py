# SPDX-License-Identifier: Apache-2.0
"""A camera matrix from correspondences of which some are wrong: RANSAC over samples of six (IU 7.5, 8.1.5)."""

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
from imgu_ros.vision.estimation.chance import pair_probability, shares_of_places
from imgu_ros.vision.estimation.covariance import selection_efficiency
from imgu_ros.vision.estimation.ransac import ransac
from imgu_ros.vision.estimation.sampling import Sampler
from imgu_ros.vision.estimation.settling import InlierFit

#: Singular values below this share of the largest: the sample leaves the camera matrix undetermined.
_RANK_TOLERANCE = 1e-6
#: px, beyond which no picture reaches.
_LARGEST = 1e30


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
        If too few correspondences agree, or as many would by chance.
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
    settled = InlierFit(
        lambda mask: fit_projection(model.world[mask], model.pixels[mask]),
        lambda estimate: model.squared_errors(estimate.P[None])[0] <= threshold_px**2,
        FEWEST_POINTS + 1,
        model.count,
    ).settled(consensus.inliers)
    estimate, inliers = settled.result, settled.inliers
    count = int(np.count_nonzero(inliers))
    variance = estimate.rms_px**2 * 2 * count / (2 * count - 11)
    covariance = estimate.covariance / selection_efficiency(2 * variance, threshold_px) ** 2
    return ProjectionEstimate(estimate.P, covariance, inliers, estimate.rms_px, consensus.iterations)


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

    codimension = 2

    def __init__(self, world: ArrayLike, pixels: ArrayLike) -> None:
        self.world, self.pixels = as_correspondences(world, pixels, FEWEST_POINTS, "world")
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
        # Each in its own units, whatever lies far from it.
        world, T_world = _normalised(self.world[samples])
        pixels, T_pixels = _normalised(self.pixels[samples])
        _, singular, vectors = np.linalg.svd(design_matrix(world, pixels))
        regular = singular[:, 10] > _RANK_TOLERANCE * singular[:, 0]
        scaled = vectors[regular, 11].reshape(-1, 3, 4)
        return np.asarray(np.linalg.inv(T_pixels[regular]) @ scaled @ T_world[regular], np.float64)

    def squared_errors(self, hypotheses: Floats) -> Floats:
        """Return the squared reprojection errors (B, N); inf for points behind the camera."""
        mapped = np.einsum("bij,nj->bni", hypotheses, self._homogeneous)
        mapped *= np.where(np.linalg.det(hypotheses[:, :, :3]) < 0, -1.0, 1.0)[:, None, None]
        in_front = mapped[:, :, 2] > 0
        with np.errstate(over="ignore", invalid="ignore"):
            xy = mapped[:, :, :2] / np.where(in_front, mapped[:, :, 2], 1.0)[:, :, None]
            squared = ((xy - self.pixels) ** 2).sum(axis=2)
        return np.where(in_front & np.isfinite(squared), squared, np.inf)

    def shares(self, threshold: float) -> Floats:
        """Return what each correspondence counts, (N,): 1 / number of those whose pixels are within the threshold."""
        return shares_of_places(self.pixels, threshold)

    def agreement_probability(self, hypothesis: Floats, threshold: float) -> float:
        """Return the probability that a wrong correspondence agrees, told by wrong pairs of these points."""
        x, y, w = hypothesis @ self._homogeneous.T
        w = w * (-1.0 if np.linalg.det(hypothesis[:, :3]) < 0 else 1.0)
        in_front = w > 0
        with np.errstate(over="ignore"):
            seen = np.clip(np.column_stack((x, y))[in_front] / w[in_front, None], -_LARGEST, _LARGEST)
        return float(in_front.mean()) * pair_probability(seen, self.pixels[in_front], threshold)

    def refit(self, hypothesis: Floats, inliers: Mask) -> Floats:
        """Return the camera matrix of all inliers, by the normalised DLT."""
        del hypothesis
        return projection_dlt(self.world[inliers], self.pixels[inliers])


def _normalised(points: Floats) -> tuple[Floats, Floats]:
    """Return samples (B, M, D) about their centres, in units of their RMS distance, and the similarities that do it."""
    dimension = points.shape[2]
    centre = points.mean(axis=1)
    away = points - centre[:, None]
    unit = np.sqrt((away**2).sum(axis=2).mean(axis=1))
    unit[unit == 0] = 1.0
    T = np.tile(np.eye(dimension + 1), (len(points), 1, 1))
    T[:, :-1] /= unit[:, None, None]
    T[:, :-1, -1] = -centre / unit[:, None]
    return away / unit[:, None, None], T
