# SPDX-License-Identifier: Apache-2.0
"""Following a reference from frame to frame: predict, align, and decide whether the track holds."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from imgu_ros.config.parameters import RefinementParameters
from imgu_ros.errors import DegenerateConfiguration, EstimationError, NoConsensus
from imgu_ros.image.frame_image import FrameImage
from imgu_ros.pose.planar_pose import distorting_camera, require_determined, require_plausible
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.verification import require_confirmed
from imgu_ros.result import ReferenceMatches, ReferenceResult, SampledPatches, Status
from imgu_ros.track.known_patches import align_known, are_known
from imgu_ros.track.patch_alignment import align_patches
from imgu_ros.track.sample_refinement import FrameHints, Observation, PatchAlignment
from imgu_ros.track.shift_search import shifted_homography
from imgu_ros.types import Floats, Matrix3
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.matching.matches import Matches
from imgu_ros.vision.projective.logarithm import exponential, logarithm
from imgu_ros.vision.projective.transform import inverse3

#: Share of the patches that must agree for a track to hold. Measured: benchmarks/thresholds.py, study tracking.
_HELD_SHARE = 0.25
#: Largest RMS residual of a track that holds, px of the level. Measured: benchmarks/thresholds.py, study tracking.
_HELD_RMS_PX = 0.5
#: The next prediction may be wrong by this factor times the last prediction error. Measured: benchmarks/thresholds.py,
#: study reach.
_SURPRISE = 1.5
#: Smallest prediction error allowed for, raw px. Measured: benchmarks/thresholds.py, study reach.
_LEAST_REACH_PX = 2.0
#: Prediction error allowed for when no motion is known, raw px. Measured: benchmarks/thresholds.py, study reach.
_UNKNOWN_REACH_PX = 24.0
#: Patches that are known bridge a longer error after a search for a shift, raw px.
_SHIFTED_PX = 6.0
#: Longest shift that is searched, as a share of the frame's width. Measured: benchmarks/thresholds.py, study reach.
_LONGEST_SHIFT = 0.1
#: Range of the ratio of two frame intervals within which the motion is extrapolated; outside, the last position is
#: used. Measured: benchmarks/thresholds.py, study reach.
_STEADY = (0.2, 5.0)
#: Intervals that differ by less than this share count as equal. Measured: benchmarks/thresholds.py, study reach.
_SAME = 0.1
#: Smallest mean distance of the corners from their centre, px: below any reference in view; prevents a division by
#: zero.
_SMALLEST_PX = 1e-6
#: Number of observations kept: constant acceleration needs three.
_MOST_OBSERVATIONS = 3
#: Share of the last prediction error that is still expected in the next frame. Measured: benchmarks/thresholds.py,
#: study reach.
_MEMORY = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """A reference where its track led, and the share of it in view that looks as it should."""

    alignment: PatchAlignment
    confirmed_share: float


def followed_result(reference: Reference, followed: Followed, status: Status) -> ReferenceResult:
    """Return the result of a reference that was followed: its matches are the aligned patches, which all agree."""
    alignment = followed.alignment
    count = len(alignment.template_xy)
    matches = ReferenceMatches(_no_keypoints(count), alignment.template_xy, alignment.image_xy, np.ones(count, bool))
    return ReferenceResult(
        reference.name,
        reference.number,
        status,
        matches=matches,
        confirmed_share=followed.confirmed_share,
        sampled=alignment.sampled,
    )


@lru_cache(maxsize=256)
def _no_keypoints(count: int) -> Matches:
    """Return `count` matches that name no keypoints."""
    none, distance = np.full(count, -1, np.intp), np.zeros(count)
    none.flags.writeable = distance.flags.writeable = False  # in many results
    return Matches(none, none, distance)


def follow(
    reference: Reference,
    track: Track,
    frame: FrameImage,
    stamp_ns: int,
    camera: Camera | None,
    parameters: RefinementParameters,
    min_inliers: int,
) -> Followed:
    """Find a reference where its track leads.

    Parameters
    ----------
    reference, track : the reference, and its last observations
    frame, stamp_ns : the frame's image and time
    camera : intrinsics, or None
    parameters : those of the alignment
    min_inliers : patches that must agree

    Raises
    ------
    EstimationError
        If the track does not hold.
    """
    reason = "track: lost"
    lens = distorting_camera(camera)
    sampled = track.sampled
    hints = FrameHints(None if sampled is None else sampled.spread, stamp_ns, track.observations)
    # How rows move is told by where the reference is: that has to be known better than by a prediction.
    known = sampled if frame.row_time_ns == 0 else None
    for start in _starts(track, reference, stamp_ns, frame.shape[1], known):
        try:
            H = shifted_homography(frame, reference, start.H, lens, start.shift_px) if start.shift_px else start.H
            if start.known is None:
                alignment = align_patches(frame, reference, H, lens, parameters, min_inliers, start.reach_px, hints)
            else:
                alignment = align_known(
                    frame, reference, H, lens, start.known, parameters, min_inliers, start.reach_px, hints
                )
            rms_px = alignment.homography.rms_px / 2**alignment.halvings
            if alignment.agreeing_share < _HELD_SHARE or rms_px > _HELD_RMS_PX:
                raise NoConsensus(
                    f"track: {len(alignment.template_xy)} of {alignment.sought} patches agree, rms {rms_px:.2f} px; "
                    f"need {_HELD_SHARE:.0%} and {_HELD_RMS_PX:g} px"
                )
            require_plausible(reference.plane, alignment.homography)
            seen = alignment.homography.H if alignment.H_seen is None else alignment.H_seen
            found = require_confirmed(frame, reference, seen, lens)
            require_determined(reference.plane, alignment, found.is_covered)
        except EstimationError as error:
            reason = str(error)
        else:
            return Followed(alignment, found.share)
    raise NoConsensus(reason)


@dataclass(frozen=True, slots=True, eq=False)
class _Start:
    """Start of an alignment: H with an error up to `reach_px`, after a search for shifts up to `shift_px`; raw px.

    With patches that are known, see `align_known`, or others.
    """

    H: Matrix3
    reach_px: float
    shift_px: float = 0.0
    known: SampledPatches | None = None


def _starts(
    track: Track, reference: Reference, stamp_ns: int, width: int, known: SampledPatches | None
) -> Iterator[_Start]:
    """Yield starts: the prediction, the same with larger errors, then the last observation, each also with a shift."""
    expected, last = track.expected(reference, stamp_ns), track.last.H
    reach = _UNKNOWN_REACH_PX
    if expected.error_px is not None:
        surprise = _SURPRISE * expected.error_px
        if known is not None and are_known(known):
            far = surprise > _SHIFTED_PX
            yield _Start(expected.H, min(surprise, _SHIFTED_PX), min(surprise, reach) if far else 0.0, known)
        reach = min(max(surprise, _LEAST_REACH_PX), reach)
    yield _Start(expected.H, reach)
    if reach < _UNKNOWN_REACH_PX:
        yield _Start(expected.H, _UNKNOWN_REACH_PX)
    # A motion that ends or reverses leaves the reference near its last position.
    if expected.H is not last:
        yield _Start(last, _UNKNOWN_REACH_PX)
    shift = max(_LONGEST_SHIFT * width, _UNKNOWN_REACH_PX)
    yield _Start(expected.H, _UNKNOWN_REACH_PX, shift)
    if expected.H is not last:
        yield _Start(last, _UNKNOWN_REACH_PX, shift)


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Where a reference is expected: H_image_template, ideal px, and the error of its corners, px; None: unknown."""

    H: Matrix3
    error_px: float | None


