# SPDX-License-Identifier: Apache-2.0
"""What many views of planes say together about a camera's calibration, beyond what chance explains."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imgu_ros.arguments import as_sequence, require_type
from imgu_ros.errors import DegenerateConfiguration, ShapeError, TooFewPoints
from imgu_ros.types import Floats, as_matrix
from imgu_ros.vision.camera.calibration_test import FREEDOM, CalibrationTest
from imgu_ros.vision.camera.camera_covariance import covariance_factor
from imgu_ros.vision.camera.intrinsics import Camera

#: How wrong calibrations are, up to one factor: focal length, quotient of the focal lengths and principal point, each
#: as a share of the focal length. Zoom, focus and another resolution change the first, windows the last two; pixels
#: are square.
_SHAPE = np.array([1.0, 0.1, 1.0, 1.0])
#: Factors that are weighed against each other: 60 values from 0.01 % to 50 %, 15 % apart, finer than the data
#: distinguish.
_FACTORS = np.geomspace(1e-4, 0.5, 60)
#: Prior standard deviation of the robust fit, as a share of the focal length: wider than any calibration in use is
#: wrong.
_WIDE = 0.3
#: Larger residuals, in standard deviations, are no residuals of points in a plane.
_LARGEST = 1e6
#: Standard deviation of a focal length, as a share of it, of which nothing is known.
_NOTHING = 1e3
#: Twice the logarithm of the likelihood ratio beyond which a misfit is significant. Independent views reach 12 once in
#: 2000 tests, but consecutive frames share errors: `benchmarks/calibration_misfit.py --part noise`. Measured:
#: benchmarks/thresholds.py, study calibration.
_BY_CHANCE = 30.0
#: A view whose squared residual is larger (99 % of chi-squared with 2 degrees of freedom) counts for less.
_OUTLYING = 9.21
#: Median of chi-squared with 2 degrees of freedom, 2 ln 2.
_MEDIAN = 1.386
#: Poses are linear in the intrinsics up to this factor times the square of their error. Measured:
#: benchmarks/thresholds.py, study calibration.
_SECOND_ORDER = 4.0
#: Consecutive views share errors of prints and patches: the estimate is wrong by this share of the focal length,
#: however many views there are (`benchmarks/calibration_misfit.py --part focal`). Measured: benchmarks/thresholds.py,
#: study calibration.
_SHARED = 1e-3
#: Iterations of reweighting: bounds the time.
_ROUNDS = 4
#: Fewest views whose scatter tells how honest the covariances of their residuals are.
_SCATTER_VIEWS = 6


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationEvidence:
    """What some views say.

    Attributes
    ----------
    views : number of them
    chi_squared : mean of the views' squared residuals in units of their covariances: about 2 when all is right
    scatter : the same about the calibration that fits the views best, over 2: 1 when chance explains what it leaves
    focal : true over given focal length, less 1, when nothing else is wrong
    focal_sigma : its standard deviation, what was known of the calibration before included
    focal_share : of the squared residuals beyond chance, the share that this focal length explains, 0 to 1
    sigmas : by how many standard deviations the best focal lengths and principal point differ from the given ones
    largest : the largest of these differences as a share of the focal length
    covariance : (P, P) that explains the misfit, of the camera's numbers about the given ones; None when it is chance
    """

    views: int
    chi_squared: float
    scatter: float
    focal: float
    focal_sigma: float
    focal_share: float
    sigmas: float
    largest: float
    covariance: Floats | None


def weigh_calibration(tests: Sequence[CalibrationTest], camera: Camera) -> CalibrationEvidence:
    """Weigh the residuals of views that were posed with the same calibration.

    The camera's numbers, true less given, have a prior of zero mean: the covariance of the camera, and a
    miscalibration of known shape (common focal length, principal point) and unknown size (log-uniform). Residuals of
    views that contradict the best numbers count for less, and where views scatter by more than their covariances say,
    all do.

    Parameters
    ----------
    tests : of views that differ: a view that is repeated repeats its errors
    camera : with which they were made

    Raises
    ------
    TooFewPoints
        If there are none.
    ShapeError
        If a test is of another number of the camera's numbers, or not finite.
    DegenerateConfiguration
        If a residual's covariance is singular.
    """
    require_type(camera, Camera, "camera")
    tests = as_sequence(tests, "tests")
    others = set(map(type, tests)) - {CalibrationTest}
    if others:
        raise ShapeError(f"tests: {', '.join(sorted(kind.__name__ for kind in others))}; need CalibrationTest objects")
    if not tests:
        raise TooFewPoints("tests: none; need at least one")
    count = 4 + len(camera.distortion)
    # Focal lengths and principal point as shares of the focal length.
    focal = math.sqrt(camera.K[0, 0] * camera.K[1, 1])
    unit = np.ones(count)
    unit[:4] = camera.K[0, 0], camera.K[1, 1], focal, focal
    z, A = _whitened(tests, unit)
    known = covariance_factor(camera) / unit[:, None]
    main = np.zeros((count, 4))
    main[:4] = [[1, 1, 0, 0], [1, -1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    weights, scatter = _weights(z, A, np.hstack((known, main * (_WIDE * _SHAPE))))
    information = np.einsum("n,nik,nil->kl", weights, A, A)
    pull = np.einsum("n,nik,ni->k", weights, A, z)
    squares = float(np.einsum("n,ni,ni->", weights, z, z))
    # What was known before is noise that all views share.
    passed = np.linalg.solve(np.eye(count) + information @ known @ known.T, np.column_stack((information, pull)))
    U, u = main.T @ passed[:, :-1] @ main, main.T @ passed[:, -1]
    squares -= float(pull @ known @ known.T @ passed[:, -1])
    U, u, squares = (U + U.T) / 2 / scatter, u / scatter, squares / scatter
    focal_error, focal_sigma = (u[0] / U[0, 0], 1 / math.sqrt(U[0, 0])) if U[0, 0] > _NOTHING**-2 else (0.0, _NOTHING)
    explained = float(focal_error * u[0])
    beyond = max(squares - FREEDOM * float(weights.sum()) / scatter, explained, 1e-300)
    posterior = _posterior(U, u)
    covariance = None
    if posterior.is_there:
        moment = unit[:, None] * main @ posterior.moment @ main.T * unit
        covariance = (moment + moment.T) / 2
    return CalibrationEvidence(
        views=len(tests),
        chi_squared=float((z * z).sum()) / len(tests),
        scatter=scatter,
        focal=float(focal_error),
        focal_sigma=float(focal_sigma),
        focal_share=explained / beyond,
        sigmas=math.sqrt(max(posterior.explained, 0.0)),
        largest=float(np.abs(posterior.mean).max()),
        covariance=covariance,
    )


def _whitened(tests: Sequence[CalibrationTest], unit: Floats) -> tuple[Floats, Floats]:
    """Return residuals (N, 2) and derivatives (N, 2, P) by the numbers in their units, in standard deviations."""
    count = len(unit)
    covariances = np.stack([as_matrix(test.covariance, (FREEDOM, FREEDOM), "tests: covariance") for test in tests])
    residuals = np.stack([as_matrix(test.residual, (FREEDOM,), "tests: residual") for test in tests])
    by_camera = np.stack([as_matrix(test.by_camera, (FREEDOM, count), "tests: by_camera") for test in tests])
    with np.errstate(over="ignore", invalid="ignore"):
        try:
            of_noise = np.linalg.inv(np.linalg.cholesky(covariances))
        except np.linalg.LinAlgError:
            raise DegenerateConfiguration("tests: a covariance is not positive definite; need that of noise") from None
        z, A = (of_noise @ residuals[:, :, None])[:, :, 0], of_noise @ (by_camera * unit)
    # Far off the axis the last coefficients of a lens move pixels a lot: they count only where they are known.
    if not (np.abs(z).max() < _LARGEST and np.abs(A[:, :, :4]).max() < _LARGEST and np.isfinite(A).all()):
        raise ShapeError(f"tests: more than {_LARGEST:g} standard deviations; need residuals of a plane's points")
    return z, A


def _weights(z: Floats, A: Floats, prior: Floats) -> tuple[Floats, float]:
    """Return the views' weights and how much they scatter, (N,), about the numbers that fit best; `prior` a factor."""
    B = A @ prior
    weights, scatter = np.ones(len(z)), 1.0
    if len(z) < _SCATTER_VIEWS:
        return weights, scatter
    for _ in range(_ROUNDS):
        normal = np.einsum("n,nik,nil->kl", weights, B, B) + np.eye(B.shape[2])
        best = np.linalg.solve(normal, np.einsum("n,nik,ni->k", weights, B, z))
        squared = ((z - B @ best) ** 2).sum(axis=1)
        scatter = max(1.0, float(np.median(squared)) / _MEDIAN)
        weights = np.minimum(1.0, _OUTLYING * scatter / np.maximum(squared, 1e-300))
    return weights, scatter


