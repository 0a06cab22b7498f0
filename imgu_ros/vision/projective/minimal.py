"""Homographies from four points, many at once, as a model for `ransac`."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_flag
from imgu_ros.errors import DegenerateConfiguration, ShapeError, TooFewPoints
from imgu_ros.types import Floats, Indices, Mask, as_points
from imgu_ros.vision.projective.dlt import design_matrix, normalisation
from imgu_ros.vision.projective.transform import normalised_homography

#: Smallest area of a triangle of sample points, in normalised units (mean distance sqrt 2): below, they are collinear.
_MIN_AREA = 1e-4
#: Nearest to the horizon, where w is 0, that a weighted fit looks.
_MIN_DEPTH = 1e-3
#: Of a homography of unit norm between normalised points.
_MIN_DETERMINANT = 1e-12

#: Of the components 0 1 2, the next and the one after it, in a circle.
_NEXT, _LAST = [1, 2, 0], [2, 0, 1]


class HomographyModel:
    """Correspondences src -> dst under `WeightedModel`.

    Hypotheses map normalised points to normalised points; `denormalised` brings one back.

    Parameters
    ----------
    src, dst : (N, 2)
    symmetric : the error is the root mean square of the distance in dst and that in src, the latter times the ratio
        of the sizes of both sets of points; False: the distance in dst. Where a plane is seen so obliquely that
        much of it falls on a few pixels, those hide wrong matches from a distance in dst alone.

    Raises
    ------
    DegenerateConfiguration
        If all points of one side coincide.
    ShapeError
        If the points are not as many, or too large.
    """

    sample_size = 4

    def __init__(self, src: ArrayLike, dst: ArrayLike, symmetric: bool = False) -> None:
        symmetric = as_flag(symmetric, "symmetric")
        src, dst = as_points(src, "src"), as_points(dst, "dst")
        if len(src) != len(dst):
            raise ShapeError(f"dst: {len(dst)} points; need {len(src)}, one for each of src")
        self._T_src, self._T_dst = normalisation(src), normalisation(dst)
        self._src = src @ self._T_src[:2, :2].T + self._T_src[:2, 2]
        self._dst = dst @ self._T_dst[:2, :2].T + self._T_dst[:2, 2]
        self._unit = float(self._T_dst[0, 0])
        self._symmetric = symmetric
        self._src_columns, self._dst_columns = (np.vstack((p.T, np.ones(len(p)))) for p in (self._src, self._dst))

    @property
    def count(self) -> int:
        """Number of correspondences."""
        return len(self._src)

    def generate(self, samples: Indices) -> Floats:
        """Return (B', 3, 3) homographies of the samples (B, 4) that a plane seen from its front can give.

        Each side's basis maps the four canonical points to the sample: H = M_dst M_src^-1 (HZ section 4.9.2 idea of
        a projective basis). Samples with three collinear points, or whose triangles change their sense of rotation,
        give none.
        """
        src, dst = self._src[samples], self._dst[samples]
        area_src, area_dst = _triangle_areas(src), _triangle_areas(dst)
        good = ((area_src * area_dst > 0) & (np.abs(area_src) > _MIN_AREA) & (np.abs(area_dst) > _MIN_AREA)).all(axis=1)
        H = _bases(dst[good], area_dst[good]) @ np.linalg.inv(_bases(src[good], area_src[good]))
        sign = np.sign(np.linalg.det(H))
        return np.asarray(H * (sign / np.linalg.norm(H, axis=(1, 2)))[:, None, None], np.float64)

    def squared_errors(self, hypotheses: Floats) -> Floats:
        """Return the squared errors, (B, N), in the caller's pixels of dst; inf behind the plane's horizon."""
        errors = _squared_distances(hypotheses, self._src_columns, self._dst)
        if self._symmetric:
            errors += _squared_distances(_adjugates(hypotheses), self._dst_columns, self._src)
            errors /= 2
        errors /= self._unit**2
        return errors

    def refit(self, hypothesis: Floats, inliers: Mask) -> Floats:
        """Return the linear fit to the inliers."""
        if np.count_nonzero(inliers) < self.sample_size:
            raise TooFewPoints(f"inliers: {np.count_nonzero(inliers)}; need at least {self.sample_size}")
        # By normal equations, a fifth of the time of the singular value decomposition of all equations.
        (H,) = self.refit_weighted(hypothesis[None], inliers[None].astype(np.float64))
        if not np.linalg.det(H) > _MIN_DETERMINANT:
            raise DegenerateConfiguration("inliers: they give a singular homography; need points that span the plane")
        return np.asarray(H, np.float64)

    def refit_weighted(self, hypotheses: Floats, weights: Floats) -> Floats:
        """Return the linear fits (B, 3, 3) with weights (B, N).

        Divided by the hypothesis's depth, the algebraic error is the distance in dst (HZ section 4.2.3).
        """
        depth = np.maximum(hypotheses[:, 2] @ self._src_columns, _MIN_DEPTH)
        normal = ((weights / depth**2) @ self._moments).reshape(-1, 9, 9)
        _, vectors = np.linalg.eigh(normal)
        H = vectors[:, :, 0].reshape(-1, 3, 3)
        return H * np.where(np.linalg.det(H) < 0, -1.0, 1.0)[:, None, None]

    def denormalised(self, hypothesis: Floats) -> Floats:
        """Return the homography between the caller's points, unit Frobenius norm."""
        return normalised_homography(np.linalg.solve(self._T_dst, hypothesis @ self._T_src))

    @cached_property
    def _moments(self) -> Floats:
        """A^T A of each correspondence's two equations, (N, 81)."""
        A = design_matrix(self._src, self._dst)
        return np.asarray((np.swapaxes(A, 1, 2) @ A).reshape(-1, 81), np.float64)


