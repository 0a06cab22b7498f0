# SPDX-License-Identifier: Apache-2.0
"""Every invariant of every class of plane transformations, and the classification of matrices."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.vision.projective.hierarchy import Invariant, Transformation, classify
from imgu_ros.vision.projective.points_and_lines import LINE_AT_INFINITY, transform_lines
from imgu_ros.vision.projective.transform import transform
from imgu_ros.vision.projective.transformations import (
    affine,
    euclidean,
    projective,
    rotation,
    scaling,
    shear_x,
    shear_y,
    similarity,
    translation,
)

T = Transformation


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _linear(rng: np.random.Generator) -> np.ndarray:
    """Regular, well conditioned, of no special class, mirrored now and then."""
    U, _, Vt = np.linalg.svd(rng.normal(size=(2, 2)))
    return U @ np.diag([rng.uniform(1.5, 2.0), _sign(rng) * rng.uniform(0.5, 0.8)]) @ Vt


#: A member of each class that is no member of a more special one.
MEMBERS: dict[Transformation, Callable[[np.random.Generator], np.ndarray]] = {
    T.IDENTITY: lambda rng: np.eye(3),
    T.TRANSLATION: lambda rng: translation(rng.uniform(1, 100, 2)),
    T.ROTATION: lambda rng: rotation(rng.uniform(0.2, 6.0)),
    T.EUCLIDEAN: lambda rng: euclidean(rng.uniform(0.2, 6.0), rng.uniform(1, 100, 2)),
    T.UNIFORM_SCALE: lambda rng: scaling(rng.uniform(1.5, 3) ** _sign(rng)),
    T.SIMILARITY: lambda rng: similarity(rng.uniform(1.5, 3), rng.uniform(0.2, 6.0), rng.uniform(-100, 100, 2)),
    T.SHEAR: lambda rng: rng.choice([shear_x, shear_y])(_sign(rng) * rng.uniform(0.3, 2)),  # type: ignore[operator]
    T.NONUNIFORM_SCALE: lambda rng: scaling(_sign(rng) * rng.uniform(1.5, 3), _sign(rng) * rng.uniform(0.3, 0.8)),
    T.AFFINE: lambda rng: affine(_linear(rng), rng.uniform(-100, 100, 2)),
    # The vanishing line passes the square [-1, 1]^2 of the figures by.
    T.PROJECTIVE: lambda rng: projective(_linear(rng), rng.uniform(-1, 1, 2), rng.uniform(0.15, 0.4, 2)),
}

seeds = st.integers(0, 2**32 - 1)


def _lengths(points: np.ndarray) -> np.ndarray:
    return np.array([np.hypot(*(a - b)) for a, b in itertools.combinations(points, 2)])


def _area(triangle: np.ndarray) -> float:
    (ax, ay), (bx, by) = triangle[1] - triangle[0], triangle[2] - triangle[0]
    return abs(ax * by - ay * bx) / 2


def _slope(a: np.ndarray, b: np.ndarray) -> float:
    """Direction of the line through two points, 0 to pi."""
    return float(np.arctan2(*(b - a)[::-1])) % np.pi


def _between(a: float, b: float) -> float:
    """Angle between lines of two directions, 0 to pi / 2."""
    return min((a - b) % np.pi, (b - a) % np.pi)


def _on_a_line(rng: np.random.Generator) -> np.ndarray:
    a, b = rng.uniform(-1, 1, (2, 2))
    return a + np.sort(rng.permutation(8)[:4] / 7 + 0.01 * rng.uniform(size=4))[:, None] * (b - a)


# Each check draws a figure and returns how far the property of its image is off, in units in which 1 is large.
def _connectivity(H: np.ndarray, rng: np.random.Generator) -> float:
    a, b = rng.uniform(-1, 1, (2, 2))
    coarse, fine = (
        np.hypot(*np.diff(transform(H, a + np.linspace(0, 1, n)[:, None] * (b - a)), axis=0).T).max()
        for n in (200, 2000)
    )
    return 0.0 if fine <= 0.2 * coarse or coarse < 1e-9 else 1.0  # a tear would keep its width


def _collinearity(H: np.ndarray, rng: np.random.Generator) -> float:
    points = transform(H, _on_a_line(rng))
    singular = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return float(singular[1] / singular[0])


def _cross_ratio(H: np.ndarray, rng: np.random.Generator) -> float:
    def of(points: np.ndarray) -> float:
        s = (points - points[0]) @ (points[3] - points[0])
        return (s[2] - s[0]) * (s[3] - s[1]) / ((s[2] - s[1]) * (s[3] - s[0]))  # type: ignore[no-any-return]

    points = _on_a_line(rng)
    return abs(of(transform(H, points)) / of(points) - 1)


def _parallelism(H: np.ndarray, rng: np.random.Generator) -> float:
    a, b, step = rng.uniform(-0.5, 0.5, (3, 2))
    p, q, r, s = transform(H, np.array([a, a + step, b, b - 0.7 * step]))
    return _between(_slope(p, q), _slope(r, s))


def _length_ratio_on_line(H: np.ndarray, rng: np.random.Generator) -> float:
    a, b, step = rng.uniform(-0.5, 0.5, (3, 2))
    p, q, r, s = transform(H, np.array([a, a + step, b, b - 0.7 * step]))
    return abs(np.hypot(*(s - r)) / np.hypot(*(q - p)) - 0.7)


def _area_ratio(H: np.ndarray, rng: np.random.Generator) -> float:
    one, other = (rng.uniform(-1, 1, (3, 2)) + 0.01 * np.array([[0, 0], [1, 0], [0, 1]]) for _ in range(2))
    ratio = _area(one) / _area(other)
    return abs(_area(transform(H, one)) / _area(transform(H, other)) / ratio - 1)


def _line_at_infinity(H: np.ndarray, rng: np.random.Generator) -> float:
    return float(np.abs(transform_lines(H, [LINE_AT_INFINITY]) - LINE_AT_INFINITY).max())


def _angle(H: np.ndarray, rng: np.random.Generator) -> float:
    points = rng.uniform(-1, 1, (4, 2))

    def of(p: np.ndarray) -> float:
        return _between(_slope(p[0], p[1]), _slope(p[2], p[3]))

    return abs(of(transform(H, points)) - of(points))


def _length_ratio(H: np.ndarray, rng: np.random.Generator) -> float:
    points = rng.uniform(-1, 1, (3, 2))
    before, after = _lengths(points), _lengths(transform(H, points))
    return float(np.abs(after / after.sum() - before / before.sum()).max())


def _length(H: np.ndarray, rng: np.random.Generator) -> float:
    points = rng.uniform(-1, 1, (3, 2))
    return float(np.abs(_lengths(transform(H, points)) / _lengths(points) - 1).max())


def _area_itself(H: np.ndarray, rng: np.random.Generator) -> float:
    points = rng.uniform(-1, 1, (3, 2))
    return abs(_area(transform(H, points)) / _area(points) - 1)


def _axis_angle(H: np.ndarray, rng: np.random.Generator) -> float:
    points = rng.uniform(-1, 1, (2, 2))
    return _between(_slope(*transform(H, points)), _slope(*points))


def _position(H: np.ndarray, rng: np.random.Generator) -> float:
    points = rng.uniform(-1, 1, (2, 2))
    return float(np.abs(transform(H, points) - points).max())


CHECKS: dict[Invariant, Callable[[np.ndarray, np.random.Generator], float]] = {
    Invariant.CONNECTIVITY: _connectivity,
    Invariant.COLLINEARITY: _collinearity,
    Invariant.CROSS_RATIO: _cross_ratio,
    Invariant.PARALLELISM: _parallelism,
    Invariant.LENGTH_RATIO_ON_LINE: _length_ratio_on_line,
    Invariant.AREA_RATIO: _area_ratio,
    Invariant.LINE_AT_INFINITY: _line_at_infinity,
    Invariant.ANGLE: _angle,
    Invariant.LENGTH_RATIO: _length_ratio,
    Invariant.LENGTH: _length,
    Invariant.AREA: _area_itself,
    Invariant.AXIS_ANGLE: _axis_angle,
    Invariant.POSITION: _position,
}


def test_every_class_and_invariant_is_checked() -> None:
    assert set(MEMBERS) == set(Transformation)
    assert set(CHECKS) == set(Invariant)


@pytest.mark.parametrize("kind", Transformation)
@given(seed=seeds)
def test_what_a_class_preserves(kind: Transformation, seed: int) -> None:
    rng = np.random.default_rng(seed)
    H = MEMBERS[kind](rng)
    for invariant in kind.invariants:
        assert CHECKS[invariant](H, rng) < 1e-6, invariant


@pytest.mark.parametrize("kind", Transformation)
def test_what_a_class_does_not_preserve(kind: Transformation) -> None:
    rng = np.random.default_rng(1)
    for invariant in set(Invariant) - kind.invariants:
        broken = [CHECKS[invariant](MEMBERS[kind](rng), rng) > 1e-3 for _ in range(20)]
        assert np.mean(broken) > 0.7, invariant


#: The lists of the notes, 6.2.1 to 6.4.5: what is preserved, what is not.
NOTES = {
    T.TRANSLATION: ("connectivity collinearity length angle axis_angle area", "position"),
    T.ROTATION: ("length angle area", "position axis_angle"),
    T.SIMILARITY: ("length_ratio angle", "length axis_angle"),
    T.AFFINE: ("length_ratio_on_line parallelism area_ratio line_at_infinity", "length area position angle"),
    T.PROJECTIVE: ("connectivity collinearity cross_ratio", "angle parallelism area area_ratio line_at_infinity"),
}


@pytest.mark.parametrize("kind", NOTES)
def test_the_lists_of_the_notes(kind: Transformation) -> None:
    kept, lost = (frozenset(Invariant(name) for name in names.split()) for names in NOTES[kind])
    assert kept <= kind.invariants
    assert not lost & kind.invariants


@pytest.mark.parametrize(
    ("special", "general"),
    [
        (T.IDENTITY, T.TRANSLATION), (T.IDENTITY, T.UNIFORM_SCALE), (T.IDENTITY, T.SHEAR), (T.TRANSLATION, T.EUCLIDEAN),
        (T.ROTATION, T.EUCLIDEAN), (T.EUCLIDEAN, T.SIMILARITY), (T.UNIFORM_SCALE, T.SIMILARITY),
        (T.UNIFORM_SCALE, T.NONUNIFORM_SCALE), (T.SIMILARITY, T.AFFINE), (T.SHEAR, T.AFFINE),
        (T.NONUNIFORM_SCALE, T.AFFINE), (T.AFFINE, T.PROJECTIVE),
    ],
)  # fmt: skip
def test_a_more_special_class_preserves_more(special: Transformation, general: Transformation) -> None:
    assert special.invariants >= general.invariants


@pytest.mark.parametrize("kind", Transformation)
@given(seed=seeds, factor=st.sampled_from([1.0, -3.0, 1e-8, 1e12]))
def test_a_member_is_classified(kind: Transformation, seed: int, factor: float) -> None:
    H = MEMBERS[kind](np.random.default_rng(seed))
    assert classify(factor * H) is kind
    # In metres instead of millimetres: the same class.
    unit = np.diag([1e-3, 1e-3, 1.0])
    assert classify(unit @ H @ np.linalg.inv(unit), extent=1e-3) is kind


@pytest.mark.parametrize("kind", Transformation)
@given(seed=seeds)
def test_noise_below_the_tolerance_does_not_matter(kind: Transformation, seed: int) -> None:
    rng = np.random.default_rng(seed)
    H = MEMBERS[kind](rng)
    noisy = H + 1e-7 * np.abs(H).max() * rng.uniform(-1, 1, (3, 3))
    assert classify(noisy, tolerance=1e-3) is kind
    if kind is not T.PROJECTIVE:
        assert classify(noisy, tolerance=1e-12) is T.PROJECTIVE


def test_the_extent_says_what_a_small_last_row_does() -> None:
    H = np.array([[1, 0, 0], [0, 1, 0], [1e-5, 0, 1.0]])
    assert classify(H, tolerance=1e-3) is T.IDENTITY  # about the origin
    assert classify(H, tolerance=1e-3, extent=1000) is T.PROJECTIVE


@pytest.mark.parametrize(
    ("H", "kind"),
    [
        (np.diag([-1.0, 1, 1]), T.NONUNIFORM_SCALE),
        (np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]]), T.AFFINE),
        (np.diag([-1.0, -1, 1]), T.ROTATION),
        (np.array([[1.0, 0, 0], [0, 1, 0], [1, 0, 0]])[[2, 1, 0]] + np.diag([0, 0, 0.0]), None),
        (np.array([[0.0, 0, 1], [0, 1, 0], [1, 0, 0]]), T.PROJECTIVE),  # the origin goes to infinity
    ],
)
def test_special_cases(H: np.ndarray, kind: Transformation | None) -> None:
    if kind is None:
        with pytest.raises(DegenerateConfiguration):
            classify(H)
    else:
        assert classify(H) is kind


def test_bad_arguments() -> None:
    with pytest.raises(DegenerateConfiguration, match="singular"):
        classify(np.ones((3, 3)))
    with pytest.raises(ShapeError, match="tolerance"):
        classify(np.eye(3), tolerance=0)
    with pytest.raises(ShapeError, match="extent"):
        classify(np.eye(3), extent=-1)
