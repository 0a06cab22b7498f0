# SPDX-License-Identifier: Apache-2.0
"""The chain: one frame in, one result out."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imgu_ros.build_cache import BuildCache
from imgu_ros.config.components import DevelopmentParameters
from imgu_ros.config.parameters import Parameters
from imgu_ros.detect.detector import ReferenceDetector, View
from imgu_ros.errors import EstimationError, ImguError
from imgu_ros.frame import Frame
from imgu_ros.image.development import Developed
from imgu_ros.image.frame_development import Development, develop_frame
from imgu_ros.image.grey_pyramid import GreyPyramid
from imgu_ros.pose.calibration_check import CalibrationCheck
from imgu_ros.pose.planar_pose import posed
from imgu_ros.reasons import NOT_DUE, UNLIKELY, unusable_frame
from imgu_ros.reference.planar import Target
from imgu_ros.result import ReferenceMatches, ReferenceResult, Result, Stage, Status, by_name
from imgu_ros.stage_clock import StageClock
from imgu_ros.track.frame_times import FrameTimes
from imgu_ros.track.prediction import Observation, Track
from imgu_ros.track.refinement import Alignment
from imgu_ros.track.tracker import follow, located
from imgu_ros.vision.matching.matches import Matches

#: While one target is tracked, every so many searches for a few missing ones are thorough.
_THOROUGH_EVERY = 6
#: Sightings farther apart tell nothing about how a target moves.
_STEADY_NS = 500_000_000
#: So many cameras, by the frames' frame_id, are told apart.
_CAMERAS = 8
#: Stamps that jump back by more belong to another recording, or to the same one played again.
JUMP_NS = 1_000_000_000


class Localizer:
    """From raw frames to poses of known targets.

    Frames are expected in the order of time; the tracker remembers where targets were. Stamps that jump back by more
    than a second (a recording played in a loop) make it forget: the frames that follow are those of a new chain. A
    single stamp of 0 among others is none: the tracks go on after it. Where stamps do not rise, frames count as evenly
    spaced. Frames of several cameras, told by their frame_id, may come in turn: each has its own memory.

    Parameters
    ----------
    parameters : all parameters
    targets : prepared with the same parameters
    parts : takes what is made; what was made before of the same targets is used again
    """

    def __init__(self, parameters: Parameters, targets: Sequence[Target], parts: BuildCache | None = None) -> None:
        self._parameters = parameters
        self._development = DevelopmentParameters.of(parameters)
        self._targets = tuple(targets)
        self._seeker = ReferenceDetector(self._targets, parameters, parts)
        self._now_ns = 0
        # By the frames' frame_id, that of the last frame last.
        self._cameras: OrderedDict[str, _Memory] = OrderedDict()
        self._memory = _Memory.empty(len(self._targets))

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
        self._cameras.clear()
        self._memory = _Memory.empty(len(self._targets))

    def continue_from(self, before: Localizer) -> None:
        """Go on where another chain stands: tracks of targets that both know by name and picture go on.

        Tracks are of the template's px: they hold whatever the targets' widths and all parameters are. So does what was
        seen of the calibration, until the camera changes.
        """
        self.reset()
        known = {target.name: index for index, target in enumerate(before._targets)}
        same: dict[int, int] = {}
        for index, target in enumerate(self._targets):
            at = known.get(target.name)
            if at is not None and target.image.shows_the_same(before._targets[at].image):
                same[index] = at
        for frame_id, memory in before._cameras.items():
            self._cameras[frame_id] = self._continued(memory, same)
            if memory is before._memory:
                self._memory = self._cameras[frame_id]

    def _continued(self, memory: _Memory, same: Mapping[int, int]) -> _Memory:
        """Return what another chain remembers of a camera; `same`: indices of the targets, and what they were there."""
        continued = _Memory.empty(len(self._targets))
        continued.last_ns, continued.times, continued.calibration = memory.last_ns, memory.times, memory.calibration
        if self._parameters.tracking.enabled:
            continued.frames_without_search, continued.searches = memory.frames_without_search, memory.searches
            for index, at in same.items():
                continued.tracks[index], continued.seen[index] = memory.tracks[at], memory.seen[at]
        return continued

    def process(self, frame: Frame, with_keypoints: bool = False, development: Development | None = None) -> Result:
        """Work on one frame.

        A frame that the chain cannot work on is rejected in the result, with the reason; nothing is raised for it.

        Parameters
        ----------
        frame : what to work on
        with_keypoints : make pyramid, keypoints and descriptors even when all targets are tracked without them
        development : of this frame, with the chain's parameters, when it was made ahead (see `develop_frame`)
        """
        self._look_at_header(frame.frame_id, frame.stamp_ns)
        self._now_ns = self._memory.times.of(frame.stamp_ns)
        development = development or develop_frame(frame, self._development)
        clock = StageClock()
        clock.times_ns[Stage.DEVELOP] = development.took_ns
        start = time.perf_counter_ns() - development.took_ns
        reason = development.reason
        if development.developed is not None:
            try:
                return self._worked(frame, development.developed, with_keypoints, clock, start)
            except ImguError as error:
                reason = str(error)
        total_ns = time.perf_counter_ns() - start
        return replace(rejected(frame, self._targets, reason), times_ns=clock.times_ns, total_ns=total_ns)

    def _look_at_header(self, frame_id: str, stamp_ns: int) -> None:
        """Remember the frame's camera; forget what was before a jump back in time, but for a frame without a stamp."""
        memory = self._cameras.get(frame_id) or _Memory.empty(len(self._targets))
        before, last_ns = memory.before_zero, memory.last_ns
        memory.before_zero = None
        if last_ns is not None and stamp_ns < last_ns - JUMP_NS:
            before, memory = memory, _Memory.empty(len(self._targets))
            memory.before_zero = before if stamp_ns == 0 else None
        elif before is not None and before.last_ns is not None and stamp_ns >= before.last_ns - JUMP_NS:
            memory = before
        memory.last_ns = stamp_ns
        self._memory = self._cameras[frame_id] = memory
        self._cameras.move_to_end(frame_id)
        if len(self._cameras) > _CAMERAS:
            self._cameras.popitem(last=False)

    def _worked(
        self, frame: Frame, developed: Developed, with_keypoints: bool, clock: StageClock, start: int
    ) -> Result:
        pictures = GreyPyramid(developed)
        results: list[ReferenceResult | None] = [
            self._followed(index, frame, pictures, clock) for index in range(len(self._targets))
        ]
        missing = [index for index, result in enumerate(results) if result is None]
        due = self._search_is_due(missing)
        features = self._seeker.features(pictures, clock) if due or with_keypoints else None
        if features is not None and due:
            covered = [result.outline for result in results if result is not None and result.outline is not None]
            view = View(frame, pictures, features, covered)
            self._memory.searches += 1
            thorough = self._memory.searches % _THOROUGH_EVERY == 0
            for result in self._seeker.seek(view, missing, clock, thorough):
                results[result.number] = result
        targets = tuple(
            result or ReferenceResult(target.name, index, Status.LOST, reason=UNLIKELY if due else NOT_DUE)
            for index, (target, result) in enumerate(zip(self._targets, results, strict=True))
        )
        memory = self._memory
        memory.frames_without_search = 0 if due or not missing else memory.frames_without_search + 1
        self._remember(targets)
        targets = memory.calibration.examined(frame.camera, targets)
        return Result(
            frame=frame,
            references=by_name(targets),
            developed=developed,
            pyramid=features.pyramid if features else None,
            keypoints=features.described.keypoints if features else None,
            descriptors=features.described.descriptors if features else None,
            calibration=None if frame.camera is None else memory.calibration.finding,
            times_ns=clock.times_ns,
            total_ns=time.perf_counter_ns() - start,
        )

    def _followed(self, index: int, frame: Frame, pictures: GreyPyramid, clock: StageClock) -> ReferenceResult | None:
        """Return the target where its track leads; None when there is no track or it does not hold."""
        memory = self._memory
        track, target, p = memory.tracks[index], self._targets[index], self._parameters
        if track is None:
            return None
        try:
            with clock.measures(Stage.REFINE):
                alignment = follow(target, track, pictures, self._now_ns, frame.camera, p)
        except EstimationError:
            return None
        found = ReferenceResult(
            target.name,
            index,
            Status.TRACKED,
            matches=_as_matches(alignment),
            confirmed_share=alignment.agreeing_share,
        )
        with clock.measures(Stage.POSE):
            return posed(found, target, located(alignment), frame.camera, p, frame.camera_reason, memory.calibration)

    def _search_is_due(self, missing: Sequence[int]) -> bool:
        """Whether missing targets are to be looked for: at once when one was just lost or none is in view."""
        if not missing:
            return False
        just_lost = any(self._memory.tracks[index] is not None for index in missing)
        none_in_view = len(missing) == len(self._targets)
        waited = self._memory.frames_without_search + 1
        return just_lost or none_in_view or waited >= self._parameters.tracking.search_every

    def _remember(self, targets: Sequence[ReferenceResult]) -> None:
        if not self._parameters.tracking.enabled:
            return
        for result in targets:
            track = self._memory.tracks[result.number]
            if result.homography is None:
                self._memory.tracks[result.number] = None
                continue
            if track is None or result.status is Status.DETECTED:
                sighting = Observation(result.homography.H, self._now_ns)
                self._memory.tracks[result.number] = Track([sighting, *self._shortly_before(result.number)])
            else:
                target = self._targets[result.number]
                self._memory.tracks[result.number] = track.continued(target, result.homography.H, self._now_ns)
            self._memory.seen[result.number] = Observation(result.homography.H, self._now_ns)

    def _shortly_before(self, index: int) -> list[Observation]:
        """Return where a target was seen last, when that is no longer ago than it can move on steadily.

        A target that moves fast has moved far when it was detected: two detections tell where it will be.
        """
        seen = self._memory.seen[index]
        return [seen] if seen is not None and 0 < self._now_ns - seen.stamp_ns <= _STEADY_NS else []


