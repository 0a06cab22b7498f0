"""Nearest neighbours among descriptors: ratio test and mutual check (notes 5.3; Lowe 2004, section 7.1)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np

from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Image, Indices, Points
from imgu_ros.vision.matching.matches import Matches


class Metric(StrEnum):
    """Distances between descriptors."""

    AUTO = "auto"  #: Hamming for uint8 rows, Euclidean for float32 rows
    EUCLIDEAN = "euclidean"
    COSINE = "cosine"  #: 1 - cosine of the angle between the rows
    HAMMING = "hamming"


def match(
    src: Image,
    dst: Image,
    metric: Metric | str = Metric.AUTO,
    ratio: float = 0.85,
    mutual: bool = True,
    dst_xy: Points | None = None,
    same_place_px: float = 8.0,
) -> Matches:
    """Match each row of `src` to its nearest row of `dst`, exactly (brute force).

    Parameters
    ----------
    src, dst : (N, D) and (M, D), uint8 (bits) or float32
    metric : see `Metric`
    ratio : keep a match when its distance is below `ratio` times that of the second nearest; 1 keeps all.
        (The notes, 5.3.2, have the sign the other way round.)
    mutual : keep a match only when its `src` row is also the nearest to its `dst` row
    dst_xy : (M, 2) px where the rows of `dst` lie. With it, the second nearest is the nearest *at another place*:
        one corner described at neighbouring scales does not rival itself.
    same_place_px : how near two rows of `dst` are the same place

    Returns
    -------
    Matches sorted by the quotient of the two distances, least ambiguous first; O(N M D).

    Raises
    ------
    ShapeError
        If rows, data types or metric do not fit each other.
    """
    metric = _checked(src, dst, Metric(metric))
    if dst_xy is not None and dst_xy.shape != (len(dst), 2):
        raise ShapeError(f"dst_xy: shape {dst_xy.shape}; need ({len(dst)}, 2)")
    if not len(src) or not len(dst):
        return Matches(np.zeros(0, np.intp), np.zeros(0, np.intp), np.zeros(0))
    neighbours = _nearest(src, dst, metric, 2 if dst_xy is None else 5)
    best, second = neighbours.distance[:, 0], _rival(neighbours, dst_xy, same_place_px)
    # Without a rival nothing speaks against the match; two exact copies at distance 0 are fully ambiguous.
    quotient = np.where(np.isfinite(second), 1.0, 0.0)
    np.divide(best, second, out=quotient, where=np.isfinite(second) & (second > 0))
    kept = np.ones(len(src), bool) if ratio >= 1 else quotient < ratio
    if mutual:
        back = _nearest(dst, src, metric, 1).index[:, 0]
        kept &= back[neighbours.index[:, 0]] == np.arange(len(src))
    rows = np.flatnonzero(kept)
    rows = rows[np.lexsort((rows, best[rows], quotient[rows]))]
    return Matches(rows, neighbours.index[rows, 0], best[rows])


@dataclass(frozen=True, slots=True, eq=False)
class _Neighbours:
    """The K nearest rows, nearest first: index (N, K), distance (N, K)."""

    index: Indices
    distance: Floats


def _checked(src: Image, dst: Image, metric: Metric) -> Metric:
    for name, rows in (("src", src), ("dst", dst)):
        if rows.ndim != 2 or rows.dtype not in (np.uint8, np.float32):
            raise ShapeError(f"{name}: shape {rows.shape}, data type {rows.dtype}; need (N, D) uint8 or float32")
    if src.shape[1] != dst.shape[1] or src.dtype != dst.dtype:
        raise ShapeError(f"dst: {dst.shape[1]} x {dst.dtype}; need {src.shape[1]} x {src.dtype}, as src")
    if metric is Metric.AUTO:
        return Metric.HAMMING if src.dtype == np.uint8 else Metric.EUCLIDEAN
    if (metric is Metric.HAMMING) != (src.dtype == np.uint8):
        raise ShapeError(f"metric {metric}: data type {src.dtype}; hamming needs uint8, the others float32")
    return metric


def _nearest(src: Image, dst: Image, metric: Metric, count: int) -> _Neighbours:
    count = min(count, len(dst))
    if metric is Metric.COSINE:
        src, dst = _unit(src), _unit(dst)
    norm, depth = (cv2.NORM_HAMMING, cv2.CV_32S) if metric is Metric.HAMMING else (cv2.NORM_L2, cv2.CV_32F)
    raw, index = cv2.batchDistance(
        np.ascontiguousarray(src), np.ascontiguousarray(dst), depth, normType=norm, K=count
    )
    distance = np.asarray(raw, np.float64)
    if metric is Metric.COSINE:
        distance = distance**2 / 2  # |a - b|^2 = 2 (1 - cos) for unit rows
    return _Neighbours(np.asarray(index, np.intp), distance)


def _unit(rows: Image) -> Image:
    length = np.linalg.norm(rows, axis=1, keepdims=True)
    return np.asarray(rows / np.where(length > 0, length, 1), np.float32)


def _rival(neighbours: _Neighbours, xy: Points | None, same_place_px: float) -> Floats:
    """Return the distance of the second nearest, at another place if places are known; inf where there is none."""
    distance = neighbours.distance
    if distance.shape[1] < 2:
        return np.full(len(distance), np.inf)
    if xy is None:
        return distance[:, 1]
    place = xy[neighbours.index]
    elsewhere = np.hypot(*np.moveaxis(place[:, 1:] - place[:, :1], 2, 0)) > same_place_px
    first = np.argmax(elsewhere, axis=1)
    # All K neighbours at one place: the true rival is at least as far as the last of them.
    first = np.where(elsewhere.any(axis=1), first, elsewhere.shape[1] - 1)
    return np.asarray(distance[np.arange(len(distance)), first + 1], np.float64)