def _squared_distances(H: Floats, columns: Floats, target: Floats) -> Floats:
    """Return the squared distances (B, N) of the mapped columns (3, N) from the target (N, 2); inf where w <= 0."""
    count = len(H)
    mapped = (H.transpose(1, 0, 2).reshape(-1, 3) @ columns).reshape(3, count, -1)
    x, y, w = mapped
    behind = w <= 1e-9
    w[behind] = 1.0
    x /= w
    y /= w
    x -= target[:, 0]
    y -= target[:, 1]
    x *= x
    y *= y
    x += y
    x[behind] = np.inf
    return x


def _adjugates(H: Floats) -> Floats:
    """Return the inverses (B, 3, 3) up to positive scale, for det H > 0, without a division."""
    a, b, c = H[:, :, 0], H[:, :, 1], H[:, :, 2]
    adjugate = np.stack((_cross(b, c), _cross(c, a), _cross(a, b)), axis=1)
    norm = np.linalg.norm(adjugate, axis=(1, 2), keepdims=True)
    return np.asarray(adjugate / np.where(norm > 0, norm, 1.0), np.float64)


def _cross(a: Floats, b: Floats) -> Floats:
    """Return the cross products of rows (B, 3); numpy's own costs five times as much for a few rows."""
    return a[:, _NEXT] * b[:, _LAST] - a[:, _LAST] * b[:, _NEXT]


def _triangle_areas(quads: Floats) -> Floats:
    """Return twice the signed areas of triangles (123, 203, 013, 012) of (B, 4, 2) quads: (B, 4)."""
    x, y = quads[..., 0], quads[..., 1]

    def area(a: int, b: int, c: int) -> Floats:
        return np.asarray((x[:, b] - x[:, a]) * (y[:, c] - y[:, a]) - (x[:, c] - x[:, a]) * (y[:, b] - y[:, a]))

    return np.column_stack((area(1, 2, 3), area(2, 0, 3), area(0, 1, 3), area(0, 1, 2)))


def _bases(quads: Floats, areas: Floats) -> Floats:
    """Return the matrices [l1 p1, l2 p2, l3 p3] with l1 p1 + l2 p2 + l3 p3 = p4, by Cramer's rule: (B, 3, 3)."""
    columns = np.ones((len(quads), 3, 3))
    columns[:, :2, :] = np.swapaxes(quads[:, :3], 1, 2)
    return columns * (areas[:, :3] / areas[:, 3:])[:, None, :]
