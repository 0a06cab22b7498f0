# SPDX-License-Identifier: Apache-2.0
"""The thread that does the work: takes the newest frame, decodes it, runs the chain, and hands the result out."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from imgu_ros.config.components import ReadingParameters
from imgu_ros.config.parameters import Parameters
from imgu_ros.errors import EncodingError, ImguError
from imgu_ros.files.frame_reading import FrameReading, frame_reading
from imgu_ros.frame import Frame
from imgu_ros.localizer import rejected
from imgu_ros.localizer_builder import Built, build
from imgu_ros.messages.header import Header, decode_header
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.size_checks import SizeChecks
from imgu_ros.reference.templates import TargetImage
from imgu_ros.result import Result
from imgu_ros.ros.current_frame import CurrentFrame
from imgu_ros.ros.frame_queue import FrameQueue
from imgu_ros.ros.input import Job
from imgu_ros.ros.meters import LatencyMeter, RateMeter
from imgu_ros.ros.rebuilding import Rebuilder
from imgu_ros.ros.search_failures import SearchFailures
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage

#: The worker waits for no longer than this for somebody who wants to come between two frames.
_LONGEST_HOLD_S = 0.3
#: A calibration file that has vanished is looked for so often.
_AGAIN_S = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Handlers:
    """What the worker calls, in its own thread.

    Attributes
    ----------
    result : takes each frame's result, and what it was made from
    rejected : takes the result of a frame that could not be read: the reason, and nothing to see
    failed : takes a line about what went wrong with a frame or with changed parameters
    needs_keypoints : tells whether the next result needs keypoints even when the targets are tracked without them
    """

    result: Callable[[Result, Job], None]
    rejected: Callable[[Result], None]
    failed: Callable[[str], None]
    needs_keypoints: Callable[[], bool]


class Worker:
    """Owns the chain. Its public methods may be called from any thread.

    Parameters
    ----------
    slot : where frames come from
    parameters : gives the parameters in force; when they change, the chain goes on with the old ones until `follow`
        has had another one made
    handlers : where results go

    Attributes
    ----------
    done : frames that went through the chain
    latency : from the delivery of an image to the end of publishing its results
    age : from an image's stamp to its results, by the node's clock
    in_hand : the frame that is worked on
    sought : what was looked for in vain
    sizes : widths of targets that cannot be
    """

    def __init__(self, slot: FrameQueue[Job], parameters: Callable[[], Parameters], handlers: Handlers) -> None:
        self.done = RateMeter()
        self.latency = LatencyMeter()
        self.age = LatencyMeter()
        self.in_hand = CurrentFrame()
        self.sought = SearchFailures()
        self.sizes = SizeChecks(())
        self._slot = slot
        self._parameters = parameters
        self._handlers = handlers
        self._lock = threading.RLock()
        self._go_on = threading.Event()
        self._go_on.set()
        self._built: Built | None = None
        self._reading = FrameReading()
        self._read_for: Parameters | None = None
        self._reading_problem = ""
        self._unread: Parameters | None = None
        self._read_again_s = 0.0
        self._rebuilder = Rebuilder(handlers.failed)
        self._last: Result | None = None
        self._rejected = 0
        self._unknown_encodings = 0
        self._rejection = ""
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="worker", daemon=True)
        self._thread.start()

    @property
    def rejected(self) -> int:
        """Frames that could not be read."""
        return self._rejected

    @property
    def unknown_encodings(self) -> int:
        """Those of the rejected frames whose encoding is unknown."""
        return self._unknown_encodings

    @property
    def rejection(self) -> str:
        """Why the last frame could not be read; empty when it could."""
        return self._rejection

    @property
    def last(self) -> Result | None:
        """The last frame's result; None before the first."""
        return self._last

    @property
    def targets(self) -> tuple[Reference, ...]:
        """What is looked for."""
        built = self._built
        return () if built is None else built.references

    @property
    def parameters(self) -> Parameters | None:
        """The parameters that frames are worked on with; None before `use`."""
        built = self._built
        return None if built is None else built.parameters

    @property
    def info_file(self) -> str:
        """The calibration file that counts instead of camera_info; empty: none."""
        return self._reading.info_file

    @property
    def reading_problem(self) -> str:
        """Why frames are not read as the parameters in force say; empty when they are."""
        return self._reading_problem

    def build(self, images: Sequence[TargetImage], parameters: Parameters | None = None) -> Built:
        """Return a chain for these targets; frames go on meanwhile.

        Parameters
        ----------
        images : what is looked for
        parameters : None: those in force

        Raises
        ------
        ImguError
            If an image cannot serve as a target.
        """
        return build(images, self._parameters() if parameters is None else parameters, self._built)

    def read_with(self, reading: FrameReading, parameters: Parameters) -> None:
        """Read frames so from the next one on, as long as these parameters are in force."""
        with self._lock:
            self._reading, self._read_for, self._reading_problem = reading, parameters, ""

    def use(self, built: Built) -> None:
        """Go on with this chain from the next frame on; tracks of targets that stay the same go on."""
        with self._lock:
            self._rebuilder.forget()
            if self._built is not None:
                built.chain.continue_from(self._built.chain)
            self._built = built
            self.sizes = SizeChecks(built.references)
            self._last = None
            self.sought.clear()

    def follow(self) -> None:
        """Have the chain made anew when the parameters have changed; to be called a few times a second."""
        built, parameters = self._built, self._parameters()
        if built is not None and parameters is not built.parameters:
            self._rebuilder.ask(built, parameters)

    def reset(self) -> None:
        """Forget all tracks."""
        with self._lock:
            self._take_over()
            if self._built is not None:
                self._built.chain.reset()
            self.sought.clear()

    def drop(self) -> None:
        """Forget chain, targets and results; frames are ignored until `use`."""
        with self._lock:
            self._rebuilder.forget()
            self._built = self._last = None
            self.sought.clear()

    @contextlib.contextmanager
    def between_frames(self) -> Iterator[None]:
        """Hold the worker between two frames."""
        with self._lock:
            yield

    @contextlib.contextmanager
    def soon_between_frames(self) -> Iterator[bool]:
        """Hold the worker between two frames if it is there, and give whether it is; it will be when called again soon.

        For a thread that must not wait until a long frame is done.
        """
        if not self._lock.acquire(blocking=False):
            self._go_on.clear()
            yield False
            return
        try:
            yield True
        finally:
            self._lock.release()
            self._go_on.set()

    def close(self, timeout_s: float = 1.0) -> bool:
        """End the thread; return whether it has ended in time. It hands nothing out any more in any case."""
        self._closing = True
        self._go_on.set()
        self._slot.close()
        rebuilt = self._rebuilder.close(timeout_s)
        self._thread.join(timeout_s)
        return rebuilt and not self._thread.is_alive()

    def _run(self) -> None:
        while (job := self._slot.take()) is not None:
            # Somebody may want to come between two frames: not for long.
            if not self._go_on.wait(_LONGEST_HOLD_S):
                self._go_on.set()
            try:
                with self._lock:
                    self.in_hand.begin(job.image)
                    self._work(job)
            except Exception as error:
                # One bad frame must not end the node, whatever is wrong with it.
                if not self._closing:
                    self._handlers.failed(f"frame: {type(error).__name__}: {' '.join(str(error).split())}")
            finally:
                self.in_hand.end()

    def _work(self, job: Job) -> None:
        self._take_over()
        if self._built is None:
            return
        chain = self._built.chain
        self._follow_reading()
        try:
            frame = self._reading.frame(job.image, job.camera_info)
        except EncodingError as error:
            self._rejected += 1
            self._unknown_encodings += str(error).startswith("encoding:")
            self._rejection = str(error)
            self._handlers.rejected(self._rejected_result(decode_header(job.image), str(error)))
            return
        result = chain.process(frame, with_keypoints=self._handlers.needs_keypoints())
        self._rejection = result.reason
        self._rejected += bool(result.reason)
        self._last = result
        now = time.monotonic()
        self.sought.add(result, now)
        self.sizes.add(result)
        if self._closing:
            return
        self._handlers.result(result, job)
        now = time.monotonic()
        self.done.tick(now)
        self.latency.add(now - job.received_s)

    def _take_over(self) -> None:
        """Go on with the chain that was made for changed parameters, if one was, from where the old one stands."""
        built = self._rebuilder.take()
        if built is not None and self._built is not None and built.images is self._built.images:
            built.chain.continue_from(self._built.chain)
            self._built = built

    def _follow_reading(self) -> None:
        """Read this frame already as the parameters say: a camera or an encoding needs no other chain."""
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


#: Stands in results for an image that could not be read.
_NO_IMAGE = RawImage(np.zeros((1, 1), np.uint8), PixelLayout(ColorModel.MONO))
