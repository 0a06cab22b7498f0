# SPDX-License-Identifier: Apache-2.0
"""What a reference's picture alone says of how well it will be found; takes some hundredths of a second."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from imgu_ros.reference.reference import Reference
from imgu_ros.reference.self_similarity import Copy
from imgu_ros.reference.template_cells import CELL, cell_means
from imgu_ros.types import Floats, Image

#: Longer side of the picture in which contrast and flat parts are judged, px: a target as it is often seen.
_SEEN_PX = 160
#: Longer side of the picture that is looked at, where the template has so many px.
_FINEST_PX = 600
#: Longer side at which small print is lost, px.
_FAR_PX = 64
#: Steps of the FAST corner test, grey values of linear light, and corners of the picture enlarged twofold that it takes
#: to be found. Measured: benchmarks/target_scores.py.
_FAST, _CORNERS = 8, 24
#: Blur of a sharp lens, px.
_BLUR_PX = 0.6
#: Standard deviation of a cell of a flat part, grey values of linear light.
_FLAT = 5.0
#: Cells along and across the picture by which the place of its detail is judged.
_PARTS = 4
#: A copy that differs by at most this share of the cells is one for which the target is mistaken.
ALIKE = 0.15
#: A turn whose centre is nearer than this share of the longer side to the target's is one about it.
_OFF_CENTRE = 0.1
#: Turns of usual symmetries, and how exact those of copies are.
_USUAL_TURNS_DEG, _EXACT_DEG = (45, 60, 72, 90, 120, 180), 4.0


@dataclass(frozen=True, slots=True, eq=False)
class Traits:
    """What is known of a target before it is seen.

    Attributes
    ----------
    width_px, height_px : of its outline in the picture
    corners : number of corners where it is seen 160 px long
    corners_from_px : longer side from which on it has enough corners to be found, px; infinite: it never has
    contrast : standard deviation of its grey values, linear light, 0 to 255
    flat_share : share of its area without detail
    lost_share : share of its contrast that is lost where it is seen 64 px long: small print, fine patterns
    crowded_share : share of its area in which nine tenths of its detail lie
    detail : (rows, columns) strength of the detail, 0 to 1, over the whole picture
    copies : where it looks like itself, the most alike first
    """

    width_px: float
    height_px: float
    corners: int
    corners_from_px: float
    contrast: float
    flat_share: float
    lost_share: float
    crowded_share: float
    detail: Image
    copies: tuple[Copy, ...]

    @property
    def elongation(self) -> float:
        """Longer over shorter side."""
        return max(self.width_px, self.height_px) / min(self.width_px, self.height_px)

    @property
    def turns_deg(self) -> tuple[int, ...]:
        """Turns after which the target looks much the same, of 45, 60, 72, 90, 120 and 180 degrees."""
        return tuple(sorted({turn for copy in self._alike if self._is_turn(copy) and (turn := self._turn_of(copy))}))

    @property
    def repeats(self) -> bool:
        """Whether it looks much the same shifted."""
        return any(not self._is_turn(copy) for copy in self._alike)

    @property
    def closest(self) -> Copy | None:
        """The copy for which the target is mistaken most easily; None: there is none."""
        told = [copy for copy in self._alike if not self._is_turn(copy) or self._turn_of(copy)]
        return min(told, key=self._differing, default=None)

    @property
    def telling_share(self) -> float:
        """Share of its cells that tell it from the closest copy; 1 without one."""
        return 1.0 if self.closest is None else self._differing(self.closest)

    @property
    def _alike(self) -> tuple[Copy, ...]:
        return tuple(copy for copy in self.copies if self._differing(copy) <= ALIKE)

    def _is_turn(self, copy: Copy) -> bool:
        return bool(copy.turn_deg) and copy.shift_px < _OFF_CENTRE * max(self.width_px, self.height_px)

    def _turn_of(self, copy: Copy) -> int:
        """Return the turn of a usual symmetry that is as near as copies are exact; 0: none is.

        What is blurred or round looks the same after many others.
        """
        turn = min(copy.turn_deg, 360 - copy.turn_deg)
        nearest = min(_USUAL_TURNS_DEG, key=lambda usual: abs(usual - turn))
        return nearest if abs(nearest - turn) <= _EXACT_DEG else 0

    def _differing(self, copy: Copy) -> float:
        """Return the share of cells that differ, of those that the copy does not put outside the target."""
        share = min(copy.shift_px / min(self.width_px, self.height_px), 1.0)
        return max(copy.differing_share - share, 0.0) / max(1 - share, 1e-9)


def traits_of(reference: Reference, linear: bool = True) -> Traits:
    """Return what a reference's templates say; `linear`: which of them, see `Reference.templates`."""
    octaves = reference.templates[linear]
    # Finer detail is hardly ever seen, and would take its time.
    large = [octave.level.image for octave in octaves if max(octave.level.image.shape) >= _FINEST_PX]
    finest = large[-1] if large else octaves[0].level.image
    seen = _reduced(finest, _SEEN_PX)
    far, contrast = _reduced(finest, _FAR_PX), float(finest.std())
    detail = detail_of(seen)
    width, height = np.ptp(reference.outline_template, axis=0).tolist()
    sizes = [size for size in _SIZES_PX if size <= 2 * max(finest.shape)]
    counts = [corner_count(finest, size) for size in sizes]
    whole = max(float(_reduced(finest, 4 * _FAR_PX).std()), 1e-9)
    return Traits(
        width,
        height,
        corner_count(finest, _SEEN_PX),
        _enough_from(sizes, counts),
        contrast,
        float(np.mean(detail < _FLAT)),
        max(0.0, 1 - float(far.std()) / whole),
        _crowded(detail),
        detail,
        reference.copies(linear),
    )


