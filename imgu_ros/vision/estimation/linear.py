# SPDX-License-Identifier: Apache-2.0
"""Linear least squares: ordinary, weighted, total, homogeneous (IU 7.1, 7.2; HZ appendix 5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from imgu_ros.errors import DegenerateConfiguration, ShapeError, TooFewPoints
from imgu_ros.types import Floats, as_matrix

#: Singular values below this share of the largest are rounding.
_RANK_TOLERANCE = 1e-12
#: Squares of larger numbers, summed, overflow.
_LARGEST = 1e100


@dataclass(frozen=True, slots=True, eq=False)
class LinearEstimate:
    """The solution of an overdetermined linear system.

    Attributes
    ----------
    x : (P,)
    covariance : (P, P) of x
    rms : root mean square of the residuals, each in units of its standard deviation where that is given
    """

    x: Floats
    covariance: Floats
    rms: float


def least_squares(A: ArrayLike, b: ArrayLike, covariance: ArrayLike | None = None) -> LinearEstimate:
    """Minimise (A x - b)^T C^-1 (A x - b): the best linear unbiased estimate when b has errors of covariance C.

    The normal equations' solution (A^T C^-1 A)^-1 A^T C^-1 b of IU 7.2, by QR of the whitened system, which keeps
    twice the digits.

    Parameters
    ----------
    A : (N, P), N >= P
    b : (N,)
    covariance : of b's errors, (N, N), or (N,) variances when they are independent; None: equal, independent, and
        measured by the residuals (exact when N = P)

    Raises
    ------
    TooFewPoints
        If N < P.
    DegenerateConfiguration
        If the columns of A depend on each other, or the covariance is not positive definite.
    ShapeError
        If the arrays do not fit each other, or hold numbers that are not finite or too large.

    Examples
    --------
    >>> A = [[1, 0], [1, 1], [1, 2]]  # a straight line's intercept and slope
    >>> least_squares(A, [1, 3, 5]).x.round(9).tolist()
    [1.0, 2.0]
    >>> least_squares(A, [1, 3, 9], [1, 1, 1e6]).x.round(3).tolist()
    [1.0, 2.0]
    """
    A, b = _system(A, b)
    known = covariance is not None
    if covariance is not None:
        A, b = _whitened(covariance, A, b)
    # Columns of one length: unlike units must not look like dependence.
    lengths = np.linalg.norm(A, axis=0)
    if not (lengths > 0).all():
        raise DegenerateConfiguration("A: a column is zero; need every unknown to have an effect")
    Q, R = np.linalg.qr(A / lengths)
    if not np.abs(np.diag(R)).min() > _RANK_TOLERANCE * len(A):
        raise DegenerateConfiguration("A: its columns depend on each other; need equations that determine x")
    x = np.linalg.solve(R, Q.T @ b) / lengths
    residuals = A @ x - b
    inverse = np.linalg.inv(R) / lengths[:, None]
    squares = float(residuals @ residuals)
    variance = 1.0 if known else squares / max(len(A) - A.shape[1], 1)
    with np.errstate(over="ignore", under="ignore"):
        result = variance * inverse @ inverse.T
    return LinearEstimate(_plain(x, "x"), _plain(result, "covariance"), float(np.sqrt(squares / len(A))))


def total_least_squares(A: ArrayLike, b: ArrayLike) -> Floats:
    """Return x, (P,), of the nearest solvable system: errors are in A as much as in b (Golub & Van Loan 1980).

    The smallest corrections, by Frobenius norm, of [A b] that make A x = b exact, from its singular vectors.

    Parameters
    ----------
    A : (N, P), N > P
    b : (N,)

    Raises
    ------
    TooFewPoints
        If N <= P.
    DegenerateConfiguration
        If there is no unique solution, or it is at infinity (a vertical line, as y = m x + c).
    ShapeError
        As `least_squares`.

    Examples
    --------
    >>> total_least_squares([[1], [2], [3]], [2, 4, 6]).round(9).tolist()
    [2.0]
    """
    A, b = _system(A, b)
    v = homogeneous_least_squares(np.column_stack((A, b)))
    if not abs(v[-1]) > _RANK_TOLERANCE:
        raise DegenerateConfiguration("A, b: the solution is at infinity; need b to depend on A")
    return _plain(-v[:-1] / v[-1], "x")


def homogeneous_least_squares(A: ArrayLike) -> Floats:
    """Return the unit vector x, (P,), that minimises |A x|: A's last right singular vector (HZ algorithm A5.4).

    Its largest component is positive.

    Parameters
    ----------
    A : (N, P), N >= P - 1

    Raises
    ------
    TooFewPoints
        If N < P - 1.
    DegenerateConfiguration
        If several directions are equally good.
    ShapeError
        As `least_squares`.

    Examples
    --------
    >>> homogeneous_least_squares([[1, -1], [2, -2]]).round(6).tolist()
    [0.707107, 0.707107]
    """
    A = _matrix(A, "A")
    columns = A.shape[1]
    if len(A) < columns - 1:
        raise TooFewPoints(f"A: {len(A)} equations; need at least {columns - 1} for {columns} homogeneous unknowns")
    _, singular, vectors = np.linalg.svd(A / (np.abs(A).max() or 1.0), full_matrices=True)
    smallest = singular[columns - 1] if len(singular) == columns else 0.0
    if columns > 1 and not singular[columns - 2] - smallest > _RANK_TOLERANCE * singular[0]:
        raise DegenerateConfiguration("A: several solutions are equally good; need equations that determine x")
    x = vectors[columns - 1]
    return np.asarray(x * (1 if x[np.argmax(np.abs(x))] > 0 else -1), np.float64)


def shape_of(array: ArrayLike, name: str) -> tuple[int, ...]:
    """Return the shape of `array`, maybe a nested list. ShapeError, by `name`, when it is ragged or no numbers."""
    if isinstance(array, np.ndarray):
        return tuple(array.shape)
    try:
        return np.asarray(array, np.float64).shape
    except (TypeError, ValueError) as error:
        raise ShapeError(f"{name}: {' '.join(str(error).split())}; need an array of numbers") from None


def _whitened(covariance: ArrayLike, A: Floats, b: Floats) -> tuple[Floats, Floats]:
    count = len(A)
    if len(shape_of(covariance, "covariance")) == 1:
        variances = as_matrix(covariance, (count,), "covariance")
        if not (variances.min() > 1 / _LARGEST and variances.max() < _LARGEST):
            raise DegenerateConfiguration("covariance: a variance is not positive; need numbers above 0")
        sigma = np.sqrt(variances)
        return _matrix(A / sigma[:, None], "A"), b / sigma
    C = as_matrix(covariance, (count, count), "covariance")
    if not np.abs(C).max() < _LARGEST or not np.allclose(C, C.T, rtol=1e-9, atol=0):
        raise ShapeError("covariance: not symmetric, or too large; need a covariance matrix")
    try:
        factor = np.linalg.cholesky(C)
        # Whitened, they stay plain numbers unless the covariance is all but singular.
        return _matrix(np.linalg.solve(factor, A), "A"), _plain(np.linalg.solve(factor, b), "b")
    except np.linalg.LinAlgError:
        raise DegenerateConfiguration("covariance: not positive definite; need a covariance matrix") from None


def _system(A: ArrayLike, b: ArrayLike) -> tuple[Floats, Floats]:
    A = _matrix(A, "A")
    b = as_matrix(b, (len(A),), "b")
    if b.size and not np.abs(b).max() < _LARGEST:
        raise ShapeError(f"b: up to {np.abs(b).max():g}; need less than {_LARGEST:g}")
    if len(A) < A.shape[1]:
        raise TooFewPoints(f"A: {len(A)} equations; need at least {A.shape[1]}, as many as unknowns")
    return A, b


def _matrix(A: ArrayLike, name: str) -> Floats:
    shape = shape_of(A, name)
    if len(shape) != 2 or 0 in shape:
        raise ShapeError(f"{name}: shape {shape}; need (N, P), at least one row and column")
    A = as_matrix(A, shape, name)
    if not np.abs(A).max() < _LARGEST:
        raise ShapeError(f"{name}: up to {np.abs(A).max():g}; need less than {_LARGEST:g}")
    return A


def _plain(values: NDArray[np.float64], name: str) -> Floats:
    if not np.isfinite(values).all():
        raise DegenerateConfiguration(f"{name}: not finite; need a better conditioned system")
    return values
