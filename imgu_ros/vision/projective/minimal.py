# SPDX-License-Identifier: Apache-2.0
"""Homographies from four points, many at once, as a model for `ransac`."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_flag
from imgu_ros.errors import DegenerateConfiguration, ShapeError, TooFewPoints
from imgu_ros.types import Floats, Indices, Mask, Matrix3, Points, as_mask, as_matrix, as_points
from imgu_ros.vision.estimation.chance import pair_probability, shares_of_places
from imgu_ros.vision.projective.homography import Orientation

#: Smallest area of a triangle of sample points, in units of their RMS distance from their centre: below, collinear.
_MIN_AREA = 1e-3
#: Nearest to the horizon, where w is 0, that a weighted fit looks; 1 is the mean over the points.
_MIN_DEPTH = 1e-3
#: Of a homography between normalised points with w = 1 in the mean.
_MIN_DETERMINANT = 1e-12
#: Larger numbers are no places in a picture, and their squares overflow.
_LARGEST = 1e100

#: Of the components 0 1 2, the next and the one after it, in a circle.
_NEXT, _LAST = [1, 2, 0], [2, 0, 1]


class HomographyModel:
    """Correspondences src -> dst under `WeightedModel` and `ChanceModel`.

    Hypotheses map normalised points to normalised points, scaled so that w is 1 in the mean of the points that they
    come from: their determinant is then the factor by which they enlarge areas there. `denormalised` brings one back.
    No answer depends on where wrong matches lie: nothing is measured in units of their spread.

    Parameters
    ----------
    src, dst : (N, 2)
    symmetric : the error is the root mean square of the distance in dst and that in src, the latter times the
        hypothesis's magnification; False: the distance in dst. Where a plane is seen so obliquely that much of it
        falls on a few pixels, those hide wrong matches from a distance in dst alone.
    orientation : from which side the plane may be seen

    Raises
    ------
    DegenerateConfiguration
        If all points of one side coincide.
    ShapeError
        If the points are not as many, or too large.
    """

    sample_size = 4
    codimension = 2

    def __init__(
        self,
        src: ArrayLike,
        dst: ArrayLike,
        symmetric: bool = False,
        orientation: Orientation | str = Orientation.FRONT,
    ) -> None:
        symmetric = as_flag(symmetric, "symmetric")
        src, dst = as_points(src, "src"), as_points(dst, "dst")
        if len(src) != len(dst):
            raise ShapeError(f"dst: {len(dst)} points; need {len(src)}, one for each of src")
        self._T_src, self._T_dst = _median_normalisation(src, "src"), _median_normalisation(dst, "dst")
        self._src = src @ self._T_src[:2, :2].T + self._T_src[:2, 2]
        self._dst = dst @ self._T_dst[:2, :2].T + self._T_dst[:2, 2]
        self._unit = float(self._T_dst[0, 0])
        self._symmetric = symmetric
        self._orientation = Orientation(orientation)
        self._src_columns, self._dst_columns = (np.vstack((p.T, np.ones(len(p)))) for p in (self._src, self._dst))

    @property
    def count(self) -> int:
        """Number of correspondences."""
        return len(self._src)

    def generate(self, samples: Indices) -> Floats:
        """Return (B', 3, 3) homographies of the samples (B, 4) that a plane seen from the allowed side can give.

        Each side's basis maps the four canonical points to the sample: H = M_dst M_src^-1 (HZ section 4.9.2 idea of
        a projective basis). Samples with three collinear points, or whose triangles do not all keep (or all change)
        their sense of rotation, give none.
        """
        src, dst = self._src[samples], self._dst[samples]
        centre_src, centre_dst = src.mean(axis=1), dst.mean(axis=1)
        src, dst = src - centre_src[:, None], dst - centre_dst[:, None]
        unit_src, unit_dst = (np.sqrt(np.einsum("bij,bij->b", p, p) / 4) for p in (src, dst))
        with np.errstate(invalid="ignore", divide="ignore"):
            src, dst = src / unit_src[:, None, None], dst / unit_dst[:, None, None]
        area_src, area_dst = _triangle_areas(src), _triangle_areas(dst)
        # Coinciding points have no area, and their NaN is not greater.
        good = ((np.abs(area_src) > _MIN_AREA) & (np.abs(area_dst) > _MIN_AREA)).all(axis=1)
        good &= self._keeps_side(area_src * area_dst)
        ratios = area_dst[good] / area_src[good]
        forward = _bases(dst[good], area_dst[good]) * unit_dst[good, None, None]
        forward[:, 2] /= unit_dst[good, None]
        forward[:, :2] += centre_dst[good, :, None] * forward[:, 2:]
        backward = np.linalg.inv(_bases(src[good], area_src[good]))
        backward[:, :, :2] /= unit_src[good, None, None]
        backward[:, :, 2] -= np.einsum("bij,bj->bi", backward[:, :, :2], centre_src[good])
        # H maps the sample's points to w = their ratios of areas over the last one's.
        mean_w = (ratios[:, :3].sum(axis=1) / ratios[:, 3] + 1) / 4
        return np.asarray(forward @ backward / mean_w[:, None, None], np.float64)

    def squared_errors(self, hypotheses: Floats) -> Floats:
        """Return the squared errors, (B, N), in the caller's pixels of dst; inf behind the plane's horizon."""
        errors = _squared_distances(hypotheses, self._src_columns, self._dst)
        if self._symmetric:
            inverses, determinants = _adjugates(hypotheses)
            errors += _squared_distances(inverses, self._dst_columns, self._src) * determinants[:, None]
            errors /= 2
        errors /= self._unit**2
        return errors

    def refit(self, hypothesis: Floats, inliers: Mask) -> Floats:
        """Return the linear fit to the inliers."""
        if np.count_nonzero(inliers) < self.sample_size:
            raise TooFewPoints(f"inliers: {np.count_nonzero(inliers)}; need at least {self.sample_size}")
        # By normal equations, a fifth of the time of the singular value decomposition of all equations.
        fitted = self.refit_weighted(hypothesis[None], inliers[None].astype(np.float64))
        if not len(fitted):
            raise DegenerateConfiguration("inliers: they give a singular homography; need points that span the plane")
        return np.asarray(fitted[0], np.float64)

    def refit_weighted(self, hypotheses: Floats, weights: Floats) -> Floats:
        """Return the linear fits (B', 3, 3) with weights (B, N); singular ones, or seen from the other side, give none.

        Divided by the hypothesis's depth, the algebraic error is the distance in dst (HZ section 4.2.3). Each fit
        has its own centre and unit, of the points that count for it.
        """
        total = weights.sum(axis=1)
        enough = total > 0
        hypotheses, weights, total = hypotheses[enough], weights[enough], total[enough]
        depth = np.maximum(hypotheses[:, 2] @ self._src_columns, _MIN_DEPTH)
        src, centre_src, unit_src = _centred(self._src, weights, total)
        dst, centre_dst, unit_dst = _centred(self._dst, weights, total)
        H = _direct(src, dst, weights / depth**2)
        # H between the model's points: dst unit and centre, times H, times src centre and unit.
        H[:, :2] *= unit_dst[:, None, None]
        H[:, :2] += centre_dst[:, :, None] * H[:, 2:]
        H[:, :, :2] /= unit_src[:, None, None]
        H[:, :, 2] -= np.einsum("bij,bj->bi", H[:, :, :2], centre_src)
        w = np.einsum("bn,bn->b", weights, H[:, 2] @ self._src_columns) / total
        H = H[w != 0] / w[w != 0, None, None]
        determinant = np.linalg.det(H)
        return np.asarray(H[(np.abs(determinant) > _MIN_DETERMINANT) & self._keeps_side(determinant[:, None])])

    def shares(self, threshold: float) -> Floats:
        """Return what each correspondence counts, (N,): 1 / number of those within the threshold in dst."""
        return shares_of_places(self._dst, threshold * self._unit)

    def agreement_probability(self, hypothesis: Floats, threshold: float) -> float:
        """Return the probability that a wrong correspondence agrees in dst, told by wrong pairs of these points."""
        mapped = hypothesis @ self._src_columns
        ahead = mapped[2] > 0
        mapped = mapped[:2, ahead] / mapped[2, ahead]
        return float(ahead.mean()) * pair_probability(mapped.T, self._dst[ahead], threshold * self._unit)

    def denormalised(self, hypothesis: Floats) -> Matrix3:
        """Return the homography between the caller's points, unit Frobenius norm, w > 0 where hypotheses have it."""
        H = np.linalg.solve(self._T_dst, hypothesis @ self._T_src)
        return np.asarray(H / np.linalg.norm(H / np.abs(H).max()) / np.abs(H).max(), np.float64)

    def normalised(self, H: ArrayLike, inliers: Mask) -> Floats:
        """Return a homography between the caller's points as a hypothesis, (1, 3, 3), that agrees with `inliers` (N,).

        None, (0, 3, 3), where it is singular or shows the plane across the horizon or from a side not allowed.
        """
        H, inliers = as_matrix(H, (3, 3), "H"), as_mask(inliers, self.count, "inliers")
        if not inliers.any():
            return np.zeros((0, 3, 3))
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            scaled = self._T_dst @ H @ np.linalg.inv(self._T_src)
            hypothesis = scaled[None] / (scaled[2] @ self._src_columns)[inliers].mean()
            determinant = np.linalg.det(hypothesis)
        good = np.isfinite(hypothesis).all(axis=(1, 2)) & (np.abs(determinant) > _MIN_DETERMINANT)
        return np.asarray(hypothesis[good & self._keeps_side(determinant[:, None])], np.float64)

    def _keeps_side(self, determinants: Floats) -> Mask:
        """Whether all numbers (B, M) of each row have the sign of the allowed orientation, (B,)."""
        front, mirrored = (determinants > 0).all(axis=1), (determinants < 0).all(axis=1)
        if self._orientation is Orientation.FRONT:
            return np.asarray(front)
        return np.asarray(mirrored if self._orientation is Orientation.MIRRORED else front | mirrored)


def _median_normalisation(points: Points, name: str) -> Matrix3:
    """Return the similarity that moves the median to 0 and the median distance from it to 1; half may lie anywhere."""
    if len(points) and not np.abs(points).max() < _LARGEST:
        raise ShapeError(f"{name}: up to {np.abs(points).max():g}; need less than {_LARGEST:g}")
    centre = np.median(points, axis=0) if len(points) else np.zeros(2)
    distance = np.hypot(*(points - centre).T)
    apart = distance[distance > 1e-12 * np.abs(centre).max()]
    if not len(apart):
        raise DegenerateConfiguration(f"{name}: all {len(points)} coincide; need points apart")
    unit = 1 / float(np.median(apart))
    return np.array([[unit, 0, -unit * centre[0]], [0, unit, -unit * centre[1]], [0, 0, 1]])


def _centred(points: Points, weights: Floats, total: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the points (B, N, 2) about the weighted centres (B, 2), in units (B,) of their RMS distance.

    Points without weight are 0: they may lie anywhere. Where the others coincide the unit is 1.
    """
    centre = weights @ points / total[:, None]
    away = np.where((weights > 0)[:, :, None], points - centre[:, None], 0.0)
    unit = np.sqrt(np.einsum("bn,bni->b", weights, away * away) / total)
    unit[unit == 0] = 1.0
    return away / unit[:, None, None], centre, unit


def _direct(src: Floats, dst: Floats, weights: Floats) -> Floats:
    """Return the direct linear transformations (B, 3, 3) of points (B, N, 2) by normal equations (HZ section 4.1).

    The rows of a correspondence are (0, -p, y p) and (p, 0, -x p) with p = (src, 1): A^T A has four different blocks.
    """
    p = np.concatenate((src, np.ones((*src.shape[:2], 1))), axis=2)
    x, y = dst[:, :, 0], dst[:, :, 1]
    S, Sx, Sy, Sxy = (
        np.swapaxes(p * w[:, :, None], 1, 2) @ p for w in (weights, weights * x, weights * y, weights * (x * x + y * y))
    )
    normal = np.zeros((len(p), 9, 9))
    normal[:, 0:3, 0:3] = normal[:, 3:6, 3:6] = S
    normal[:, 0:3, 6:9] = normal[:, 6:9, 0:3] = -Sx
    normal[:, 3:6, 6:9] = normal[:, 6:9, 3:6] = -Sy
    normal[:, 6:9, 6:9] = Sxy
    _, vectors = np.linalg.eigh(normal)
    return np.asarray(vectors[:, :, 0].reshape(-1, 3, 3))


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


def _adjugates(H: Floats) -> tuple[Floats, Floats]:
    """Return the inverses (B, 3, 3) up to positive scale, without a division, and |det H|, (B,)."""
    a, b, c = H[:, :, 0], H[:, :, 1], H[:, :, 2]
    adjugate = np.stack((_cross(b, c), _cross(c, a), _cross(a, b)), axis=1)
    determinant = np.einsum("bi,bi->b", a, adjugate[:, 0])
    norm = np.linalg.norm(adjugate, axis=(1, 2)) * np.where(determinant < 0, -1.0, 1.0)
    return np.asarray(adjugate / np.where(norm != 0, norm, 1.0)[:, None, None], np.float64), np.abs(determinant)


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
