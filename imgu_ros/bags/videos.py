# SPDX-License-Identifier: Apache-2.0
"""Video files as a recording: one image topic, the frames of one file after those of another."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from imgu_ros.bags.frame_files import FRAME_CHANNEL, frame_message
from imgu_ros.bags.storage import Channel, MessageBlock, RawMessage, WarningLog
from imgu_ros.errors import BagError
from imgu_ros.types import Image

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.frame import VideoFrame
    from av.video.stream import VideoStream

#: Where the file says no rate: the time of a frame whose time it does not say either, after the one before.
_USUAL_RATE = Fraction(30)
_SECOND = 10**9
#: A file whose frames end by more s, and by more of its length, before its end was cut; sound may go on a little.
_ENDS_EARLY_S, _ENDS_EARLY = Fraction(1), Fraction(1, 20)


#: FFmpeg's pixel formats that are kept: PyAV's name of what it gives, and ROS's of the encoding.
_KEPT = {
    "gray": ("gray", "mono8"),
    "gray16le": ("gray16le", "mono16"),
    **{f"bayer_{order}8": (f"bayer_{order}8", f"bayer_{order}8") for order in ("rggb", "bggr", "grbg", "gbrg")},
    **{f"bayer_{order}16le": (f"bayer_{order}16le", f"bayer_{order}16") for order in ("rggb", "bggr", "grbg", "gbrg")},
}


@dataclass(frozen=True, slots=True, eq=False)
class VideoPicture:
    """A frame: ns after the first, pixels (H, W) or (H, W, 3), and their encoding."""

    time_ns: int
    pixels: Image
    encoding: str


class VideoFile:
    """A video file: its size, its rate, and its frames with their own times, also where the rate varies.

    Parameters
    ----------
    path : a file that FFmpeg reads: MP4, MOV, Matroska, WebM, AVI, MPEG, ...

    Attributes
    ----------
    rate : frames a second, the average where it varies
    duration_s : as the file says; 0: not known
    frame_count : as the file says, else the number of its packets, a frame each

    Raises
    ------
    BagError
        If the file cannot be read or has no video, or PyAV, which reads it, is not installed.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        with self._opened() as container:
            stream = self._stream(container)
            self.rate = _fraction(stream.average_rate or stream.base_rate or _USUAL_RATE)
            self.duration_s = _duration_s(container, stream)
            self.frame_count = stream.frames or _packets(container, stream)

    def frames(self, warnings: WarningLog | None = None) -> Iterator[VideoPicture]:
        """Yield the frames the way up that they are shown; grey and mosaics as they are, all else as 8-bit BGR.

        A file that is cut or damaged gives the frames that can be decoded; what is wrong with it goes to `warnings`.
        """
        warnings = warnings or WarningLog()
        first: Fraction | None = None
        time, decoded = -1 / self.rate, 0
        with self._opened() as container:
            stream = self._stream(container)
            stream.thread_type = "AUTO"
            for frame in self._decoded(container, stream, warnings):
                said = None if frame.pts is None or not frame.time_base else frame.pts * _fraction(frame.time_base)
                first = said if first is None else first
                # A frame without a time, or out of order, comes as long after the one before as frames usually do.
                is_later = said is not None and first is not None and said - first > time
                time = said - first if is_later and said is not None and first is not None else time + 1 / self.rate
                decoded += 1
                if getattr(frame, "is_corrupt", False):
                    warnings.add(f"{self._path}: frame {decoded} is damaged", f"{self._path}: damaged frames")
                kind, encoding = _KEPT.get(frame.format.name, ("bgr24", "bgr8"))
                pixels = frame.to_ndarray(format=kind)
                turns = 0 if encoding.startswith("bayer") else _turns(frame, stream)
                upright = np.ascontiguousarray(np.rot90(pixels, turns)) if turns else pixels
                yield VideoPicture(round(time * _SECOND), upright, encoding)
        if decoded < self.frame_count:
            warnings.add(f"{self._path}: {decoded} of the {self.frame_count} frames in the file can be read")
        elif self.duration_s - time > max(_ENDS_EARLY_S, _ENDS_EARLY * self.duration_s):
            warnings.add(
                f"{self._path}: ends after {float(time):.1f} s of the {float(self.duration_s):.1f} s that the file "
                "announces: it is cut"
            )

    def _decoded(self, container: InputContainer, stream: VideoStream, warnings: WarningLog) -> Iterator[VideoFrame]:
        import av

        packets = container.demux(stream)
        while True:
            try:
                packet = next(packets, None)
                if packet is None:
                    return
                frames = packet.decode()
            except (av.error.FFmpegError, ValueError) as error:
                warnings.add(f"{self._path}: damaged: {_one_line(error)}", f"{self._path}: damaged")
                if not isinstance(error, av.error.InvalidDataError):
                    return
                continue
            yield from frames

    def _opened(self) -> InputContainer:
        av = _pyav(self._path)
        try:
            container: InputContainer = av.open(str(self._path))
        except (av.error.FFmpegError, ValueError) as error:
            raise BagError(f"{self._path}: {self._why_unreadable(error)}") from None
        except OSError as error:
            raise BagError(f"{self._path}: {error.strerror or error}; need a video file") from None
        return container

    def _why_unreadable(self, error: Exception) -> str:
        try:
            with self._path.open("rb") as file:
                is_mp4 = file.read(12)[4:8] == b"ftyp"
        except OSError:
            is_mp4 = False
        if is_mp4:  # its index is at the end
            return f"cut or damaged ({_one_line(error)}); need the whole file: copy it again"
        return f"{_one_line(error)}; need a video file that FFmpeg reads"

    def _stream(self, container: InputContainer) -> VideoStream:
        if not container.streams.video:
            raise BagError(f"{self._path}: no video in it; need a file with frames")
        return container.streams.video[0]


