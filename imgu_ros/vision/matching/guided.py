# SPDX-License-Identifier: Apache-2.0
"""Matching guided by a homography, to convergence (IU 7.5; Hartley & Zisserman 2004, algorithm 4.6, step v)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_flag, as_integer, as_number
from imgu_ros.errors import NoConsensus, ShapeError
from imgu_ros.types import Floats, Image, Indices, Matrix3, Points, as_points
from imgu_ros.vision.estimation.nonlinear import Minimiser
from imgu_ros.vision.matching.gallery import Gallery, prepare_gallery
from imgu_ros.vision.matching.matches import Matches
from imgu_ros.vision.matching.metrics import Metric, checked_rows, comparable_rows
from imgu_ros.vision.matching.near import near_pairs
from imgu_ros.vision.projective.fit import fit_homography
from imgu_ros.vision.projective.homography import HomographyEstimate, normalised_homography
from imgu_ros.vision.projective.refine import HomographyError

#: Larger numbers are no coordinates in an image.
_LARGEST_PX = 1e9
#: Pairs of neighbours weighed at once: bounds the memory.
_CHUNK = 2**16


def match_guided(
    src: Image,
    dst: Image,
    src_xy: ArrayLike,
    dst_xy: ArrayLike,
    H_dst_src: ArrayLike,
    radius_px: float = 6.0,
    metric: Metric | str = Metric.AUTO,
    ratio: float = 0.95,
    mutual: bool = True,
    same_place_px: float = 2.0,
) -> Matches:
    """Match each row of `src` to the nearest of those rows of `dst` that lie where a homography predicts it.

    With few rivals left, a looser ratio does: true matches that rows elsewhere in the image rivalled come back.

    Parameters
    ----------
    src, dst, metric, ratio, mutual : as in `match`, among the neighbours
    src_xy, dst_xy : (N, 2) and (M, 2) px where the rows lie
    H_dst_src : (3, 3), dst ~ H src, either sign; what it maps beyond the horizon is not matched
    radius_px : >= 0; how far from its predicted place a match may lie
    same_place_px : up to how far apart two rows of `dst` are at one place and no rivals

    Returns
    -------
    Matches sorted by the quotient of the two distances, least ambiguous first. With K neighbours in all
    O((N + M) log M + K D).

    Raises
    ------
    ShapeError
        If rows, data types, metric and places do not fit each other, or a number is not finite or out of its range.
    DegenerateConfiguration
        If H is zero.

    Examples
    --------
    >>> import numpy as np
    >>> rows = np.array([[1, 2], [3, 4]], np.float32)
    >>> found = match_guided(rows, rows, [[0, 0], [9, 9]], [[1, 0], [10, 9]], [[1, 0, 1], [0, 1, 0], [0, 0, 1]])
    >>> found.index_dst.tolist()
    [0, 1]
    """
    mutual = as_flag(mutual, "mutual")
    radius_px = as_number(radius_px, "radius_px")
    ratio = as_number(ratio, "ratio")
    same_place_px = as_number(same_place_px, "same_place_px")
    near = _Near(prepare_gallery(dst, metric), _places(dst_xy, dst, "dst_xy"), radius_px, same_place_px, ratio, mutual)
    return _guided(checked_rows(src, "src"), near, _places(src_xy, src, "src_xy"), normalised_homography(H_dst_src))


@dataclass(frozen=True, slots=True, eq=False)
class GuidedHomography:
    """What guided matching converged to.

    Attributes
    ----------
    matches : all that lie where the homography predicts them, best first
    homography : fitted to those within the threshold, its `inliers`; `iterations` are rounds of matching and fitting
    """

    matches: Matches
    homography: HomographyEstimate


def guided_homography(
    src: Image,
    dst: Image,
    src_xy: ArrayLike,
    dst_xy: ArrayLike,
    start: ArrayLike,
    *,
    threshold_px: float = 3.0,
    metric: Metric | str = Metric.AUTO,
    ratio: float = 0.95,
    min_inliers: int = 5,
    error: HomographyError | str = HomographyError.SAMPSON,
    refine: Minimiser | str | None = Minimiser.LEVENBERG_MARQUARDT,
    max_rounds: int = 10,
) -> GuidedHomography:
    """Match where a homography predicts, fit it to what was found, and repeat until the matches stay the same.

    Parameters
    ----------
    src, dst, src_xy, dst_xy, metric, ratio : see `match_guided`
    start : (3, 3), a first homography, dst ~ H src
    threshold_px : largest distance in dst of an inlier; matches are considered up to twice as far
    min_inliers : minimum number of inliers of an answer, at least 5
    error, refine : what the fit minimises, and how; see `fit_homography`
    max_rounds : >= 1; the matches may also alternate between two sets

    Raises
    ------
    ShapeError
        As `match_guided`.
    NoConsensus
        If fewer than `min_inliers` matches agree with a round's homography.
    DegenerateConfiguration
        If they lie (nearly) on a line.

    Examples
    --------
    >>> import numpy as np
    >>> rows = np.arange(24, dtype=np.float32).reshape(6, 4) ** 2
    >>> xy = np.array([[0, 0], [90, 5], [80, 95], [5, 85], [40, 60], [60, 30]])
    >>> H = guided_homography(rows, rows, xy, xy + 7, np.array([[1, 0, 5], [0, 1, 6], [0, 0, 1]])).homography.H
    >>> ((H / H[2, 2]).round(6) + 0.0).tolist()[0]
    [1.0, 0.0, 7.0]
    """
    threshold_px = as_number(threshold_px, "threshold_px")
    ratio = as_number(ratio, "ratio")
    min_inliers = as_integer(min_inliers, "min_inliers")
    max_rounds = as_integer(max_rounds, "max_rounds")
    gallery = prepare_gallery(dst, metric)
    checked_rows(src, "src")
    src_xy, dst_xy = _places(src_xy, src, "src_xy"), _places(dst_xy, dst, "dst_xy")
    near = _Near(gallery, dst_xy, 2 * threshold_px, threshold_px, ratio, mutual=True)
    if min_inliers < 5 or max_rounds < 1:
        raise ShapeError(f"min_inliers, max_rounds: {min_inliers}, {max_rounds}; need at least 5 and 1")
    H, before, rounds = normalised_homography(start), None, 0
    while rounds < max_rounds:
        rounds += 1
        matches = _guided(src, near, src_xy, H)
        a, b = src_xy[matches.index_src], dst_xy[matches.index_dst]
        agree = np.flatnonzero(_distance_px(H, a, b) <= threshold_px)
        if len(agree) < min_inliers:
            raise NoConsensus(f"guided matches: {len(agree)} within {threshold_px:g} px; need {min_inliers}")
        estimate = fit_homography(a[agree], b[agree], error=error, refine=refine, start=H)
        H = estimate.H
        pairs = matches.index_src[agree] * len(dst_xy) + matches.index_dst[agree]
        if before is not None and np.array_equal(np.sort(pairs), before):
            break
        before = np.sort(pairs)
    inliers = np.zeros(len(matches), bool)
    inliers[agree] = True
    return GuidedHomography(
        matches, HomographyEstimate(estimate.H, estimate.covariance, inliers, estimate.rms_px, rounds)
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Near:
    """What is matched to, and when it counts as near; as in `match_guided`."""

    gallery: Gallery
    xy: Points
    radius_px: float
    same_place_px: float
    ratio: float
    mutual: bool


def _guided(src: Image, near: _Near, src_xy: Points, H: Matrix3) -> Matches:
    dst, prepared = near.gallery.descriptors, near.gallery.prepared
    src = comparable_rows(src, dst.shape[1], dst.dtype.type)
    for name, distance_px in (("radius_px", near.radius_px), ("same_place_px", near.same_place_px)):
        if not 0 <= distance_px < _LARGEST_PX:
            raise ShapeError(f"{name}: {distance_px!r}; need 0 to {_LARGEST_PX:g}")
    if not near.ratio > 0:
        raise ShapeError(f"ratio: {near.ratio!r}; need a number > 0")
    neighbours = _neighbours(src_xy, near.xy, H, near.radius_px)
    distance = np.concatenate(
        [np.zeros(0)]
        + [
            prepared.distances(src[neighbours.src[some]], neighbours.dst[some])
            for some in (slice(k, k + _CHUNK) for k in range(0, len(neighbours.src), _CHUNK))
        ]
    )
    order = np.lexsort((neighbours.dst, distance, neighbours.src))
    i, j, distance = neighbours.src[order], neighbours.dst[order], distance[order]
    rows, first, group = np.unique(i, return_index=True, return_inverse=True)
    nearest, best = j[first], distance[first]
    # The pairs of a row follow each other, nearest first: the first one elsewhere is the rival.
    apart = np.flatnonzero(np.abs(near.xy[j] - near.xy[nearest[group]]).max(axis=1, initial=0) > near.same_place_px)
    rivalled, rival = np.unique(group[apart], return_index=True)
    second = np.full(len(rows), np.inf)
    second[rivalled] = distance[apart[rival]]
    quotient = np.where(np.isfinite(second), 1.0, 0.0)
    np.divide(best, second, out=quotient, where=np.isfinite(second) & (second > 0))
    kept = quotient < near.ratio if near.ratio < 1 else np.ones(len(rows), bool)
    if near.mutual:
        least = np.full(len(near.xy), np.inf)
        np.minimum.at(least, j, distance)
        kept &= least[nearest] == best
    kept = np.flatnonzero(kept)
    kept = kept[np.lexsort((rows[kept], best[kept], quotient[kept]))]
    return Matches(rows[kept], nearest[kept], best[kept])


def _places(xy: ArrayLike, rows: Image, name: str) -> Points:
    xy = as_points(xy, name)
    if len(xy) != len(rows):
        raise ShapeError(f"{name}: {len(xy)} points; need {len(rows)}, one for each row")
    if len(xy) and not np.abs(xy).max() < _LARGEST_PX:
        raise ShapeError(f"{name}: up to {np.abs(xy).max():g}; need less than {_LARGEST_PX:g} px")
    return xy


@dataclass(frozen=True, slots=True, eq=False)
class _Pairs:
    """Rows of both sets, (K,) each."""

    src: Indices
    dst: Indices


def _neighbours(src_xy: Points, dst_xy: Points, H: Floats, radius_px: float) -> _Pairs:
    """Return all pairs in which the `dst` point lies within the radius of where H maps the `src` point."""
    # Homographies are kept with w > 0 on the side that is seen: the larger share of the points.
    depth = src_xy @ H[2, :2] + H[2, 2]
    if np.count_nonzero(depth < 0) > np.count_nonzero(depth > 0):
        H = -H
    predicted = np.full(src_xy.shape, np.inf)
    ahead, mapped = _mapped(H, src_xy)
    predicted[ahead] = mapped
    near = np.flatnonzero((np.abs(predicted) < _LARGEST_PX).all(axis=1))
    if not len(near) or not len(dst_xy):
        return _Pairs(np.zeros(0, np.intp), np.zeros(0, np.intp))
    pairs = near_pairs(predicted[near], dst_xy, radius_px)
    assert pairs is not None
    src, dst = near[pairs.a], pairs.b
    within = np.hypot(*(predicted[src] - dst_xy[dst]).T) <= radius_px
    return _Pairs(src[within], dst[within])


def _mapped(H: Floats, points: Points) -> tuple[Indices, Points]:
    """Return which points H maps to this side of the horizon, and where."""
    ahead = np.flatnonzero(points @ H[2, :2] + H[2, 2] > 1e-12)
    mapped = points[ahead] @ H[:, :2].T + H[:, 2]
    return ahead, mapped[:, :2] / mapped[:, 2:]


def _distance_px(H: Floats, src_xy: Points, dst_xy: Points) -> Floats:
    distance = np.full(len(src_xy), np.inf)
    ahead, mapped = _mapped(H, src_xy)
    distance[ahead] = np.hypot(*(mapped - dst_xy[ahead]).T)
    return distance
