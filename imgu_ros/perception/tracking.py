"""Following a target from frame to frame: predict, align, and say whether it holds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import zip_longest

import cv2
import numpy as np
from scipy.linalg import fractional_matrix_power

from imgu_ros.errors import EstimationError, NoConsensus
from imgu_ros.params import Parameters
from imgu_ros.perception.confirming import require_confirmed
from imgu_ros.perception.pictures import Pictures
from imgu_ros.perception.posing import Located, bending, require_plausible
from imgu_ros.perception.refinement import Alignment, refine_by_alignment
from imgu_ros.perception.shift_search import shifted_homography
from imgu_ros.perception.targets import Target
from imgu_ros.types import Floats, Matrix3
from imgu_ros.vision.camera.intrinsics import Camera

#: Of the patches sought, the share that must agree for a track to hold.
_HELD_SHARE = 0.25
_HELD_RMS_PX = 0.5
#: Between these quotients of two intervals the motion goes on, by as much more or less; else the target is looked for
#: where it was. Intervals that differ by less than this share are the same.
_STEADY = (0.2, 5.0)
_SAME = 0.1
_MOST_SIGHTINGS = 3
#: What is left of a surprise in the next frame.
_MEMORY = 0.5
#: A prediction may be wrong by this many times as much as the one before it was, and by this much at least, raw px.
_SURPRISE = 1.5
_LEAST_REACH_PX = 2.0
#: What is to be aligned when no motion is known, raw px, and the longest shift before it, a share of the frame's width.
_UNKNOWN_REACH_PX = 24.0
_LONGEST_SHIFT = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
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
    surprises_px : of each way, in this order, the largest distance of the outline's corners from where it led, lately;
        empty: no prediction was compared with a sighting yet
    """

    def __init__(self, sightings: Sequence[Sighting], surprises_px: Sequence[float] = ()) -> None:
        self.sightings = tuple(sightings)[:_MOST_SIGHTINGS]
        self.surprises_px = tuple(surprises_px)
        self._expected: _Expected | None = None

    @property
    def last(self) -> Sighting:
        """The latest sighting."""
        return self.sightings[0]

    @property
    def surprise_px(self) -> float | None:
        """How wrong the way that served best was lately; None: not known yet."""
        return min(self.surprises_px) if self.surprises_px else None

    def continued(self, target: Target, H: Matrix3, stamp_ns: int) -> Track:
        """Return the track with one more sighting."""
        sightings = (Sighting(H, stamp_ns), *self.sightings)
        if len(self.sightings) == 1:
            return Track(sightings)
        expected = self._led_on(target, stamp_ns)
        xy = _corners(np.stack((H, *expected.ways)), target)
        away = xy[1:] - xy[0]
        surprises = np.sqrt((away**2).sum(axis=1).max(axis=1)).tolist()
        # One lucky hit is forgotten sooner than a miss.
        kept = zip_longest(surprises, self.surprises_px[: len(surprises)], fillvalue=0.0)
        return Track(sightings, tuple(max(new, _MEMORY * old) for new, old in kept))

    def predicted(self, target: Target, stamp_ns: int) -> Matrix3:
        """Return where the target is expected: (3, 3) H_image_template in ideal px."""
        ways = self._led_on(target, stamp_ns).ways
        if not self.surprises_px:
            return ways[min(1, len(ways) - 1)]
        told = self.surprises_px[: len(ways)]
        return ways[told.index(min(told))]

    def _led_on(self, target: Target, stamp_ns: int) -> _Expected:
        """Return what the sightings lead to expect."""
        if self._expected is None or self._expected.stamp_ns != stamp_ns:
            ways = [self.last.H]
            later, now = self._quotient(0, stamp_ns), self._quotient(1, self.last.stamp_ns)
            if _STEADY[0] <= later <= _STEADY[1]:
                # Of three rows, OpenCV is five times as fast as numpy.
                regular, back = cv2.invert(self.sightings[1].H)
                if regular:
                    # The motion of the image, H2 H1^-1, and by what it differs from the one before, H1 H0^-1.
                    motion = self.last.H @ back
                    ways.append(_power(motion, later) @ self.last.H)
                    if _is_one(later) and _is_one(now):
                        change = motion @ self.sightings[2].H @ back
                        ways.append(change @ ways[1])
            self._expected = _Expected(stamp_ns, _facing(ways, target))
        return self._expected

    def _quotient(self, index: int, stamp_ns: int) -> float:
        """Return the time from a sighting to `stamp_ns` over that from the sighting before it; 0 where none was."""
        if index + 1 >= len(self.sightings):
            return 0.0
        later, earlier = self.sightings[index].stamp_ns, self.sightings[index + 1].stamp_ns
        return (stamp_ns - later) / (later - earlier) if later > earlier else 0.0