class VideoStorage:
    """Video files as a storage of the image topic; time 0 is the first frame of the first file.

    Parameters
    ----------
    paths : files whose frames follow one another
    warnings : takes what is damaged

    Raises
    ------
    BagError
        If one of them cannot be read, see `VideoFile`.
    """

    def __init__(self, paths: Sequence[Path], warnings: WarningLog) -> None:
        self._files = [VideoFile(path) for path in paths]
        self._warnings = warnings
        self.counts: dict[Channel, int] = {FRAME_CHANNEL: sum(file.frame_count for file in self._files) or 1}
        self.start_ns = 0
        self.end_ns = round(sum(file.duration_s or file.frame_count / file.rate for file in self._files) * _SECOND)

    def parts(self, topics: Collection[str] | None) -> Iterator[MessageBlock]:
        """Yield one part: all frames."""
        if topics is None or FRAME_CHANNEL.topic in topics:
            yield MessageBlock(0, self._messages)

    def close(self) -> None:
        """Do nothing: files are open only while they are read."""

    def _messages(self) -> Iterator[RawMessage]:
        start_ns = 0
        for file in self._files:
            last_ns = -1
            for picture in file.frames(self._warnings):
                last_ns = start_ns + picture.time_ns
                message = frame_message(last_ns, picture.pixels, picture.encoding)
                yield RawMessage(FRAME_CHANNEL, last_ns, b"", message)
            start_ns = max(start_ns, last_ns + round(_SECOND / file.rate))


def _pyav(path: Path) -> Any:
    try:
        import av
        import av.error
    except ImportError:
        raise BagError(f"{path}: a video, which PyAV reads; need it: pip install av (apt: python3-av)") from None
    return av


def _fraction(value: Any) -> Fraction:
    """Return PyAV's own kind of fraction, which it has since version 18, as Python's."""
    return Fraction(value.numerator, value.denominator)


def _duration_s(container: InputContainer, stream: VideoStream) -> Fraction:
    if stream.duration is not None and stream.time_base is not None:
        return stream.duration * _fraction(stream.time_base)
    # Of the container: from its own time 0, which the first frame may come after.
    return Fraction((container.duration or 0) - (container.start_time or 0), 1_000_000)


def _packets(container: InputContainer, stream: VideoStream) -> int:
    import av

    count = 0
    try:
        for packet in container.demux(stream):
            count += packet.size > 0
    except (av.error.FFmpegError, ValueError):  # damaged: said when frames are read
        pass
    return count


def _turns(frame: VideoFrame, stream: VideoStream) -> int:
    """Return by how many quarter turns, counterclockwise, the frame is to be turned to be upright."""
    degrees = getattr(frame, "rotation", None)
    if degrees is None:  # PyAV before 14
        degrees = (getattr(stream, "side_data", None) or {}).get("DISPLAYMATRIX", 0)
    return round(float(degrees) / 90) % 4


def _one_line(error: Exception) -> str:
    return " ".join((getattr(error, "strerror", "") or str(error)).split())