@dataclass(frozen=True, slots=True, eq=False)
class _Posterior:
    """The miscalibration: whether it is no chance, mean (4,) and second moment (4, 4), and what a fit explains."""

    is_there: bool
    mean: Floats
    moment: Floats
    explained: float


def _posterior(information: Floats, pull: Floats) -> _Posterior:
    """Return the miscalibration, averaged over its prior's sizes by how likely they make what is seen."""
    values, vectors = np.linalg.eigh(information * np.outer(_SHAPE, _SHAPE))
    along = vectors.T @ (_SHAPE * pull)
    told = values > 1e-9 * max(float(values[-1]), 1e-300)
    values, along = np.where(told, values, 0.0), np.where(told, along, 0.0)
    squared = np.where(told, along**2 / np.where(told, values, 1.0), 0.0)
    sizes = _FACTORS[:, None] ** 2
    grown = sizes * values
    gain = (squared * grown / (1 + grown) - np.log1p(grown)).sum(axis=1)
    most = float(gain.max())
    # One view tells two numbers of four: how large the others may be is as uncertain as the size is.
    likely = np.exp((gain - most) / 2)
    likely /= likely.sum()
    back = _SHAPE[:, None] * vectors
    means = (along * sizes / (1 + grown)) @ back.T
    mean = likely @ means
    variances = likely @ (sizes / (1 + grown))
    others = math.hypot(_SECOND_ORDER * float(mean @ mean), _SHARED)
    moment = (back * variances) @ back.T + means.T @ (likely[:, None] * means) + np.diag((others * _SHAPE) ** 2)
    return _Posterior(most > _BY_CHANCE, np.asarray(mean, np.float64), moment, float(squared.sum()))
