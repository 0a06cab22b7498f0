# SPDX-License-Identifier: Apache-2.0
"""Where the last sightings of a target lead: its place in the next frame, and how wrong that may be."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np

from imgu_ros.errors import DegenerateConfiguration
from imgu_ros.reference.reference import Reference
from imgu_ros.types import Floats, Matrix3
from imgu_ros.vision.projective.logarithm import exponential, logarithm
from imgu_ros.vision.projective.transform import inverse3

#: Range of the ratio of two frame intervals within which the motion is extrapolated; outside, the last position is
#: used. Measured: benchmarks/thresholds.py, study reach.
_STEADY = (0.2, 5.0)
#: Intervals that differ by less than this share count as equal. Measured: benchmarks/thresholds.py, study reach.
_SAME = 0.1
#: Smallest mean distance of the corners from their centre, px: below any reference in view; prevents a division by
#: zero.
_SMALLEST_PX = 1e-6
#: Number of observations kept: constant acceleration needs three.
_MOST_SIGHTINGS = 3
#: Share of the last prediction error that is still expected in the next frame. Measured: benchmarks/thresholds.py,
#: study reach.
_MEMORY = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """Where a target was seen: H_image_template in ideal px, and when."""

    H: Matrix3
    stamp_ns: int


class Track:
    """The last sightings of a target, and how wrong what they led to expect was.

    Sightings lead on in three ways: the target stays where it was last (one sighting), it moves on as it moved last
    (two), or its motion changes as it changed last (three). A camera at rest, one that is carried and one on a machine
    differ in which serves best: that which was least wrong lately.

    Parameters
    ----------
    sightings : latest first, one to three
    surprises_px : of each way, in this order, the largest distance of the outline's corners from where it led, lately,
        after as long as between the last two sightings; empty: no prediction was compared with a sighting yet
    """

    def __init__(self, sightings: Sequence[Observation], surprises_px: Sequence[float] = ()) -> None:
        self.sightings = tuple(sightings)[:_MOST_SIGHTINGS]
        self.surprises_px = tuple(surprises_px)
        self._ways: _MotionHypotheses | None = None

    @property
    def last(self) -> Observation:
        """The latest sighting."""
        return self.sightings[0]

    def continued(self, target: Reference, H: Matrix3, stamp_ns: int) -> Track:
        """Return the track with one more sighting."""
        sightings = (Observation(H, stamp_ns), *self.sightings)
        if len(self.sightings) == 1:
            return Track(sightings)
        xy = _corners(np.array((H, *self._led_on(target, stamp_ns).ways)), target)
        away = xy[1:] - xy[0]
        surprises = np.sqrt((away**2).sum(axis=1).max(axis=1)).tolist()
        # As they would have been after as long as before.
        later = self._quotient(0, stamp_ns)
        surprises = [px / max(_growth(order, later), 1.0) for order, px in enumerate(surprises)]
        # One lucky hit is forgotten sooner than a miss.
        kept = zip_longest(surprises, self.surprises_px[: len(surprises)], fillvalue=0.0)
        return Track(sightings, tuple(max(new, _MEMORY * old) for new, old in kept))

    def expected(self, target: Reference, stamp_ns: int) -> Expected:
        """Return where the target is expected at a time."""
        ways = self._led_on(target, stamp_ns).ways
        if not self.surprises_px:
            return Expected(ways[min(1, len(ways) - 1)], None)
        later = self._quotient(0, stamp_ns)
        wrong = [px * _growth(order, later) for order, px in enumerate(self.surprises_px[: len(ways)])]
        best = wrong.index(min(wrong))
        return Expected(ways[best], wrong[best])

    def _led_on(self, target: Reference, stamp_ns: int) -> _MotionHypotheses:
        """Return what the sightings lead to expect."""
        if self._ways is None or self._ways.stamp_ns != stamp_ns:
            later, before = self._quotient(0, stamp_ns), self._quotient(1, self.last.stamp_ns)
            ways = [self.last.H]
            if _is_steady(later):
                known = self.sightings if _is_steady(before) else self.sightings[:2]
                evenly = _is_one(later) and (len(known) < 3 or _is_one(before))
                with contextlib.suppress(DegenerateConfiguration):
                    ways += _led_on_evenly(known) if evenly else _led_on_unevenly(known, stamp_ns, target)
            self._ways = _MotionHypotheses(stamp_ns, _facing(ways, target))
        return self._ways

    def _quotient(self, index: int, stamp_ns: int) -> float:
        """Return the time from a sighting to `stamp_ns` over that from the sighting before it; 0 where none was."""
        if index + 1 >= len(self.sightings):
            return 0.0
        later, earlier = self.sightings[index].stamp_ns, self.sightings[index + 1].stamp_ns
        return (stamp_ns - later) / (later - earlier) if later > earlier else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Expected:
    """Where a target is expected: H_image_template, ideal px, and how wrong its corners may be, px; None: unknown."""

    H: Matrix3
    wrong_px: float | None


def _is_steady(quotient: float) -> bool:
    return _STEADY[0] <= quotient <= _STEADY[1]


def _is_one(quotient: float) -> bool:
    return abs(quotient - 1) <= _SAME


def _growth(order: int, quotient: float) -> float:
    """Return by how much an extrapolation of an order is more wrong after `quotient` intervals than after one."""
    return math.prod((quotient + k) / (1 + k) for k in range(order + 1)) if quotient > 0 else 1.0


def _led_on_evenly(sightings: Sequence[Observation]) -> list[Matrix3]:
    """Return where a motion leads that goes on and, of three sightings, one that goes on to change.

    Raises
    ------
    DegenerateConfiguration
        If a sighting is no homography.
    """
    last, *earlier = (sighting.H for sighting in sightings)
    back = inverse3(earlier[0])
    motion = last @ back
    ways = [motion @ last]
    if len(earlier) > 1:
        # By what the motion differs from the one before.
        ways.append(motion @ earlier[1] @ back @ ways[0])
    return ways


def _led_on_unevenly(sightings: Sequence[Observation], stamp_ns: int, target: Reference) -> list[Matrix3]:
    """Return the same when intervals differ.

    A homography's logarithm is to its motion what a velocity is to a distance.

    Raises
    ------
    DegenerateConfiguration
        If a motion has none: it turns the image by half a circle, or is no motion.
    """
    to_unit = _to_unit(sightings[0].H, target)
    last = _velocity(sightings[0], sightings[1], to_unit)
    interval = float(sightings[0].stamp_ns - sightings[1].stamp_ns)
    later = float(stamp_ns - sightings[0].stamp_ns)
    velocities = [last]
    if len(sightings) > 2:
        # Each is that of the middle of its interval.
        mean = float(sightings[0].stamp_ns - sightings[2].stamp_ns) / 2
        change = last - _velocity(sightings[1], sightings[2], to_unit)
        velocities.append(last + change * ((interval + later) / 2 / mean))
    on, from_unit = to_unit @ sightings[0].H, inverse3(to_unit)
    return [from_unit @ exponential(velocity * later) @ on for velocity in velocities]


def _to_unit(H: Matrix3, target: Reference) -> Matrix3:
    """Return the similarity of the picture that centres the target's corners and makes them a unit distant."""
    corners = _corners(H[None], target)[0]
    x, y = corners.mean(axis=1)
    scale = 1 / max(float(np.hypot(corners[0] - x, corners[1] - y).mean()), _SMALLEST_PX)
    return np.array([[scale, 0, -scale * x], [0, scale, -scale * y], [0, 0, 1]])


