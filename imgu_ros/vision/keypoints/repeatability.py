# SPDX-License-Identifier: Apache-2.0
"""How many keypoints are found again in another view (IU 4.1)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_integer, as_number, as_sequence
from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.types import Floats, Indices, Mask, Matrix3, Points, as_matrix, as_points
from imgu_ros.vision.projective.transform import inverse3

_LARGEST_PX = 1e9
#: Of distances that are held at once.
_AT_ONCE = 2**20


@dataclass(frozen=True, slots=True, eq=False)
class Repeatability:
    """Which keypoints of two views were found again.

    Attributes
    ----------
    share : number of pairs over the smaller of the two numbers of keypoints in the common part; 0 where one has none
    index_src, index_dst : (K,) the pairs, nearest first
    common_src, common_dst : (N,) and (M,) whether each keypoint lies in the part that both images show
    """

    share: float
    index_src: Indices
    index_dst: Indices
    common_src: Mask
    common_dst: Mask


def repeatability(
    src_xy: ArrayLike,
    dst_xy: ArrayLike,
    H_dst_src: ArrayLike,
    src_size: Sequence[int],
    dst_size: Sequence[int] | None = None,
    radius_px: float = 1.5,
) -> Repeatability:
    """Return the share of keypoints that are found again in a second image of a plane.

    Keypoints outside the part that both images show do not count. Two are the same when each, mapped into the
    other's image, lies within the radius there: in both, so that a zoom helps nobody. Nearest pairs come first, and
    each keypoint is in one pair at most.

    Parameters
    ----------
    src_xy, dst_xy : (N, 2) and (M, 2) px, positions of keypoints
    H_dst_src : (3, 3) the true homography between the images
    src_size, dst_size : (width, height) px; `dst_size` None: as `src_size`
    radius_px : largest distance of a keypoint from where it should be, > 0; 1.5 is that of Schmid et al.

    Raises
    ------
    DegenerateConfiguration
        If H is singular, or the first image's centre is mapped to infinity.
    ShapeError
        If an argument is not as said.

    Notes
    -----
    Schmid, Mohr & Bauckhage, "Evaluation of interest point detectors", 2000, section 3; the smaller count as the
    reference: Mikolajczyk et al., "A comparison of affine region detectors", 2005, section 4.1.

    Examples
    --------
    The second image is shifted by 10 px to the right, so that x < 10 px is new in it:

    >>> src, dst = [[50, 50], [20, 80], [95, 5]], [[60, 51], [30, 80], [70, 20], [3, 3]]
    >>> found = repeatability(src, dst, [[1, 0, 10], [0, 1, 0], [0, 0, 1]], (100, 100))
    >>> found.share, found.index_src.tolist(), found.index_dst.tolist()
    (1.0, [1, 0], [1, 0])
    >>> found.common_src.tolist(), found.common_dst.tolist()
    ([True, True, False], [True, True, True, False])
    """
    src, dst = as_points(src_xy, "src_xy"), as_points(dst_xy, "dst_xy")
    for name, points in (("src_xy", src), ("dst_xy", dst)):
        if not np.abs(points).max(initial=0.0) < _LARGEST_PX:
            raise ShapeError(f"{name}: up to {np.abs(points).max():g}; need less than {_LARGEST_PX:g} px")
    first = _as_size(src_size, "src_size")
    second = first if dst_size is None else _as_size(dst_size, "dst_size")
    radius_px = as_number(radius_px, "radius_px")
    if not 0 < radius_px < _LARGEST_PX:
        raise ShapeError(f"radius_px: {radius_px:g}; need above 0, below {_LARGEST_PX:g}")
    H = _facing(H_dst_src, first)
    there, back = _mapped(H, src), _mapped(inverse3(H, "H_dst_src"), dst)
    common_src, common_dst = (
        _inside(src, first) & _inside(there, second),
        _inside(dst, second) & _inside(back, first),
    )
    a, b = np.flatnonzero(common_src), np.flatnonzero(common_dst)
    pairs = _nearest_first(_apart(there[a], dst[b], src[a], back[b], radius_px))
    share = len(pairs) / min(len(a), len(b)) if len(a) and len(b) else 0.0
    return Repeatability(share, a[pairs[:, 0]], b[pairs[:, 1]], common_src, common_dst)


def _as_size(size: Sequence[int], name: str) -> tuple[int, int]:
    sides = [as_integer(side, name) for side in as_sequence(size, name)]
    if len(sides) != 2 or not 1 <= min(sides) <= max(sides) < _LARGEST_PX:
        raise ShapeError(f"{name}: {sides}; need (width, height), px")
    return sides[0], sides[1]


def _facing(H: ArrayLike, size: tuple[int, int]) -> Matrix3:
    """Return H with the sign with which the image's centre has w > 0: whatever has not lies beyond the horizon."""
    H = as_matrix(H, (3, 3), "H_dst_src")
    largest = float(np.abs(H).max())
    if largest == 0:
        raise DegenerateConfiguration("H_dst_src: all zero; need a homography")
    H = H / largest
    w = float(H[2] @ [(size[0] - 1) / 2, (size[1] - 1) / 2, 1.0])
    if w == 0:
        raise DegenerateConfiguration("H_dst_src: the picture's centre is mapped to infinity; need one that shows it")
    return H * math.copysign(1.0, w)


def _mapped(H: Matrix3, points: Points) -> Points:
    """Return the mapped points; NaN for what lies beyond the horizon."""
    mapped = points @ H[:, :2].T + H[:, 2]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return np.where(mapped[:, 2:] > 0, mapped[:, :2] / mapped[:, 2:], np.nan)


def _inside(points: Points, size: tuple[int, int]) -> Mask:
    return np.asarray(((points >= 0) & (points <= np.array(size) - 1)).all(axis=1))


def _apart(there: Points, dst: Points, src: Points, back: Points, radius_px: float) -> tuple[Floats, Indices]:
    """Return the larger of both distances of all pairs within the radius, (P,), and which they are, (P, 2)."""
    distances, pairs = [np.zeros(0)], [np.zeros((0, 2), np.intp)]
    height = max(1, _AT_ONCE // max(1, len(dst)))
    for start in range(0, len(src), height):
        some = slice(start, start + height)
        apart = np.maximum(
            np.linalg.norm(there[some, None] - dst, axis=2), np.linalg.norm(src[some, None] - back, axis=2)
        )
        i, j = np.nonzero(apart <= radius_px)
        distances.append(apart[i, j])
        pairs.append(np.column_stack((i + start, j)))
    return np.concatenate(distances), np.concatenate(pairs)


def _nearest_first(apart: tuple[Floats, Indices]) -> Indices:
    """Return the pairs of which no point is in a nearer one, (K, 2)."""
    distance, pairs = apart
    kept: list[tuple[int, int]] = []
    used_src: set[int] = set()
    used_dst: set[int] = set()
    for a, b in pairs[np.argsort(distance, kind="stable")].tolist():
        if a not in used_src and b not in used_dst:
            used_src.add(a)
            used_dst.add(b)
            kept.append((a, b))
    return np.array(kept, np.intp).reshape(-1, 2)
