# SPDX-License-Identifier: Apache-2.0
"""What is remembered from frame to frame, for each camera: tracks by reference, times, the calibration check."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Set
from copy import copy

from imgu_ros.image.transfer_fit import TransferFit
from imgu_ros.pose.calibration_check import CalibrationCheck
from imgu_ros.reference.reference import Reference
from imgu_ros.result import ReferenceResult, Status
from imgu_ros.track.sample_refinement import Observation
from imgu_ros.track.tracker import Track

#: Observations farther apart say nothing about how a reference moves.
_STEADY_NS = 500_000_000
#: Cameras, by frame_id, that are told apart; the one not seen for longest is forgotten. Bounds memory.
_CAMERAS = 8
#: A longer backward jump of the stamps starts another recording, or the same one again.
JUMP_NS = 1_000_000_000
#: From one frame to the next where no two stamps have told it.
_USUAL_PERIOD_NS = 33_000_000
#: What is longer is a gap, not the time from one frame to the next.
_LONGEST_PERIOD_NS = 2_000_000_000


class CameraMemory:
    """What is remembered of one camera.

    Attributes
    ----------
    tracks : by reference name, of the references found in the last frame
    calibration : what frames say about the camera's calibration
    transfer : what frames say about how its values follow from the light
    frames_without_search, searches : for scheduling searches, see `Localizer`
    last_ns : stamp of the last frame
    before_zero : the memory before a frame without a stamp
    """

    def __init__(self) -> None:
        self.tracks: dict[str, Track] = {}
        self.calibration = CalibrationCheck()
        self.transfer = TransferFit()
        self.frames_without_search = 0
        self.searches = 0
        self.last_ns: int | None = None
        self.before_zero: CameraMemory | None = None
        self._last_seen: dict[str, Observation] = {}
        self._times = FrameTimes()

    def time_of(self, stamp_ns: int) -> int:
        """Return the next frame's time, later than the one before; see `FrameTimes`."""
        return self._times.of(stamp_ns)

    def remember(self, reference: Reference, found: ReferenceResult, time_ns: int) -> None:
        """Continue, start or end the track of a reference by its result in a frame."""
        track = self.tracks.get(reference.name)
        if found.homography is None:
            self.tracks.pop(reference.name, None)
            return
        observation = Observation(found.homography.H if found.H_seen is None else found.H_seen, time_ns)
        if track is not None and found.status is Status.TRACKED:
            self.tracks[reference.name] = track.continued(reference, observation.H, time_ns, found.sampled, found.alike)
        else:
            self.tracks[reference.name] = Track(
                [observation, *self._shortly_before(reference.name, time_ns)], sampled=found.sampled, alike=found.alike
            )
        self._last_seen[reference.name] = observation

    def forget(self, names: Set[str]) -> None:
        """Forget how some references moved."""
        for name in names:
            self.tracks.pop(name, None)
            self._last_seen.pop(name, None)

    def copy(self) -> CameraMemory:
        """Return a memory for other parameters; frame times and calibration check are shared.

        Its tracks are its own, with patches that have to be chosen anew.
        """
        other = copy(self)
        other.tracks = {name: track.without_patches() for name, track in self.tracks.items()}
        other._last_seen = dict(self._last_seen)
        other.before_zero = None if self.before_zero is None else self.before_zero.copy()
        return other

    def keep(self, names: Set[str]) -> None:
        """Forget the tracks of other references."""
        if self.before_zero is not None:
            self.before_zero.keep(names)
        self.tracks = {name: track for name, track in self.tracks.items() if name in names}
        self._last_seen = {name: seen for name, seen in self._last_seen.items() if name in names}

    def _shortly_before(self, name: str, time_ns: int) -> Iterable[Observation]:
        """Return where a reference was last seen, when that is recent enough for a steady motion.

        A reference that moves fast has moved far when it is detected again: two detections predict the next frame.
        """
        seen = self._last_seen.get(name)
        return [seen] if seen is not None and 0 < time_ns - seen.stamp_ns <= _STEADY_NS else []


class CameraMemories:
    """A memory for each camera, by the frames' frame_id."""

    def __init__(self) -> None:
        self._memories: OrderedDict[str, CameraMemory] = OrderedDict()

    def of(self, frame_id: str, stamp_ns: int) -> CameraMemory:
        """Return the memory of the camera that took a frame.

        A backward jump in time of more than a second resets it; after a single frame whose stamp is 0 among others it
        continues.
        """
        memory = self._memories.get(frame_id) or CameraMemory()
        before, last_ns = memory.before_zero, memory.last_ns
        memory.before_zero = None
        if last_ns is not None and stamp_ns < last_ns - JUMP_NS:
            before, memory = memory, CameraMemory()
            memory.before_zero = before if stamp_ns == 0 else None
        elif before is not None and before.last_ns is not None and stamp_ns >= before.last_ns - JUMP_NS:
            memory = before
        memory.last_ns = stamp_ns
        self._memories[frame_id] = memory
        self._memories.move_to_end(frame_id)
        if len(self._memories) > _CAMERAS:
            self._memories.popitem(last=False)
        return memory

    def copy(self) -> CameraMemories:
        """Return memories whose tracks are their own; see `CameraMemory.copy`."""
        other = CameraMemories()
        other._memories = OrderedDict((frame_id, memory.copy()) for frame_id, memory in self._memories.items())
        return other

    def __len__(self) -> int:
        return len(self._memories)

    def keep(self, names: Set[str]) -> None:
        """Forget the tracks of other references."""
        for memory in self._memories.values():
            memory.keep(names)


class FrameTimes:
    """Gives every frame a later time than the one before it, whatever the stamps are.

    A camera whose stamps are all 0, repeated, or set back for a moment takes its frames at its rate all the same.
    """

    def __init__(self) -> None:
        self._stamp_ns: int | None = None
        self._time_ns = 0
        self._period_ns = _USUAL_PERIOD_NS

    def of(self, stamp_ns: int) -> int:
        """Return the next frame's time: as much later as its stamp, or by the last interval where that is not later."""
        if self._stamp_ns is None:
            self._time_ns = stamp_ns
        else:
            passed_ns = stamp_ns - self._stamp_ns
            if 0 < passed_ns < _LONGEST_PERIOD_NS:
                self._period_ns = passed_ns
            self._time_ns += passed_ns if passed_ns > 0 else self._period_ns
        self._stamp_ns = stamp_ns
        return self._time_ns
