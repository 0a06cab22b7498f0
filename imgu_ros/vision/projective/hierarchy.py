# SPDX-License-Identifier: Apache-2.0
"""The hierarchy of plane transformations: which class a matrix belongs to, and what each class preserves."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_number
from imgu_ros.errors import ShapeError
from imgu_ros.types import Choice, Matrix3, as_matrix
from imgu_ros.vision.projective.transformations import require_regular


class Transformation(Choice):
    """Classes of plane transformations, special before general (IU 6.2, 6.4; HZ section 2.4)."""

    IDENTITY = "identity"
    TRANSLATION = "translation"
    ROTATION = "rotation"  # about the origin
    EUCLIDEAN = "euclidean"
    UNIFORM_SCALE = "uniform_scale"
    SIMILARITY = "similarity"
    SHEAR = "shear"  # along one axis
    NONUNIFORM_SCALE = "nonuniform_scale"
    AFFINE = "affine"
    PROJECTIVE = "projective"

    @property
    def invariants(self) -> frozenset[Invariant]:
        """What every transformation of the class leaves as it is (IU 6.1.1 to 6.4.5; HZ table 2.1)."""
        return _INVARIANTS[self]


class Invariant(Choice):
    """Properties of figures that transformations may preserve."""

    CONNECTIVITY = "connectivity"  # neighbours stay neighbours, off the vanishing line
    COLLINEARITY = "collinearity"  # and incidence
    CROSS_RATIO = "cross_ratio"  # of four points on a line
    PARALLELISM = "parallelism"
    LENGTH_RATIO_ON_LINE = "length_ratio_on_line"  # and on parallel lines
    AREA_RATIO = "area_ratio"
    LINE_AT_INFINITY = "line_at_infinity"  # as a whole
    ANGLE = "angle"  # between lines
    LENGTH_RATIO = "length_ratio"  # of any two segments
    LENGTH = "length"
    AREA = "area"
    AXIS_ANGLE = "axis_angle"  # between lines and the coordinate axes: directions
    POSITION = "position"


def classify(H: ArrayLike, tolerance: float = 1e-9, extent: float = 1.0) -> Transformation:
    """Return the most special class that a homography belongs to.

    A mirror image is no motion of the plane: the most special class of diag(-1, 1) is the non-uniform scale, and of a
    mirrored rotation affine.

    Parameters
    ----------
    H : (3, 3), of any scale
    tolerance : how far a point of the square [-extent, extent]^2 may be moved off where the class would put it, as a
        share of the extent of its image
    extent : size of the region in which the points lie, px; it makes the elements of H comparable with each other

    Raises
    ------
    DegenerateConfiguration
        If H is singular.

    Examples
    --------
    >>> str(classify([[0, -2, 7], [2, 0, 1], [0, 0, 1]]))
    'similarity'
    >>> str(classify([[1, 0, 0], [0, 1, 0], [1e-7, 0, 1]], tolerance=1e-3, extent=1000))
    'identity'
    """
    tolerance = as_number(tolerance, "tolerance")
    extent = as_number(extent, "extent")
    H = as_matrix(H, (3, 3), "H")
    require_regular(H, 3, "H")
    for name, value in (("tolerance", tolerance), ("extent", extent)):
        if not 0 < value < math.inf:
            raise ShapeError(f"{name}: {value}; need more than 0")
    G = _in_units(H, extent)
    if G is None or np.abs(G[2, :2]).max() > tolerance:
        return Transformation.PROJECTIVE
    near = tolerance * float(np.linalg.norm(G[:2, :2])) / math.sqrt(2)
    if np.abs(G[:2, 2]).max() <= near:
        return _linear_class(G[:2, :2], near)
    kind = _linear_class(G[:2, :2], near)
    return _MOVED[kind]


def _in_units(H: Matrix3, extent: float) -> Matrix3 | None:
    """Return H with the extent as unit of length and h33 = 1; None where h33 vanishes beside the others."""
    scale = np.array([1.0, 1.0, extent])
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        G: Matrix3 = H / np.abs(H).max() * scale[:, None] / scale[None, :]
        G = G / G[2, 2]
    return G if np.isfinite(G).all() else None


def _linear_class(A: Matrix3, near: float) -> Transformation:
    (a, b), (c, d) = A.tolist()
    cosine, sine = (a + d) / 2, (c - b) / 2
    scale = math.hypot(cosine, sine)
    if max(abs(a - d), abs(b + c)) <= 2 * near:
        unscaled, unturned = abs(scale - 1) <= near, abs(sine) <= near and cosine > 0
        if unscaled:
            return Transformation.IDENTITY if unturned else Transformation.ROTATION
        return Transformation.UNIFORM_SCALE if unturned else Transformation.SIMILARITY
    if max(abs(a - 1), abs(d - 1), min(abs(b), abs(c))) <= near:
        return Transformation.SHEAR
    if max(abs(b), abs(c)) <= near:
        return Transformation.NONUNIFORM_SCALE
    return Transformation.AFFINE


#: What a linear class becomes with a translation.
_MOVED = {
    Transformation.IDENTITY: Transformation.TRANSLATION,
    Transformation.ROTATION: Transformation.EUCLIDEAN,
    Transformation.UNIFORM_SCALE: Transformation.SIMILARITY,
    Transformation.SIMILARITY: Transformation.SIMILARITY,
    Transformation.SHEAR: Transformation.AFFINE,
    Transformation.NONUNIFORM_SCALE: Transformation.AFFINE,
    Transformation.AFFINE: Transformation.AFFINE,
}

_OF_PROJECTIVE = frozenset({Invariant.CONNECTIVITY, Invariant.COLLINEARITY, Invariant.CROSS_RATIO})
_OF_AFFINE = _OF_PROJECTIVE | {
    Invariant.PARALLELISM,
    Invariant.LENGTH_RATIO_ON_LINE,
    Invariant.AREA_RATIO,
    Invariant.LINE_AT_INFINITY,
}
_OF_SIMILARITY = _OF_AFFINE | {Invariant.ANGLE, Invariant.LENGTH_RATIO}
_OF_EUCLIDEAN = _OF_SIMILARITY | {Invariant.LENGTH, Invariant.AREA}
_INVARIANTS = {
    Transformation.IDENTITY: frozenset(Invariant),
    Transformation.TRANSLATION: _OF_EUCLIDEAN | {Invariant.AXIS_ANGLE},
    Transformation.ROTATION: _OF_EUCLIDEAN,
    Transformation.EUCLIDEAN: _OF_EUCLIDEAN,
    Transformation.UNIFORM_SCALE: _OF_SIMILARITY | {Invariant.AXIS_ANGLE},
    Transformation.SIMILARITY: _OF_SIMILARITY,
    Transformation.SHEAR: _OF_AFFINE | {Invariant.AREA},
    Transformation.NONUNIFORM_SCALE: _OF_AFFINE,
    Transformation.AFFINE: _OF_AFFINE,
    Transformation.PROJECTIVE: _OF_PROJECTIVE,
}
