"""The thread that does the work: takes the newest frame, decodes it, runs the chain, and hands the result out."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from imgu_ros.codec.frame import decode_frame
from imgu_ros.codec.header import Header, decode_header
from imgu_ros.errors import EncodingError, ImguError
from imgu_ros.params import Parameters
from imgu_ros.perception.chain import Chain
from imgu_ros.perception.frame import Frame
from imgu_ros.perception.result import Result, Status, TargetResult
from imgu_ros.perception.targets import Target, TargetImage, prepare_targets
from imgu_ros.ros.input import Job
from imgu_ros.ros.meters import LatencyMeter, RateMeter
from imgu_ros.ros.newest import NewestSlot
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage


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
    parameters : gives the parameters in force; a new object means that the chain is to be rebuilt
    handlers : where results go

    Attributes
    ----------
    done : frames that went through the chain
    latency : from the delivery of an image to the end of publishing its results
    """

    def __init__(self, slot: NewestSlot[Job], parameters: Callable[[], Parameters], handlers: Handlers) -> None:
        self.done = RateMeter()
        self.latency = LatencyMeter()
        self._slot = slot
        self._parameters = parameters
        self._handlers = handlers
        self._lock = threading.RLock()
        self._images: tuple[TargetImage, ...] = ()
        self._targets: tuple[Target, ...] = ()
        self._used: Parameters | None = None
        self._chain: Chain | None = None
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
    def targets(self) -> tuple[Target, ...]:
        """What is looked for."""
        return self._targets

    def use(self, images: Sequence[TargetImage]) -> tuple[Target, ...]:
        """Look for these targets from the next frame on, with the parameters in force, and forget all tracks.

        Raises
        ------
        ImguError
            If an image cannot serve as a target; then nothing changes.
        """
        parameters = self._parameters()
        targets = prepare_targets(images, parameters)
        chain = Chain(parameters, targets)
        # Now, before frames come: later the first thorough search would hold them up.
        chain.prepare()
        with self._lock:
            self._images, self._targets, self._used = tuple(images), targets, parameters
            self._chain = chain
            self._last = None
        return targets

    def reset(self) -> None:
        """Forget all tracks."""
        with self._lock:
            if self._chain is not None:
                self._chain.reset()

    def drop(self) -> None:
        """Forget chain, targets and results; frames are ignored until `use`."""
        with self._lock:
            self._chain, self._used, self._last = None, None, None
            self._images, self._targets = (), ()

    @contextlib.contextmanager
    def between_frames(self) -> Iterator[None]:
        """Hold the worker between two frames."""
        with self._lock:
            yield

    def close(self, timeout_s: float = 1.0) -> bool:
        """End the thread; return whether it has ended in time. It hands nothing out any more in any case."""
        self._closing = True
        self._slot.close()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while (job := self._slot.take()) is not None:
            try:
                with self._lock:
                    self._work(job)
            except Exception as error:
                # One bad frame must not end the node, whatever is wrong with it.
                if not self._closing:
                    self._handlers.failed(f"frame: {type(error).__name__}: {' '.join(str(error).split())}")

    def _work(self, job: Job) -> None:
        self._follow_parameters()
        if self._chain is None or self._used is None:
            return
        try:
            frame = decode_frame(job.image, job.camera_info, rectified=self._used.camera.rectified)
        except EncodingError as error:
            self._rejected += 1
            self._unknown_encodings += str(error).startswith("encoding:")
            self._rejection = str(error)
            self._handlers.rejected(self._rejected_result(decode_header(job.image), str(error)))
            return
        self._rejection = ""
        result = self._chain.process(frame, with_keypoints=self._handlers.needs_keypoints())
        self._last = result
        if self._closing:
            return
        self._handlers.result(result, job)
        now = time.monotonic()
        self.done.tick(now)
        self.latency.add(now - job.received_s)

    def _follow_parameters(self) -> None:
        parameters = self._parameters()
        if self._chain is None or parameters is self._used:
            return
        self._used = parameters
        try:
            targets = prepare_targets(self._images, parameters)
            self._chain = Chain(parameters, targets)
            self._targets = targets
        except ImguError as error:
            self._handlers.failed(f"parameters: {error}; the chain goes on with the old ones")

    def _rejected_result(self, header: Header, reason: str) -> Result:
        frame = Frame(_NO_IMAGE, header.stamp_ns, header.frame_id, None)
        targets = tuple(TargetResult(t.name, i, Status.REJECTED, reason=reason) for i, t in enumerate(self._targets))
        return Result(frame, targets, reason=reason)


#: Stands in results for an image that could not be read.
_NO_IMAGE = RawImage(np.zeros((1, 1), np.uint8), PixelLayout(ColorModel.MONO))