def _velocity(later: Observation, earlier: Observation, to_unit: Matrix3) -> Matrix3:
    """Return the logarithm of the image's motion between two sightings, for each nanosecond.

    Raises
    ------
    DegenerateConfiguration
        If the motion has none: it turns the image by half a circle, or is no motion.
    """
    motion = to_unit @ later.H @ inverse3(to_unit @ earlier.H)
    return logarithm(motion) / (later.stamp_ns - earlier.stamp_ns)


@dataclass(frozen=True, slots=True, eq=False)
class _MotionHypotheses:
    """Where sightings lead to at a time: one to three H_image_template, the ways of `Track` in their order."""

    stamp_ns: int
    ways: tuple[Matrix3, ...]


def _facing(ways: Sequence[Matrix3], target: Reference) -> tuple[Matrix3, ...]:
    """Return the first one, and of the others as many as show the target's front, at unit norm."""
    facing = [ways[0]]
    for H in ways[1:]:
        size = math.sqrt(float(np.vdot(H, H)))
        if not (0 < size < math.inf and (H[2] @ target.outline_homogeneous).min() > 0):
            break
        facing.append(H / size)
    return tuple(facing)


def _corners(homographies: Floats, target: Reference) -> Floats:
    """Return the outline's corners as homographies (N, 3, 3) map them, (N, 2, 4)."""
    mapped = homographies @ target.outline_homogeneous
    return np.asarray(mapped[:, :2] / mapped[:, 2:])
