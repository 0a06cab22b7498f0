# SPDX-License-Identifier: Apache-2.0
"""The chain: one frame in, one result out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imgu_ros.errors import EstimationError, ImguError
from imgu_ros.params import Parameters
from imgu_ros.perception.calibration_check import CalibrationCheck
from imgu_ros.perception.clock import StageClock
from imgu_ros.perception.develop import Developed
from imgu_ros.perception.development import Development, develop_frame
from imgu_ros.perception.features import find_features
from imgu_ros.perception.frame import Frame
from imgu_ros.perception.frame_times import FrameTimes
from imgu_ros.perception.parts import Parts
from imgu_ros.perception.pictures import Pictures
from imgu_ros.perception.posing import posed
from imgu_ros.perception.prediction import Sighting, Track
from imgu_ros.perception.reasons import NOT_DUE, UNLIKELY, unusable_frame
from imgu_ros.perception.refinement import Alignment
from imgu_ros.perception.result import Result, Stage, Status, TargetMatches, TargetResult
from imgu_ros.perception.seeking import Seeker, View
from imgu_ros.perception.targets import Target
from imgu_ros.perception.tracking import follow, located
from imgu_ros.vision.matching.matches import Matches

#: While one target is tracked, every so many searches for a few missing ones are thorough.
_THOROUGH_EVERY = 6
#: Sightings farther apart tell nothing about how a target moves.
_STEADY_NS = 500_000_000
#: Stamps that jump back by more belong to another recording, or to the same one played again.
JUMP_NS = 1_000_000_000


class Chain:
    """From raw frames to poses of known targets.

    Frames are expected in the order of time; the tracker remembers where targets were. Stamps that jump back by more
    than a second (a recording played in a loop) make it forget: the frames that follow are those of a new chain. A
    single stamp of 0 among others is none: the tracks go on after it. Where stamps do not rise, frames count as evenly
    spaced.

    Parameters
    ----------
    parameters : all parameters
    targets : prepared with the same parameters
    parts : takes what is made; what was made before of the same targets is used again
    """

    def __init__(self, parameters: Parameters, targets: Sequence[Target], parts: Parts | None = None) -> None:
        self._parameters = parameters
        self._targets = tuple(targets)
        self._calibration = CalibrationCheck()
        self._seeker = Seeker(self._targets, parameters, parts)
        self._tracks: list[Track | None] = []
        self._seen: list[Sighting | None] = []
        self._frames_without_search = 0
        self._searches = 0
        self._last_ns: int | None = None
        self._times = FrameTimes()
        self._now_ns = 0
        self._before_zero: _Memory | None = None
        self.reset()

    @property
    def targets(self) -> tuple[Target, ...]:
        """The known targets."""
        return self._targets

    def prepare(self) -> None:
        """Make what some frame would have to wait for, some tenths of a second for each target."""
        self._seeker.prepare()
        # What the frames are is not known yet: raw ones are the likeliest.
        for target in self._targets:
            target.prepare(linear=self._parameters.raw.transfer != "srgb")

    def reset(self) -> None:
        """Forget all that earlier frames told."""
        self._tracks = [None] * len(self._targets)
        self._seen = [None] * len(self._targets)
        self._frames_without_search = 0
        self._searches = 0
        self._last_ns = None
        self._times = FrameTimes()
        self._before_zero = None
        self._calibration = CalibrationCheck()

    def continue_from(self, before: Chain) -> None:
        """Go on where another chain stands: tracks of targets that both know by name and picture go on.

        Tracks are of the template's px: they hold whatever the targets' widths and all parameters are. So does what was
        seen of the calibration, until the camera changes.
        """
        self.reset()
        self._last_ns = before._last_ns
        self._times = before._times
        self._calibration = before._calibration
        if not self._parameters.tracking.enabled:
            return
        self._frames_without_search, self._searches = before._frames_without_search, before._searches
        known = {target.name: index for index, target in enumerate(before._targets)}
        for index, target in enumerate(self._targets):
            at = known.get(target.name)
            if at is not None and target.image.shows_the_same(before._targets[at].image):
                self._tracks[index], self._seen[index] = before._tracks[at], before._seen[at]

    def process(self, frame: Frame, with_keypoints: bool = False, development: Development | None = None) -> Result:
        """Work on one frame.

        A frame that the chain cannot work on is rejected in the result, with the reason; nothing is raised for it.

        Parameters
        ----------
        frame : what to work on
        with_keypoints : make pyramid, keypoints and descriptors even when all targets are tracked without them
        development : of this frame, with the chain's parameters, when it was made ahead (see `develop_frame`)
        """
        self._look_at_stamp(frame.stamp_ns)
        self._now_ns = self._times.of(frame.stamp_ns)
        development = development or develop_frame(frame, self._parameters)
        clock = StageClock()
        clock.times_ns[Stage.DEVELOP] = development.took_ns
        start = time.perf_counter_ns() - development.took_ns
        reason = development.reason
        if development.developed is not None:
            try:
                return self._worked(frame, development.developed, with_keypoints, clock, start)
            except ImguError as error:
                reason = str(error)
        return Result(
            frame,
            rejected_targets(self._targets, reason),
            reason=reason,
            times_ns=clock.times_ns,
            total_ns=time.perf_counter_ns() - start,
        )

    def _look_at_stamp(self, stamp_ns: int) -> None:
        """Forget what was before a jump back in time, or remember what was before a frame without a stamp."""
        before, last_ns = self._before_zero, self._last_ns
        self._before_zero = None
        if last_ns is not None and stamp_ns < last_ns - JUMP_NS:
            memory = _Memory(last_ns, self._times, self._tracks, self._seen, self._calibration)
            self.reset()
            if stamp_ns == 0:
                self._before_zero = memory
        elif before is not None and stamp_ns >= before.last_ns - JUMP_NS:
            self._times, self._tracks, self._seen = before.times, before.tracks, before.seen
            self._calibration = before.calibration
        self._last_ns = stamp_ns

    def _worked(
        self, frame: Frame, developed: Developed, with_keypoints: bool, clock: StageClock, start: int
    ) -> Result:
        pictures = Pictures(developed)
        results: list[TargetResult | None] = [
            self._followed(index, frame, pictures, clock) for index in range(len(self._targets))
        ]
        missing = [index for index, result in enumerate(results) if result is None]
        due = self._search_is_due(missing)
        features = find_features(pictures, self._parameters, clock) if due or with_keypoints else None
        if features is not None and due:
            covered = [result.outline for result in results if result is not None and result.outline is not None]
            view = View(frame, pictures, features, covered)
            self._searches += 1
            thorough = self._searches % _THOROUGH_EVERY == 0
            for result in self._seeker.seek(view, missing, clock, thorough):
                results[result.index] = result
        targets = tuple(
            result or TargetResult(target.name, index, Status.LOST, reason=UNLIKELY if due else NOT_DUE)
            for index, (target, result) in enumerate(zip(self._targets, results, strict=True))
        )
        self._frames_without_search = 0 if due or not missing else self._frames_without_search + 1
        self._remember(targets)
        targets = self._calibration.examined(frame.camera, targets)
        return Result(
            frame=frame,
            targets=targets,
            developed=developed,
            pyramid=features.pyramid if features else None,
            keypoints=features.described.keypoints if features else None,
            descriptors=features.described.descriptors if features else None,
            calibration=None if frame.camera is None else self._calibration.finding,
            times_ns=clock.times_ns,
            total_ns=time.perf_counter_ns() - start,
        )

    def _followed(self, index: int, frame: Frame, pictures: Pictures, clock: StageClock) -> TargetResult | None:
        """Return the target where its track leads; None when there is no track or it does not hold."""
        track, target, p = self._tracks[index], self._targets[index], self._parameters
        if track is None:
            return None
        try:
            with clock.measures(Stage.REFINE):
                alignment = follow(target, track, pictures, self._now_ns, frame.camera, p)
        except EstimationError:
            return None
        found = TargetResult(
            target.name,
            index,
            Status.TRACKED,
            matches=_as_matches(alignment),
            confirmed_share=alignment.agreeing_share,
        )
        with clock.measures(Stage.POSE):
            return posed(found, target, located(alignment), frame.camera, p, frame.camera_reason, self._calibration)

    def _search_is_due(self, missing: Sequence[int]) -> bool:
        """Whether missing targets are to be looked for: at once when one was just lost or none is in view."""
        if not missing:
            return False
        just_lost = any(self._tracks[index] is not None for index in missing)
        none_in_view = len(missing) == len(self._targets)
        return just_lost or none_in_view or self._frames_without_search + 1 >= self._parameters.tracking.search_every

    def _remember(self, targets: Sequence[TargetResult]) -> None:
        if not self._parameters.tracking.enabled:
            return
        for result in targets:
            track = self._tracks[result.index]
            if result.homography is None:
                self._tracks[result.index] = None
                continue
            if track is None or result.status is Status.DETECTED:
                sighting = Sighting(result.homography.H, self._now_ns)
                self._tracks[result.index] = Track([sighting, *self._shortly_before(result.index)])
            else:
                target = self._targets[result.index]
                self._tracks[result.index] = track.continued(target, result.homography.H, self._now_ns)
            self._seen[result.index] = Sighting(result.homography.H, self._now_ns)

    def _shortly_before(self, index: int) -> list[Sighting]:
        """Return where a target was seen last, when that is no longer ago than it can move on steadily.

        A target that moves fast has moved far when it was detected: two detections tell where it will be.
        """
        seen = self._seen[index]
        return [seen] if seen is not None and 0 < self._now_ns - seen.stamp_ns <= _STEADY_NS else []


@dataclass(frozen=True, slots=True, eq=False)
class _Memory:
    """What a chain knew before a frame without a stamp."""

    last_ns: int
    times: FrameTimes
    tracks: list[Track | None]
    seen: list[Sighting | None]
    calibration: CalibrationCheck


def rejected_targets(targets: Sequence[Target], reason: str) -> tuple[TargetResult, ...]:
    """Return what is said of each target in a frame that cannot be used, for `reason`."""
    words = unusable_frame(reason)
    return tuple(TargetResult(target.name, i, Status.REJECTED, reason=words) for i, target in enumerate(targets))


def _as_matches(alignment: Alignment) -> TargetMatches:
    """Return the aligned patches as matches: they have no keypoints, and all agree."""
    count = len(alignment.template_xy)
    none = np.full(count, -1, np.intp)
    return TargetMatches(
        Matches(none, none, np.zeros(count)), alignment.template_xy, alignment.image_xy, np.ones(count, bool)
    )