_SIZES_PX = tuple(24 * 2 ** (step / 2) for step in range(10))


def corner_count(grey: Image, longer_px: float) -> int:
    """Return the number of corners of a picture seen with a longer side of so many px, enlarged as a search does."""
    small = cv2.GaussianBlur(_reduced(grey, longer_px), (0, 0), _BLUR_PX)
    enlarged = cv2.resize(small, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
    return len(cv2.FastFeatureDetector_create(_FAST).detect(enlarged))  # type: ignore[attr-defined, unused-ignore]


def detail_of(grey: Image) -> Image:
    """Return how strong the detail of each cell of 4 px is, grey values: standard deviation."""
    height, width = (max(side // CELL, 1) * CELL for side in grey.shape)
    image = cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA).astype(np.float32)
    mean = cell_means(image)
    return np.asarray(np.sqrt(np.maximum(cell_means(image * image) - mean * mean, 0)))


def _reduced(grey: Image, longer_px: float) -> Image:
    factor = longer_px / max(grey.shape)
    size = tuple(max(round(side * factor), 4) for side in grey.shape[::-1])
    return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA if factor < 1 else cv2.INTER_LINEAR))


def _enough_from(sizes: list[float], counts: list[int]) -> float:
    """Return the size from which on all counts are enough, between two sizes by the logarithms."""
    enough = math.inf
    for index in reversed(range(len(sizes))):
        if counts[index] < _CORNERS:
            if index + 1 < len(sizes):
                low, high = math.log(counts[index] + 0.5), math.log(counts[index + 1] + 0.5)
                share = (math.log(_CORNERS) - low) / max(high - low, 1e-9)
                enough = sizes[index] * (sizes[index + 1] / sizes[index]) ** min(max(share, 0.0), 1.0)
            return enough
        enough = sizes[index]
    return enough


def _crowded(detail: Image) -> float:
    """Return the share of the area that holds nine tenths of the detail, of parts of a sixteenth of it."""
    parts = cv2.resize(np.asarray(detail**2, np.float32), (_PARTS, _PARTS), interpolation=cv2.INTER_AREA)
    strengths: Floats = np.sort(parts, axis=None)[::-1].astype(np.float64)
    total = float(strengths.sum())
    if total <= 0:
        return 1.0
    return float(np.searchsorted(np.cumsum(strengths), 0.9 * total) + 1) / strengths.size
