"""Homographies from four points, many at once, as a model for `ransac`."""

from __future__ import annotations

import numpy as np

from imgu_ros.errors import DegenerateConfiguration
from imgu_ros.types import Floats, Indices, Mask, Points
from imgu_ros.vision.projective.dlt import homography_dlt, normalisation
from imgu_ros.vision.projective.transform import normalised_homography

#: Smallest area of a triangle of sample points, in normalised units (mean distance sqrt 2): below, they are collinear.
_MIN_AREA = 1e-4


class HomographyModel:
    """Correspondences src -> dst under `RobustModel`; the error is the distance in dst.

    Hypotheses map normalised points to normalised points; `denormalised` brings one back.

    Parameters
    ----------
    src, dst : (N, 2), checked by the caller

    Raises
    ------
    DegenerateConfiguration
        If all points of one side coincide.
    """

    sample_size = 4

    def __init__(self, src: Points, dst: Points) -> None:
        self._T_src, self._T_dst = normalisation(src), normalisation(dst)
        self._src = src @ self._T_src[:2, :2].T + self._T_src[:2, 2]
        self._dst = dst @ self._T_dst[:2, :2].T + self._T_dst[:2, 2]
        self._unit = float(self._T_dst[0, 0])

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
        good = (np.abs(area_src) > _MIN_AREA).all(axis=1) & (np.abs(area_dst) > _MIN_AREA).all(axis=1)
        good &= (area_src * area_dst > 0).all(axis=1)
        H = _bases(dst[good], area_dst[good]) @ np.linalg.inv(_bases(src[good], area_src[good]))
        sign = np.sign(np.linalg.det(H))
        return np.asarray(H * (sign / np.linalg.norm(H, axis=(1, 2)))[:, None, None], np.float64)

    def squared_errors(self, hypotheses: Floats) -> Floats:
        """Return the squared distance in dst, (B, N), in the caller's pixels; inf behind the plane's horizon."""
        mapped = np.einsum("bij,nj->bin", hypotheses[:, :, :2], self._src) + hypotheses[:, :, 2:]
        w = mapped[:, 2]
        ahead = w > 1e-9
        safe = np.where(ahead, w, 1.0)
        dx = mapped[:, 0] / safe - self._dst[:, 0]
        dy = mapped[:, 1] / safe - self._dst[:, 1]
        return np.where(ahead, (dx * dx + dy * dy) / self._unit**2, np.inf)

    def refit(self, hypothesis: Floats, inliers: Mask) -> Floats:
        """Return the linear fit to the inliers."""
        H = homography_dlt(self._src[inliers], self._dst[inliers])
        if np.linalg.det(H) <= 0:
            raise DegenerateConfiguration("inliers: they give a singular homography; need points that span the plane")
        return H

    def denormalised(self, hypothesis: Floats) -> Floats:
        """Return the homography between the caller's points, unit Frobenius norm."""
        return normalised_homography(np.linalg.solve(self._T_dst, hypothesis @ self._T_src))


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
