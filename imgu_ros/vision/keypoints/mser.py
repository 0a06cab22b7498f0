# SPDX-License-Identifier: Apache-2.0
"""Maximally stable extremal regions (IU 4.3.1; Matas 2002; Nister & Stewenius 2008)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from imgu_ros.arguments import as_integer, as_number
from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Image, Indices, Mask, Points, as_image
from imgu_ros.vision.keypoints.keypoints import Corners
from imgu_ros.vision.keypoints.orientation import scaled_orientation
from imgu_ros.vision.keypoints.spreading import spread

#: OpenCV refuses smaller images.
_SMALLEST_SIDE_PX = 3
#: Nested regions whose areas differ by less than this factor, one after the other, are one family.
_DIVERSITY = 1.2
#: ... and whose centroids lie within this share of the smaller one's radius.
_SAME_PLACE = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class Regions:
    """N regions of one image, each darker, or each lighter, than all that surrounds it.

    Attributes
    ----------
    xy : (N, 2) px, centroids
    area : (N,) px^2, whole numbers
    stability : (N,) 1 / (1 + variation), the variation being the relative change of the area as the threshold moves by
        `delta` to either side; 1 is best
    """

    xy: Points
    area: Floats
    stability: Floats


def detect_mser(image: Image, max_count: int) -> Corners:
    """Find maximally stable extremal regions on one image, of every size, oriented by the intensity centroid.

    Parameters
    ----------
    image : (H, W) uint8
    max_count : most regions, >= 1

    Returns
    -------
    Corners at the regions' centroids, most stable first, spread over the image; scale is the sigma at which a blob
    detector answers to a disc of the region's area, its radius / sqrt(2).

    Raises
    ------
    ShapeError
        If `image` is not such an image or `max_count` is not positive.

    Notes
    -----
    Peak memory on 1920x1080, a photograph: 180 MB.
    """
    max_count = as_integer(max_count, "max_count")
    image = as_image(image, dtypes=(np.uint8,))
    regions = find_regions(image)
    kept = spread(regions.xy, regions.stability, (image.shape[1], image.shape[0]), max_count)
    xy, scale = regions.xy[kept], np.sqrt(regions.area[kept] / (2 * math.pi))
    return Corners(xy, scale, scaled_orientation(image, xy, scale), regions.stability[kept])


def find_regions(
    image: Image, delta: int = 3, min_area: int = 30, max_share: float = 0.1, max_variation: float = 0.5
) -> Regions:
    """Find the connected sets of pixels below, or above, a threshold whose area hardly depends on that threshold.

    Nested regions of nearly the same place and area are one family, which gives one region: at the middle of its
    thresholds. That is the edge of a blurred disc.

    Parameters
    ----------
    image : (H, W) uint8
    delta : grey values by which the threshold moves to either side, 1 to 60
    min_area : px^2, >= 1
    max_share : largest area as a share of the image's, above 0, up to 1
    max_variation : largest relative change of the area over 2 `delta`, above 0

    Returns
    -------
    Regions, in no particular order; possibly none.

    Raises
    ------
    ShapeError
        If `image` is not such an image or a number lies outside its range.

    Notes
    -----
    Matas, Chum, Urban & Pajdla, "Robust wide baseline stereo from maximally stable extremal regions", 2002. OpenCV's
    linear-time component tree (Nister & Stewenius 2008) with its diversity test off: OpenCV 5.0 takes `min_diversity`
    for a lower limit of the variation and so drops just the stable regions (its issue 29652), OpenCV 4 ignores it.
    At 0 both find the same regions. Each of OpenCV's is a local minimum of the variation, and counting whole pixels
    makes several of them along one edge: hence the families. The threshold at the middle, the region there and its
    variation ((A(t + delta) - A(t - delta)) / A(t)) are ours.

    Examples
    --------
    >>> import cv2, numpy as np
    >>> image = cv2.circle(np.full((100, 120), 60, np.uint8), (50, 40), 12, 180, -1)
    >>> regions = find_regions(cv2.GaussianBlur(image, (0, 0), 2))
    >>> regions.xy.round(1).tolist(), (abs(regions.area / np.count_nonzero(image == 180) - 1) < 0.05).tolist()
    ([[50.0, 40.0]], [True])
    """
    delta = as_integer(delta, "delta")
    min_area = as_integer(min_area, "min_area")
    max_share = as_number(max_share, "max_share")
    max_variation = as_number(max_variation, "max_variation")
    image = as_image(image, dtypes=(np.uint8,))
    if not 1 <= delta <= 60 or min_area < 1 or not 0 < max_share <= 1 or not max_variation > 0:
        raise ShapeError(
            f"delta, min_area, max_share, max_variation: {delta}, {min_area}, {max_share}, {max_variation}; "
            "need 1 to 60, at least 1, above 0 and up to 1, above 0"
        )
    max_area = int(max_share * image.size)
    found: list[NDArray[np.int32]] = []
    if max_area > min_area and min(image.shape) >= _SMALLEST_SIDE_PX:
        finder = cv2.MSER.create(
            delta=2 * delta, min_area=min_area, max_area=max_area, max_variation=max_variation, min_diversity=0.0
        )
        found = [np.asarray(region, np.int32) for region in finder.detectRegions(image)[0]]
    if not found:
        return Regions(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    nested = _nested(image, found)
    return _at_middle(image, nested, _families(nested), delta)


@dataclass(frozen=True, slots=True, eq=False)
class _Nested:
    """N regions as OpenCV finds them.

    Attributes
    ----------
    pixels : (P, 2) x y, region after region
    count : (N,) pixels of each
    start : (N,) where they begin
    xy : (N, 2) centroids
    dark : (N,) whether the surroundings are lighter
    threshold : (N,) the largest value in a dark region, the least in a light one
    depth : (N,) difference of the two
    gap : (N,) from the threshold to a pixel that touches the region from outside
    """

    pixels: NDArray[np.int32]
    count: Indices
    start: Indices
    xy: Points
    dark: Mask
    threshold: NDArray[np.int16]
    depth: NDArray[np.int16]
    gap: NDArray[np.int16]


def _nested(image: Image, found: Sequence[NDArray[np.int32]]) -> _Nested:
    """Return OpenCV's regions with what they are like."""
    count = np.array([len(pixels) for pixels in found])
    start = np.cumsum(count) - count
    pixels = np.concatenate(found)
    xy = np.add.reduceat(pixels, start, axis=0, dtype=np.int64) / count[:, None]
    value = image[pixels[:, 1], pixels[:, 0]]
    low, high = (f.reduceat(value, start).astype(np.int16) for f in (np.minimum, np.maximum))
    # One pixel that touches the region from outside tells: the one left of its leftmost, or right of its rightmost.
    height, width = image.shape
    position = pixels[:, 0].astype(np.int64) * height + pixels[:, 1]
    left, right = (f.reduceat(position, start) for f in (np.minimum, np.maximum))
    outside = np.where(left >= height, left - height, np.minimum(right + height, height * width - 1))
    beside = image[outside % height, outside // height].astype(np.int16)
    threshold = np.where(beside > high, high, low)
    return _Nested(pixels, count, start, xy, beside > high, threshold, high - low, np.abs(beside - threshold))


def _families(nested: _Nested) -> Indices:
    """Return the number of the family of each region: of those at one place whose areas make a chain."""
    # Imported here: they take some tenths of a second, and other detectors do without.
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    radius = np.sqrt(nested.count / math.pi)
    band = np.floor(np.log2(radius)).astype(int)
    links = [np.zeros((0, 2), np.intp)]
    for k in np.unique(band):
        # Relatives lie in one band of radii or in two successive ones.
        some = np.flatnonzero((band == k) | (band == k + 1))
        pairs = some[cKDTree(nested.xy[some]).query_pairs(_SAME_PLACE * 2.0 ** (k + 1), output_type="ndarray")]
        a, b = pairs[:, 0], pairs[:, 1]
        near = np.hypot(*(nested.xy[a] - nested.xy[b]).T) <= _SAME_PLACE * np.minimum(radius[a], radius[b])
        ratio = nested.count[a] / nested.count[b]
        links.append(pairs[near & (ratio < _DIVERSITY) & (ratio > 1 / _DIVERSITY) & (nested.dark[a] == nested.dark[b])])
    a, b = np.concatenate(links).T
    graph = coo_array((np.ones(len(a), bool), (a, b)), shape=(len(radius), len(radius)))
    return np.asarray(connected_components(graph, directed=False)[1], np.intp)


def _at_middle(image: Image, nested: _Nested, family: Indices, delta: int) -> Regions:
    """Return one region for each family: at the middle of the thresholds at which it is stable."""
    # The top of a hill, of which a stricter threshold leaves nothing, is stable only where it ends in a cliff.
    deep, cliff = nested.depth >= 2 * delta, nested.gap > 2 * delta
    by_size = np.lexsort((nested.count, family))
    by_size = by_size[(deep | cliff)[by_size]]
    if not len(by_size):
        return Regions(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    ends = np.flatnonzero(np.diff(family[by_size], append=-1) != 0)
    smallest, largest = by_size[np.r_[0, ends[:-1] + 1]], by_size[ends]
    dark, count = nested.dark[largest], nested.count[largest]
    start = np.cumsum(count) - count
    pixels = nested.pixels[np.arange(count.sum()) + np.repeat(nested.start[largest] - start, count)]
    # From here on a light region is a dark one of the negative: thresholds rise as regions grow.
    value = image[pixels[:, 1], pixels[:, 0]].astype(np.int16)
    value = np.where(np.repeat(dark, count), value, 255 - value)
    strict, lax = (np.where(dark, nested.threshold[e], 255 - nested.threshold[e]) for e in (smallest, largest))
    middle, upper = (strict + lax) // 2, np.minimum((strict + lax) // 2 + delta, lax)

    def held(threshold: NDArray[np.int16]) -> Mask:
        return np.asarray(value <= np.repeat(threshold, count), bool)

    inside = held(middle)
    area, laxer, stricter = (
        np.add.reduceat(pixels_in, start, dtype=np.int64)
        for pixels_in in (inside, held(upper), held(upper - 2 * delta))
    )
    xy = np.add.reduceat(pixels * inside[:, None], start, axis=0, dtype=np.int64) / area[:, None]
    variation = np.where(deep[largest], (laxer - stricter) / area, 0.0)
    return Regions(xy, area.astype(np.float64), 1 / (1 + variation))