@dataclass(slots=True, eq=False)
class _Memory:
    """What a chain knows of one camera: `before_zero` is what it knew before a frame without a stamp."""

    tracks: list[Track | None]
    seen: list[Observation | None]
    times: FrameTimes
    calibration: CalibrationCheck
    frames_without_search: int = 0
    searches: int = 0
    last_ns: int | None = None
    before_zero: _Memory | None = None

    @classmethod
    def empty(cls, targets: int) -> _Memory:
        """Return that of a camera that is new, with so many targets."""
        return cls([None] * targets, [None] * targets, FrameTimes(), CalibrationCheck())


def rejected(frame: Frame, references: Sequence[Target], reason: str) -> Result:
    """Return the result of a frame that cannot be used, for `reason`."""
    words = unusable_frame(reason)
    results = (ReferenceResult(known.name, i, Status.REJECTED, reason=words) for i, known in enumerate(references))
    return Result(frame, by_name(results), reason=reason)


def _as_matches(alignment: Alignment) -> ReferenceMatches:
    """Return the aligned patches as matches: they have no keypoints, and all agree."""
    count = len(alignment.template_xy)
    none = np.full(count, -1, np.intp)
    return ReferenceMatches(
        Matches(none, none, np.zeros(count)), alignment.template_xy, alignment.image_xy, np.ones(count, bool)
    )
