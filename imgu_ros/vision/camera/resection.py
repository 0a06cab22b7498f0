# SPDX-License-Identifier: Apache-2.0
"""A camera matrix from points of the world and their pictures: DLT and refinement (IU 8.1.5; HZ section 7.1)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_number
from imgu_ros.errors import DegenerateConfiguration, EstimationError, ShapeError
from imgu_ros.types import Floats, Mask, Points, as_matrix
from imgu_ros.vision.camera.correspondences import as_correspondences
from imgu_ros.vision.camera.projection import depths, finite_camera
from imgu_ros.vision.estimation.covariance import propagated_covariance
from imgu_ros.vision.estimation.nonlinear import Linearisation, minimise
from imgu_ros.vision.projective.dlt import normalisation

#: Points that a camera matrix needs: 11 degrees of freedom, two equations a point.
FEWEST_POINTS = 6
#: Singular values below this share of the largest: the points leave the camera matrix undetermined.
_RANK_TOLERANCE = 1e-9
#: Smallest extent of the points across their main plane, as a share of the largest (both RMS).
_THINNEST = 1e-4
#: Squares of larger numbers, summed, overflow.
_LARGEST = 1e100


@dataclass(frozen=True, slots=True, eq=False)
class ProjectionEstimate:
    """An estimated camera matrix.

    Attributes
    ----------
    P : (3, 4), unit Frobenius norm, det P[:, :3] > 0: the third coordinate is positive for points in front
    covariance : (12, 12) of P's elements, row-major, rank 11 (nothing along P itself)
    inliers : (N,) which of the points it was estimated from agree with it
    rms_px : root mean square residual of the inliers, px (per coordinate)
    iterations : samples drawn by a robust search
    """

    P: Floats
    covariance: Floats
    inliers: Mask
    rms_px: float
    iterations: int


def fit_projection(world: ArrayLike, pixels: ArrayLike, noise_px: float | None = None) -> ProjectionEstimate:
    """Estimate P with pixels ~ P world from correspondences without outliers and without lens distortion.

    The normalised DLT, refined by Levenberg-Marquardt on the reprojection error: HZ's gold standard (algorithm 7.1).

    Parameters
    ----------
    world : (N, 3), N >= 6, not in one plane
    pixels : (N, 2) px
    noise_px : standard deviation of a pixel coordinate; None: from the residuals

    Returns
    -------
    With every point an inlier and no iterations.

    Raises
    ------
    ShapeError
        If an array has another shape or is not finite.
    TooFewPoints
        If there are fewer than six points.
    DegenerateConfiguration
        If the points do not determine a camera (coplanar, or on a twisted cubic with its centre), or some would lie
        behind it.

    Examples
    --------
    >>> from imgu_ros.vision.camera import camera_centre, project, projection_matrix
    >>> P = projection_matrix([[500, 0, 320], [0, 500, 240], [0, 0, 1]], np.eye(3), [0.1, 0.2, 3.0])
    >>> world = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0.5], [-1, 0.5, 0.7]], float)
    >>> camera_centre(fit_projection(world, project(P, world)).P).round(9).tolist()
    [-0.1, -0.2, -3.0]
    """
    noise_px = None if noise_px is None else as_number(noise_px, "noise_px")
    world, pixels = as_correspondences(world, pixels, FEWEST_POINTS, "world")
    if noise_px is not None and not 0 < noise_px < math.inf:
        raise ShapeError(f"noise_px: {noise_px}; need a positive number, or None")
    P = projection_dlt(world, pixels)
    T_world, T_pixels = normalisation(world, "world"), normalisation(pixels, "pixels")
    problem = _ReprojectionProblem(_mapped(T_world, world), _mapped(T_pixels, pixels))
    start = T_pixels @ P @ np.linalg.inv(T_world)
    minimum = minimise(problem, start / np.linalg.norm(start))
    noise = None if noise_px is None else noise_px * float(T_pixels[0, 0])
    covariance = propagated_covariance(minimum, noise)
    T_inverse = np.linalg.inv(T_pixels)
    raw = T_inverse @ minimum.estimate @ T_world
    refined = _oriented(raw, world)
    norm = math.copysign(float(np.linalg.norm(raw)), float(np.vdot(raw, refined)))
    p = refined.ravel()
    by_scaled = (np.eye(12) - np.outer(p, p)) @ np.kron(T_inverse, T_world.T) / norm
    spread = by_scaled @ _tangent_basis(minimum.estimate)
    rms = math.sqrt(float((minimum.linearisation.residuals**2).mean())) / float(T_pixels[0, 0])
    return ProjectionEstimate(refined, spread @ covariance @ spread.T, np.ones(len(world), bool), rms, 0)


def projection_dlt(world: ArrayLike, pixels: ArrayLike) -> Floats:
    """Return P with pixels ~ P world that minimises the algebraic error of normalised points.

    Parameters and errors are those of `fit_projection`.

    Returns
    -------
    (3, 4) of unit Frobenius norm, det P[:, :3] > 0
    """
    world, pixels = as_correspondences(world, pixels, FEWEST_POINTS, "world")
    singular = np.linalg.svd(world - world.mean(axis=0), compute_uv=False)
    if not singular[2] > _THINNEST * singular[0]:
        raise DegenerateConfiguration(
            f"world: {len(world)} points in a plane (thickness / length {singular[2] / (singular[0] or 1.0):.2g}); "
            f"need more than {_THINNEST}"
        )
    T_world, T_pixels = normalisation(world, "world"), normalisation(pixels, "pixels")
    A = design_matrix(_mapped(T_world, world), _mapped(T_pixels, pixels))
    _, singular, vectors = np.linalg.svd(A, full_matrices=True)
    if not singular[10] > _RANK_TOLERANCE * singular[0]:
        raise DegenerateConfiguration(
            f"world, pixels: the {len(world)} correspondences do not determine a camera; need six in general position"
        )
    return _oriented(np.linalg.solve(T_pixels, vectors[11].reshape(3, 4) @ T_world), world)


def design_matrix(world: Floats, pixels: Points) -> Floats:
    """Return A of the DLT's A p = 0, p the elements of P row by row (HZ equation 7.2).

    Parameters
    ----------
    world : (..., N, 3)
    pixels : (..., N, 2)

    Returns
    -------
    (..., 2 N, 12)
    """
    shapes = [np.shape(array) if isinstance(array, np.ndarray) else () for array in (world, pixels)]
    if len(shapes[0]) < 2 or shapes[0][:-1] != shapes[1][:-1] or shapes[0][-1] != 3 or shapes[1][-1] != 2:
        raise ShapeError(f"world, pixels: shapes {shapes[0]}, {shapes[1]}; need (..., N, 3) and (..., N, 2)")
    world, pixels = as_matrix(world, shapes[0], "world"), as_matrix(pixels, shapes[1], "pixels")
    if max(np.abs(world).max(initial=0), np.abs(pixels).max(initial=0)) > _LARGEST:
        raise ShapeError("world, pixels: overflow; need numbers of the size of a scene and a picture")
    X = np.concatenate((world, np.ones_like(world[..., :1])), axis=-1)
    A = np.zeros((*world.shape[:-1], 2, 12))
    A[..., 0, 4:8] = -X
    A[..., 0, 8:12] = pixels[..., 1:] * X
    A[..., 1, 0:4] = X
    A[..., 1, 8:12] = -pixels[..., :1] * X
    return A.reshape(*world.shape[:-2], -1, 12)


class _ReprojectionProblem:
    """Residuals projected - measured, (N, 2); the estimate is P of unit norm, moved along its tangent space."""

    def __init__(self, world: Floats, pixels: Points) -> None:
        self._homogeneous = np.column_stack((world, np.ones(len(world))))
        self._pixels = pixels

    def linearise(self, estimate: Floats) -> Linearisation:
        """Return residuals and their derivative by a step of 11 parameters."""
        X = self._homogeneous
        mapped = X @ estimate.T
        if not np.abs(mapped[:, 2]).min() > 1e-12:
            raise DegenerateConfiguration("P: a point in the principal plane; need points in front of the camera")
        xy = mapped[:, :2] / mapped[:, 2:]
        scaled = X / mapped[:, 2:]
        by_p = np.zeros((len(X), 2, 12))
        by_p[:, 0, 0:4] = by_p[:, 1, 4:8] = scaled
        by_p[:, :, 8:12] = -xy[:, :, None] * scaled[:, None, :]
        return Linearisation(xy - self._pixels, by_p @ _tangent_basis(estimate))

    def step(self, estimate: Floats, delta: Floats) -> Floats:
        """Return P moved by `delta` and brought back to unit norm."""
        moved = estimate.ravel() + _tangent_basis(estimate) @ delta
        return np.asarray((moved / np.linalg.norm(moved)).reshape(3, 4), np.float64)


def _tangent_basis(P: Floats) -> Floats:
    """Return an orthonormal basis (12, 11) of the directions that are orthogonal to P: Householder's reflection."""
    p = P.ravel() / np.linalg.norm(P)
    v = p.copy()
    v[0] += math.copysign(1.0, p[0])
    return np.asarray((np.eye(12) - 2 * np.outer(v, v) / (v @ v))[:, 1:], np.float64)


def _mapped(T: Floats, points: Floats) -> Floats:
    return points @ T[:-1, :-1].T + T[:-1, -1]


def _oriented(P: Floats, world: Floats) -> Floats:
    """Return P at unit norm, signed so that the points are in front."""
    P = P / np.abs(P).max()
    P = P / np.linalg.norm(P)
    try:
        finite_camera(P)
        in_front = depths(P, world) > 0
    except EstimationError as error:
        raise DegenerateConfiguration(f"world, pixels: {error}") from None
    if not in_front.all():
        raise DegenerateConfiguration(
            f"world, pixels: {np.count_nonzero(~in_front)} of {len(world)} points would lie behind the camera; "
            "need correspondences without outliers"
        )
    return -P if np.linalg.det(P[:, :3]) < 0 else P
