# SPDX-License-Identifier: Apache-2.0
"""Nearest neighbours among descriptors: ratio test and mutual check (IU 5.3; Lowe 2004, section 7.1)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imgu_ros.arguments import as_flag, as_number, require_type
from imgu_ros.errors import ShapeError
from imgu_ros.types import Image, Indices, Mask, Points
from imgu_ros.vision.matching.gallery import Gallery, prepare_gallery
from imgu_ros.vision.matching.matches import Matches
from imgu_ros.vision.matching.metrics import Metric, checked_rows, comparable_rows


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
    src, dst : (N, D) and (M, D), uint8 (bits) or float32; see `checked_rows` for others
    metric : see `Metric`
    ratio : > 0; keep a match when its distance is below `ratio` times that of the second nearest; 1 keeps all.
        (IU 5.3.2 have the sign the other way round.)
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
        If rows, data types or metric do not fit each other, a row is not finite, or `ratio` is not positive.

    Examples
    --------
    >>> import numpy as np
    >>> src = np.array([[0, 1], [5, 5], [9, 8]], np.float32)
    >>> dst = np.array([[9, 9], [0, 0]], np.float32)
    >>> found = match(src, dst, ratio=0.8)
    >>> found.index_src.tolist(), found.index_dst.tolist(), found.distance.tolist()
    ([0, 2], [1, 0], [1.0, 1.0])
    """
    mutual = as_flag(mutual, "mutual")
    ratio = as_number(ratio, "ratio")
    same_place_px = as_number(same_place_px, "same_place_px")
    src = checked_rows(src, "src")
    return match_to_gallery(src, prepare_gallery(dst, metric, dst_xy, same_place_px), ratio, mutual)


def match_to_gallery(src: Image, gallery: Gallery, ratio: float = 0.85, mutual: bool = True) -> Matches:
    """Match each row of `src` to its nearest row of a gallery; as `match`, for a set that is matched to often.

    Parameters
    ----------
    src : (N, D), as the gallery's descriptors
    gallery : what `prepare_gallery` made
    ratio, mutual : see `match`

    Raises
    ------
    ShapeError
        If the rows do not fit the gallery's, one is not finite, or `ratio` is not positive.

    Examples
    --------
    >>> import numpy as np
    >>> target = np.random.default_rng(0).integers(0, 256, (100, 32), np.uint8)
    >>> gallery = prepare_gallery(target)
    >>> match_to_gallery(target[40:43], gallery).index_dst.tolist()
    [40, 41, 42]
    """
    mutual = as_flag(mutual, "mutual")
    require_type(gallery, Gallery, "gallery")
    ratio = as_number(ratio, "ratio")
    src = comparable_rows(src, gallery.descriptors.shape[1], gallery.descriptors.dtype.type)
    if not ratio > 0:
        raise ShapeError(f"ratio: {ratio!r}; need a number > 0")
    if not len(src) or not len(gallery):
        return Matches(np.zeros(0, np.intp), np.zeros(0, np.intp), np.zeros(0))
    candidates = _candidates(src, gallery)
    rows = np.flatnonzero(candidates.is_mutual) if mutual else np.arange(len(src))
    nearest, rival = candidates.nearest[rows], candidates.rival[rows]
    best = gallery.prepared.distances(src[rows], nearest)
    second = np.full(len(rows), np.inf)
    second[rival >= 0] = gallery.prepared.distances(src[rows[rival >= 0]], rival[rival >= 0])
    # Without a rival nothing speaks against a match; two exact copies, both at distance 0, are fully ambiguous.
    quotient = np.where(np.isfinite(second), 1.0, 0.0)
    np.divide(best, second, out=quotient, where=np.isfinite(second) & (second > 0))
    kept = np.flatnonzero(quotient < ratio) if ratio < 1 else np.arange(len(rows))
    kept = kept[np.lexsort((rows[kept], best[kept], quotient[kept]))]
    return Matches(rows[kept], nearest[kept], best[kept])


@dataclass(frozen=True, slots=True, eq=False)
class _Candidates:
    """What each of N rows may be matched to.

    Attributes
    ----------
    nearest, rival : (N,) rows of the gallery; rival -1 where there is none
    is_mutual : (N,) whether no other row is nearer to `nearest`; equal distances, frequent among bits, are not
    """

    nearest: Indices
    rival: Indices
    is_mutual: Mask


def _candidates(src: Image, gallery: Gallery) -> _Candidates:
    nearest, rival = np.empty((2, len(src)), np.intp)
    likeness: list[NDArray[Any]] = []
    largest: list[NDArray[Any]] = []
    start = 0
    for table in gallery.prepared.tables(src):
        rows = np.arange(len(table))
        block = slice(start, start + len(table))
        nearest[block] = table.argmax(axis=1)
        likeness.append(table[rows, nearest[block]])
        largest.append(table.max(axis=0))
        rival[block] = _rivals(table, nearest[block], gallery)
        start += len(table)
    return _Candidates(nearest, rival, np.max(largest, axis=0)[nearest] == np.concatenate(likeness))


def _rivals(table: NDArray[Any], nearest: Indices, gallery: Gallery) -> Indices:
    """Return for each row its nearest column but `nearest`, and at another place if places are known; else -1.

    The table is overwritten.
    """
    none = np.iinfo(table.dtype).min if table.dtype.kind == "i" else -np.inf
    rows = np.arange(len(nearest))
    if gallery.places is None:
        table[rows, nearest] = none
    else:
        same = gallery.places.at(nearest)
        table[same.asked, same.point] = none
    rival = table.argmax(axis=1)
    return np.where(table[rows, rival] == none, -1, rival)