def _is_one(quotient: float) -> bool:
    return abs(quotient - 1) <= _SAME


def _power(motion: Matrix3, exponent: float) -> Matrix3:
    """Return the homography that does so much of a motion: that of `exponent` times as long."""
    if _is_one(exponent):
        return motion
    det = cv2.determinant(motion)
    if not (0 < det < math.inf):
        return motion
    powered = fractional_matrix_power(motion / det ** (1 / 3), exponent)
    # A turn by half a circle and more has no part that is real.
    return np.asarray(powered.real, np.float64) if np.isfinite(powered).all() else motion


@dataclass(frozen=True, slots=True, eq=False)
class _Expected:
    """Where sightings lead to at a time: one to three H_image_template, the ways of `Track` in their order."""

    stamp_ns: int
    ways: tuple[Matrix3, ...]


def _facing(ways: Sequence[Matrix3], target: Target) -> tuple[Matrix3, ...]:
    """Return the first one, and of the others as many as show the target's front, at unit norm."""
    facing = [ways[0]]
    for H in ways[1:]:
        size = math.sqrt(float(np.vdot(H, H)))
        if not (0 < size < math.inf and (H[2] @ target.outline_homogeneous).min() > 0):
            break
        facing.append(H / size)
    return tuple(facing)


def _corners(homographies: Floats, target: Target) -> Floats:
    """Return the outline's corners as homographies (N, 3, 3) map them, (N, 2, 4)."""
    mapped = homographies @ target.outline_homogeneous
    return np.asarray(mapped[:, :2] / mapped[:, 2:])


def follow(
    target: Target, track: Track, pictures: Pictures, stamp_ns: int, camera: Camera | None, parameters: Parameters
) -> Alignment:
    """Find a target where its track leads.

    Parameters
    ----------
    target, track : what is followed, and from where
    pictures : the frame's
    stamp_ns : the frame's
    camera : intrinsics, or None
    parameters : all parameters

    Raises
    ------
    EstimationError
        If the track does not hold.
    """
    reason = "track: lost"
    lens = bending(camera)
    for start in _starts(track, target, stamp_ns, pictures.shape[1]):
        try:
            H = shifted_homography(pictures, target, start.H, lens, start.shift_px) if start.shift_px else start.H
            alignment = refine_by_alignment(
                pictures,
                target,
                H,
                lens,
                parameters.refinement,
                parameters.homography.min_inliers,
                start.reach_px,
            )
            _require_held(alignment)
            require_plausible(target, alignment.homography)
            if alignment.halvings:
                # Coarse patches agree by chance sooner: the whole target must look as it should.
                require_confirmed(pictures, target, alignment.homography.H, lens)
        except EstimationError as error:
            reason = str(error)
        else:
            return alignment
    raise NoConsensus(reason)


def located(alignment: Alignment) -> Located:
    """Return the place that an alignment tells."""
    return Located(alignment.template_xy, alignment.image_xy, alignment.homography, alignment.condensed)


def _require_held(alignment: Alignment) -> None:
    held, rms_px = len(alignment.template_xy), alignment.homography.rms_px / 2**alignment.halvings
    if held < _HELD_SHARE * alignment.sought or rms_px > _HELD_RMS_PX:
        raise NoConsensus(
            f"track: {held} of {alignment.sought} patches agree, rms {rms_px:.2f} px; "
            f"need {_HELD_SHARE:.0%} and {_HELD_RMS_PX:g} px"
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Start:
    """Where to look: from H, by alignment that bridges `reach_px`, after any shift up to `shift_px`; raw px."""

    H: Matrix3
    reach_px: float
    shift_px: float = 0.0


def _starts(track: Track, target: Target, stamp_ns: int, width: int) -> list[_Start]:
    """Return where to look: near where the motion leads, then farther around, then where the target was last."""
    predicted = track.predicted(target, stamp_ns)
    shift = max(_LONGEST_SHIFT * width, _UNKNOWN_REACH_PX)
    reach = _UNKNOWN_REACH_PX
    if track.surprise_px is not None:
        reach = min(max(_SURPRISE * track.surprise_px, _LEAST_REACH_PX), reach)
    starts = [_Start(predicted, reach), _Start(predicted, _UNKNOWN_REACH_PX, shift)]
    if predicted is not track.last.H:
        # A motion that ends or turns back leaves the target near where it was.
        starts.insert(1, _Start(track.last.H, _UNKNOWN_REACH_PX))
        starts.append(_Start(track.last.H, _UNKNOWN_REACH_PX, shift))
    return starts
