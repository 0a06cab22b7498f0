# SPDX-License-Identifier: Apache-2.0
"""The worker of the perception node: decodes each frame, runs the localizer, and hands the result out."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imgu_ros.check.load_remarks import load_remarks
from imgu_ros.config.components import ReadingParameters
from imgu_ros.config.parameters import Parameters
from imgu_ros.errors import EncodingError, ImguError
from imgu_ros.files.frame_reading import FrameReading, frame_reading
from imgu_ros.frame import Frame
from imgu_ros.localizer import PreparedLocalizer, prepare_localizer, rejected
from imgu_ros.messages.header import Header, decode_header
from imgu_ros.process_memory import return_free_memory
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.size_checks import SizeChecks
from imgu_ros.reference.templates import TargetImage
from imgu_ros.result import Result
from imgu_ros.ros.frame_queue import FrameQueue
from imgu_ros.ros.frame_worker import FrameMessages, FrameWorker
from imgu_ros.ros.meters import LatencyMeter
from imgu_ros.ros.rebuilding import Rebuilder
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage

#: Interval at which a calibration file that has vanished is looked for again.
_AGAIN_S = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class ResultHandlers:
    """The functions that the worker calls, in its own thread.

    Attributes
    ----------
    result : takes each frame's result
    rejected : takes the result of a frame that could not be decoded: the reason and no image
    failed : takes a line about an error in a frame or in changed parameters
    needs_keypoints : tells whether the next result needs keypoints even when the targets are tracked without them
    """

    result: Callable[[Result], None]
    rejected: Callable[[Result], None]
    failed: Callable[[str], None]
    needs_keypoints: Callable[[], bool]


class SearchFailures:
    """Targets that were searched for and not found: how many matches agreed at most."""

    def __init__(self) -> None:
        self._found_s: float | None = None
        self._most: dict[str, int] = {}

    @property
    def found_s(self) -> float | None:
        """When a target was found last (monotonic); None: never yet."""
        return self._found_s

    @property
    def most_inliers(self) -> Mapping[str, int]:
        """The most inliers of each target since it was found last."""
        return self._most

    def add(self, result: Result, now_s: float) -> None:
        """Take the result of one more frame."""
        most = {}
        for target in result:
            if target.status.found:
                self._found_s = now_s
            else:
                most[target.name] = max(self._most.get(target.name, 0), target.most_inliers)
        self._most = most

    def clear(self) -> None:
        """Drop all counts."""
        self._found_s, self._most = None, {}


class LocalizerWorker(FrameWorker):
    """Owns the localizer. Its public methods may be called from any thread.

    Parameters
    ----------
    queue : where frames come from
    parameters : gives the parameters in force; when they change, the localizer goes on with the old ones until `follow`
        has had another one made
    handlers : where results go

    Attributes
    ----------
    age : from an image's stamp to its results, by the node's clock
    failures : targets that were searched for and not found
    sizes : implausible widths of targets
    poor_targets : what is said of targets that will hardly be found, by name
    unknown_encodings : those of the rejected frames whose encoding is unknown
    """

    def __init__(
        self, queue: FrameQueue[FrameMessages], parameters: Callable[[], Parameters], handlers: ResultHandlers
    ) -> None:
        self.age = LatencyMeter()
        self.failures = SearchFailures()
        self.sizes = SizeChecks(())
        self.poor_targets: dict[str, str] = {}
        self._judged: tuple[PreparedLocalizer, dict[str, str]] | None = None
        self.unknown_encodings = 0
        self._parameters = parameters
        self._handlers = handlers
        self._built: PreparedLocalizer | None = None
        self._reading = FrameReading()
        self._read_for: Parameters | None = None
        self._reading_problem = ""
        self._unread: Parameters | None = None
        self._read_again_s = 0.0
        self._rebuilder = Rebuilder(handlers.failed)
        self._last: Result | None = None
        super().__init__(queue, self._localize, handlers.failed)  # starts the thread

    @property
    def last(self) -> Result | None:
        """The last frame's result; None before the first."""
        return self._last

    @property
    def targets(self) -> tuple[Reference, ...]:
        """The targets that are searched for."""
        built = self._built
        return () if built is None else built.references

    @property
    def parameters(self) -> Parameters | None:
        """The parameters that frames are processed with; None before `use`."""
        built = self._built
        return None if built is None else built.parameters

    @property
    def info_file(self) -> str:
        """The calibration file that counts instead of camera_info; empty: none."""
        return self._reading.info_file

    @property
    def reading_problem(self) -> str:
        """Why frames are not decoded as the parameters in force say; empty when they are."""
        return self._reading_problem

    def build(self, images: Sequence[TargetImage], parameters: Parameters | None = None) -> PreparedLocalizer:
        """Return a localizer for these targets; frames are processed meanwhile.

        Parameters
        ----------
        images : of the targets
        parameters : None: those in force

        Raises
        ------
        ImguError
            If an image cannot serve as a target.
        """
        built = prepare_localizer(images, self._parameters() if parameters is None else parameters, self._built)
        # Not in `use`, while frames wait.
        self._judged = built, load_remarks(built.references, built.parameters.raw.transfer != "srgb")
        return_free_memory()
        return built

    def read_with(self, reading: FrameReading, parameters: Parameters) -> None:
        """Decode frames this way from the next one on, as long as these parameters are in force."""
        with self.between_frames():
            self._reading, self._read_for, self._reading_problem = reading, parameters, ""

    def use(self, built: PreparedLocalizer) -> None:
        """Use this localizer from the next frame on; tracks of targets that stay the same are kept."""
        with self.between_frames():
            self._rebuilder.forget()
            if self._built is not None:
                built.localizer.continue_from(self._built.localizer)
            self._built = built
            self.sizes = SizeChecks(built.references)
            self.poor_targets = self._judged[1] if self._judged is not None and self._judged[0] is built else {}
            self._judged = None
            self._last = None
            self.failures.clear()

    def follow(self) -> None:
        """Have the localizer rebuilt when the parameters have changed; to be called a few times a second."""
        built, parameters = self._built, self._parameters()
        if built is not None and parameters is not built.parameters:
            self._rebuilder.ask(built, parameters)

    def reset(self) -> None:
        """Forget all tracks."""
        with self.between_frames():
            self._take_over()
            if self._built is not None:
                self._built.localizer.reset()
            self.failures.clear()

    def drop(self) -> None:
        """Drop localizer, targets and results; frames are ignored until `use`."""
        with self.between_frames():
            self._rebuilder.forget()
            self._built = self._last = None
            self.poor_targets = {}
            self.failures.clear()

    def close(self, timeout_s: float = 1.0) -> bool:
        """See `FrameWorker.close`."""
        ended = super().close(timeout_s)
        return self._rebuilder.close(timeout_s) and ended

    def _localize(self, given: FrameMessages) -> None:
        self._take_over()
        if self._built is None:
            return
        self._follow_reading()
        try:
            frame = self._reading.frame(given.message, given.camera_info)
        except EncodingError as error:
            self.figures.count_rejected(str(error))
            self.unknown_encodings += str(error).startswith("encoding:")
            self._handlers.rejected(self._rejected_result(decode_header(given.message), str(error)))
            return
        result = self._built.localizer.process(frame, with_keypoints=self._handlers.needs_keypoints())
        self.figures.count_rejected(result.reason)
        self._last = result
        self.failures.add(result, time.monotonic())
        self.sizes.add(result)
        if self.is_closing:
            return
        self._handlers.result(result)
        self.figures.count_done(given.received_s)

    def _take_over(self) -> None:
        """Use the localizer that was built for changed parameters, if any, with the tracks of the old one."""
        built = self._rebuilder.take()
        if built is not None and self._built is not None and built.images is self._built.images:
            built.localizer.continue_from(self._built.localizer)
            self._built = built

    def _follow_reading(self) -> None:
        """Decode this frame as the new parameters say: another camera or encoding needs no other localizer."""
        parameters = self._parameters()
        now = time.monotonic()
        if parameters is self._read_for or (parameters is self._unread and now < self._read_again_s):
            return
        try:
            self.read_with(frame_reading(ReadingParameters.of(parameters), self._reading), parameters)
        except ImguError as error:  # it was read when the parameter was set, and is gone since
            self._reading_problem = f"parameters: {error}; frames are read as before"
            self._unread, self._read_again_s = parameters, now + _AGAIN_S
            self._handlers.failed(self._reading_problem)

    def _rejected_result(self, header: Header, reason: str) -> Result:
        frame = Frame(_NO_IMAGE, header.stamp_ns, header.frame_id, None)
        return rejected(frame, self.targets, reason)


#: Stands in results for an image that could not be decoded.
_NO_IMAGE = RawImage(np.zeros((1, 1), np.uint8), PixelLayout(ColorModel.MONO))