class Track:
    """The last observations of a reference, and the errors of the predictions from them.

    The motion hypotheses are: no motion (from one observation), constant velocity (two), constant acceleration (three).
    A camera at rest, a hand-held one and one on a machine differ in which predicts best: that with the lowest recent
    error is used.

    Parameters
    ----------
    observations : latest first, one to three
    errors_px : of each hypothesis, in this order, the recent error of the outline's corners after an interval as long
        as the last one; empty: no prediction was compared with an observation yet
    sampled : patches that were compared with the raw samples of the last frame; None: none were
    alike : motions (3, 3) of the template after which the reference looks the same

    Attributes
    ----------
    last : the latest observation
    """

    def __init__(
        self,
        observations: Sequence[Observation],
        errors_px: Sequence[float] = (),
        sampled: SampledPatches | None = None,
        alike: tuple[Matrix3, ...] = (),
    ) -> None:
        self.alike = alike
        self.observations = tuple(observations)[:_MOST_OBSERVATIONS]
        self.errors_px = tuple(errors_px)
        self.sampled = sampled
        self.last = self.observations[0]
        # The last prediction: its time, H_image_template by each hypothesis, and the factors by which their errors grow
        # with the interval.
        self._predicted_ns: int | None = None
        self._hypotheses: list[Matrix3] = []
        self._growth: tuple[float, ...] = ()

    def without_patches(self) -> Track:
        """Return the track without what was compared with the samples."""
        return Track(self.observations, self.errors_px, alike=self.alike)

    def continued(
        self,
        reference: Reference,
        H: Matrix3,
        stamp_ns: int,
        sampled: SampledPatches | None = None,
        alike: tuple[Matrix3, ...] = (),
    ) -> Track:
        """Return the track with one more observation, the patches that were compared with its samples, and `alike`."""
        observations = (Observation(H, stamp_ns), *self.observations)
        if len(self.observations) == 1:
            return Track(observations, sampled=sampled, alike=alike)
        self._predict(reference, stamp_ns)
        xy = _corners(np.array((H, *self._hypotheses)), reference)
        away = xy[1:] - xy[0]
        distances = np.sqrt((away**2).sum(axis=1).max(axis=1)).tolist()
        # As they would have been after an interval as long as the one before.
        errors = [px / max(growth, 1.0) for px, growth in zip(distances, self._growth, strict=False)]
        # A small error by chance is forgotten sooner than a large one.
        before = [*self.errors_px, 0.0, 0.0, 0.0][: len(errors)]
        expected = [max(new, _MEMORY * old) for new, old in zip(errors, before, strict=True)]
        return Track(observations, expected, sampled, alike)

    def expected(self, reference: Reference, stamp_ns: int) -> Prediction:
        """Return where the reference is expected at a time."""
        self._predict(reference, stamp_ns)
        hypotheses = self._hypotheses
        if not self.errors_px:
            return Prediction(hypotheses[min(1, len(hypotheses) - 1)], None)
        errors = [px * growth for px, growth in zip(self.errors_px[: len(hypotheses)], self._growth, strict=False)]
        best = errors.index(min(errors))
        return Prediction(hypotheses[best], errors[best])

    def _predict(self, reference: Reference, stamp_ns: int) -> None:
        """Extrapolate the observations to a time, by each hypothesis."""
        if self._predicted_ns == stamp_ns:
            return
        known = self.observations
        stamps = [observation.stamp_ns for observation in known]
        # Intervals over the ones before them; 0 where there are none.
        later = (stamp_ns - stamps[0]) / (stamps[0] - stamps[1]) if len(known) > 1 and stamps[0] > stamps[1] else 0.0
        before = (stamps[0] - stamps[1]) / (stamps[1] - stamps[2]) if len(known) > 2 and stamps[1] > stamps[2] else 0.0
        hypotheses = [self.last.H]
        if _STEADY[0] <= later <= _STEADY[1]:
            if not _STEADY[0] <= before <= _STEADY[1]:
                known = known[:2]
            is_even = abs(later - 1) <= _SAME and (len(known) < 3 or abs(before - 1) <= _SAME)
            with contextlib.suppress(DegenerateConfiguration):
                extrapolated = _evenly(known) if is_even else _unevenly(known, stamp_ns, reference)
                outline = reference.outline_homogeneous
                for H in extrapolated:
                    size = math.sqrt(float(np.vdot(H, H)))
                    # Only views of the reference's front.
                    if not (0 < size < math.inf and (H[2] @ outline).min() > 0):
                        break
                    hypotheses.append(H / size)
        # An extrapolation of order k has an error proportional to q (q + 1) ... (q + k), q: the ratio of the intervals.
        self._growth = (1.0, 1.0, 1.0)
        if later > 0:
            linear = later * ((later + 1) / 2)
            self._growth = (later, linear, linear * ((later + 2) / 3))
        self._hypotheses, self._predicted_ns = hypotheses, stamp_ns


