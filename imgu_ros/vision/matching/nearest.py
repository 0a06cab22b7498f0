"""Nearest neighbours among descriptors: ratio test and mutual check (notes 5.3; Lowe 2004, section 7.1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imgu_ros.errors import ShapeError
from imgu_ros.types import Choice, Floats, Image, Indices, Points, as_matrix
from imgu_ros.vision.matching.matches import Matches

#: Of the numbers in a row: their squares are summed in single precision.
_LARGEST = 1e15


class Metric(Choice):
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
    ratio : > 0; keep a match when its distance is below `ratio` times that of the second nearest; 1 keeps all.
        (The notes, 5.3.2, have the sign the other way round.)
    mutual : keep a match only when its `src` row is also the nearest to its `dst` row
    dst_xy : (M, 2) px where the rows of `dst` lie. With it, the second nearest is the nearest *at another place*:
        one corner described at neighbouring scales does not rival itself.
    same_place_px : up to how far apart, along x and along y, two rows of `dst` are at the same place

    Returns
    -------
    Matches sorted by the quotient of the two distances, least ambiguous first; O(N M D).

    Raises
    ------
    ShapeError
        If rows, data types or metric do not fit each other, a row holds NaN or numbers beyond 1e15, or `ratio` is not
        positive.
    """
    metric = _checked(src, dst, Metric(metric))
    if not ratio > 0:
        raise ShapeError(f"ratio: {ratio!r}; need a number > 0")
    if dst_xy is not None:
        dst_xy = as_matrix(dst_xy, (len(dst), 2), "dst_xy")
    if not len(src) or not len(dst):
        return Matches(np.zeros(0, np.intp), np.zeros(0, np.intp), np.zeros(0))
    likeness = _likeness(src, dst, metric)
    nearest = likeness.argmax(axis=1)
    rows = np.arange(len(src))
    if mutual:
        # Equal distances, frequent among bits, count as nearest on both sides.
        rows = rows[likeness.max(axis=0)[nearest] == likeness[rows, nearest]]
    nearest = nearest[rows]
    best = _distances(src[rows], dst[nearest], metric)
    second = np.full(len(rows), np.inf)
    rival = _rivals(likeness[rows], nearest, dst_xy, same_place_px)
    second[rival >= 0] = _distances(src[rows[rival >= 0]], dst[rival[rival >= 0]], metric)
    # Without a rival nothing speaks against a match; two exact copies, both at distance 0, are fully ambiguous.
    quotient = np.where(np.isfinite(second), 1.0, 0.0)
    np.divide(best, second, out=quotient, where=np.isfinite(second) & (second > 0))
    kept = np.flatnonzero(quotient < ratio) if ratio < 1 else np.arange(len(rows))
    kept = kept[np.lexsort((rows[kept], best[kept], quotient[kept]))]
    return Matches(rows[kept], nearest[kept], best[kept])


def _checked(src: Image, dst: Image, metric: Metric) -> Metric:
    for name, rows in (("src", src), ("dst", dst)):
        if not isinstance(rows, np.ndarray):
            raise ShapeError(f"{name}: {type(rows).__name__}; need a numpy array")
        if rows.ndim != 2 or not rows.shape[1] or rows.dtype not in (np.uint8, np.float32):
            raise ShapeError(f"{name}: shape {rows.shape}, data type {rows.dtype}; need (N, D >= 1) uint8 or float32")
        # Squares of larger numbers overflow; NaN compares as not less.
        if rows.dtype == np.float32 and rows.size and not max(rows.max(), -rows.min()) < _LARGEST:
            raise ShapeError(f"{name}: NaN or numbers beyond {_LARGEST:g}; need finite numbers")
    if src.shape[1] != dst.shape[1] or src.dtype != dst.dtype:
        raise ShapeError(f"dst: {dst.shape[1]} x {dst.dtype}; need {src.shape[1]} x {src.dtype}, as src")
    if metric is Metric.AUTO:
        return Metric.HAMMING if src.dtype == np.uint8 else Metric.EUCLIDEAN
    if (metric is Metric.HAMMING) != (src.dtype == np.uint8):
        raise ShapeError(f"metric {metric}: data type {src.dtype}; hamming needs uint8, the others float32")
    return metric


def _likeness(src: Image, dst: Image, metric: Metric) -> Image:
    """Return a (N, M) float32 matrix that is larger the nearer two rows are: one product of matrices."""
    if metric is Metric.HAMMING:
        # With bits as -1 and 1 the product is D - 2 Hamming, exactly: the sums are integers below 2^24.
        return _signs(src) @ _signs(dst).T
    if metric is Metric.COSINE:
        return _unit(src) @ _unit(dst).T
    # |a - b|^2 = |a|^2 - 2 (a b - |b|^2 / 2), and |a| is the same along a row; but not for the mutual check.
    halves = [np.einsum("nd,nd->n", rows, rows) / 2 for rows in (src, dst)]
    return np.asarray(src @ dst.T - halves[1] - halves[0][:, None], np.float32)


def _distances(a: Image, b: Image, metric: Metric) -> Floats:
    """Return the distance between each row of `a` and the same row of `b`, in double precision."""
    if metric is Metric.HAMMING:
        differing: NDArray[np.uint8] = np.bitwise_xor(a, b)
        return np.asarray(np.unpackbits(differing, axis=1).sum(axis=1), np.float64)
    if metric is Metric.COSINE:
        a, b = _unit(a), _unit(b)
    squared = np.square(a.astype(np.float64) - b).sum(axis=1)
    if metric is Metric.COSINE:
        # |a - b|^2 / 2 = 1 - a b for unit rows. A row of zeros has no direction: its product with any other is 0.
        return np.asarray(np.where(a.any(axis=1) & b.any(axis=1), squared / 2, 1.0))
    return np.asarray(np.sqrt(squared))


def _rivals(likeness: Image, nearest: Indices, xy: Points | None, same_place_px: float) -> Indices:
    """Return for each row its nearest column but `nearest`, and at another place if places are known; else -1."""
    if not likeness.size:
        return np.zeros(len(likeness), np.intp)
    others = likeness.copy()
    rival = nearest.copy()
    same = np.arange(len(nearest))
    # Few neighbours lie at the same place: crossing them out one by one is faster than comparing all places.
    while len(same):
        others[same, rival[same]] = -np.inf
        rival[same] = others[same].argmax(axis=1)
        exhausted = np.isneginf(others[same, rival[same]])
        rival[same[exhausted]] = -1
        same = same[~exhausted]
        if xy is None:
            break
        apart = np.abs(xy[rival[same]] - xy[nearest[same]]).max(axis=1)
        same = same[apart <= same_place_px]
    return rival


def _signs(bits: Image) -> Image:
    return np.unpackbits(bits, axis=1).astype(np.float32) * 2 - 1


def _unit(rows: Image) -> Image:
    length = np.linalg.norm(rows, axis=1, keepdims=True)
    return np.asarray(rows / np.where(length > 0, length, 1), np.float32)