def _evenly(observations: Sequence[Observation]) -> list[Matrix3]:
    """Return the positions of constant velocity and, of three observations, of constant acceleration; even intervals.

    Raises
    ------
    DegenerateConfiguration
        If an observation is no homography.
    """
    last = observations[0].H
    regular, back = cv2.invert(observations[1].H)
    if not regular or not math.isfinite(np.vdot(back, back)):
        raise DegenerateConfiguration("H: singular; need a homography")
    motion = last @ back
    extrapolated = [motion @ last]
    if len(observations) > 2:
        # The change of the motion from the one before.
        extrapolated.append(motion @ observations[2].H @ back @ extrapolated[0])
    return extrapolated


def _unevenly(observations: Sequence[Observation], stamp_ns: int, reference: Reference) -> list[Matrix3]:
    """Return the same when intervals differ, by the logarithm of the motion: a velocity times a time.

    Raises
    ------
    DegenerateConfiguration
        If a motion has no logarithm: it turns the image by half a circle, or is no motion.
    """
    # The similarity of the image that centres the corners and makes their mean distance from the centre a unit.
    corners = _corners(observations[0].H[None], reference)[0]
    x, y = corners.mean(axis=1)
    scale = 1 / max(float(np.hypot(corners[0] - x, corners[1] - y).mean()), _SMALLEST_PX)
    to_unit = np.array([[scale, 0, -scale * x], [0, scale, -scale * y], [0, 0, 1]])
    last = _velocity(observations[0], observations[1], to_unit)
    interval = float(observations[0].stamp_ns - observations[1].stamp_ns)
    later = float(stamp_ns - observations[0].stamp_ns)
    velocities = [last]
    if len(observations) > 2:
        # Each is that in the middle of its interval.
        mean = float(observations[0].stamp_ns - observations[2].stamp_ns) / 2
        change = last - _velocity(observations[1], observations[2], to_unit)
        velocities.append(last + change * ((interval + later) / 2 / mean))
    on, from_unit = to_unit @ observations[0].H, inverse3(to_unit)
    return [from_unit @ exponential(velocity * later) @ on for velocity in velocities]


def _velocity(later: Observation, earlier: Observation, to_unit: Matrix3) -> Matrix3:
    """Return the logarithm of the image's motion between two observations, per nanosecond.

    Raises
    ------
    DegenerateConfiguration
        If the motion has none: it turns the image by half a circle, or is no motion.
    """
    motion = to_unit @ later.H @ inverse3(to_unit @ earlier.H)
    return logarithm(motion) / (later.stamp_ns - earlier.stamp_ns)


def _corners(homographies: Floats, reference: Reference) -> Floats:
    """Return the outline's corners as homographies (N, 3, 3) map them, (N, 2, 4)."""
    mapped = homographies @ reference.outline_homogeneous
    return np.asarray(mapped[:, :2] / mapped[:, 2:])
