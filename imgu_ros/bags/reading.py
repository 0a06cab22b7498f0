# SPDX-License-Identifier: Apache-2.0
"""Open and read recordings, intact or damaged: ROS 1 bags, and rosbag2 in SQLite or MCAP, compressed or not."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from imgu_ros.bags.compression import Expansion, decompressed_message
from imgu_ros.bags.decoding import MessageDecoder
from imgu_ros.bags.frame_files import InputKind, UnreadableFrame, recording_files
from imgu_ros.bags.opening import NEED, FileOpener, require_different
from imgu_ros.bags.pictures import PictureStorage
from imgu_ros.bags.storage import Channel, RawMessage, Storage, WarningLog, merge_by_time, seconds
from imgu_ros.bags.videos import VideoStorage
from imgu_ros.config.parameters import DEFAULT_LIMITS, LimitsParameters
from imgu_ros.errors import BagError


@dataclass(frozen=True, slots=True)
class BagTopic:
    """A topic of a bag: its name, its type ("package/msg/Name"; empty when unknown), and its number of messages."""

    name: str
    type_name: str
    count: int


@dataclass(frozen=True, slots=True, eq=False)
class BagMessage:
    """A recorded message.

    Attributes
    ----------
    topic : where it was recorded
    type_name : "package/msg/Name"
    time_ns : when it was recorded, nanoseconds since the epoch
    message : with ROS 2's field names; numeric arrays are numpy arrays, some of them read-only
    """

    topic: str
    type_name: str
    time_ns: int
    message: Any


def open_bag(paths: Sequence[Path], *, limits: LimitsParameters = DEFAULT_LIMITS, rate_hz: float = 0.0) -> Bag:
    """Open one or several recordings, to be read as one: bags, videos, or pictures.

    Videos and pictures are one topic, `/image_raw`. A video's time 0 is its first frame; several follow one another.

    Parameters
    ----------
    paths : bags: each a ROS 1 bag, a rosbag2 folder (or its metadata.yaml), or a single .mcap, .db3 or .zstd file of
        one; or video files; or pictures; or folders of, or patterns for, one of these
    limits : what reading may cost
    rate_hz : pictures a second; 0: their names or Exif tell when they were taken, see `PictureStorage`

    Returns
    -------
    Bag
        A context manager.

    Raises
    ------
    BagError
        If one of the paths holds nothing that can be read, or is named twice; what is only in part readable becomes a
        warning.
    """
    if not paths:
        raise BagError(f"no bag given; {NEED}")
    files = recording_files(paths)
    require_different(files.paths)
    if rate_hz and files.kind is not InputKind.PICTURES:
        raise BagError(f"rate: {rate_hz:g} Hz for a {files.kind}, which has times; need it for pictures alone")
    warnings = WarningLog()
    with ExitStack() as stack:
        storages: list[Storage]
        match files.kind:
            case InputKind.VIDEO:
                storages = [VideoStorage(files.paths, warnings)]
            case InputKind.PICTURES:
                storages = [PictureStorage(files.paths, rate_hz, warnings, limits)]
            case InputKind.BAG:
                opening = FileOpener(limits, warnings, stack)
                storages = [storage for path in files.paths for storage in opening.storages(path)]
        return Bag(storages, warnings, stack.pop_all(), limits)


class Bag:
    """One or several open bags, read as one, in time order and in bounded memory. Made by `open_bag`."""

    def __init__(
        self,
        storages: Sequence[Storage],
        warnings: WarningLog,
        resources: ExitStack,
        limits: LimitsParameters = DEFAULT_LIMITS,
    ) -> None:
        self._storages = storages
        self._warnings = warnings
        self._resources = resources
        self._decoder = MessageDecoder(limits)
        self._limits = limits
        self._is_open = True
        totals: dict[str, BagTopic] = {}
        for storage in storages:
            for channel, count in storage.counts.items():
                known = totals.get(channel.topic, BagTopic(channel.topic, channel.type_name, 0))
                totals[channel.topic] = BagTopic(known.name, known.type_name or channel.type_name, known.count + count)
        self._topics = tuple(totals.values())

    @property
    def topics(self) -> tuple[BagTopic, ...]:
        """The topics, in the bag's order."""
        return self._topics

    @property
    def warnings(self) -> tuple[str, ...]:
        """Reports of missing or damaged parts, a line each; more come while messages are read."""
        return self._warnings.listed()

    @property
    def message_count(self) -> int:
        """Messages of all topics; of a damaged bag, those that its readable index tells of."""
        return sum(topic.count for topic in self._topics)

    @property
    def start_ns(self) -> int:
        """Time of the first message; 0 when there is none."""
        return min((storage.start_ns for storage in self._with_messages()), default=0)

    @property
    def end_ns(self) -> int:
        """Time of the last message; 0 when there is none."""
        return max((storage.end_ns for storage in self._with_messages()), default=0)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[BagMessage]:
        """Yield the messages of `topics` (None: all) in the order of their recording.

        A message or a topic that cannot be read is skipped, and said in `warnings`. Can be called again, for another
        pass.

        Raises
        ------
        BagError
            If the bag is closed.
        """
        expansion = Expansion(self._limits)
        for raw in self.raw_messages(topics):
            try:
                message = raw.message
                if message is None:
                    message = self._decoder.decoded(self._plain(raw, expansion))
            except BagError as error:
                self._warn_of_message(raw, error)
                continue
            yield BagMessage(raw.channel.topic, raw.channel.type_name, raw.time_ns, message)

    def raw_messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Yield the messages of `topics` (None: all) as they were serialised, in the order of their recording.

        Raises
        ------
        BagError
            If the bag is closed.
        """
        wanted = None if topics is None else frozenset(topics)
        parts = [storage.parts(wanted) for storage in self._with_messages()]
        # Half as much again, so that a chunk of the largest size may overlap with others.
        for raw in merge_by_time(parts, 1_500_000 * self._limits.message_mb, self._warn_of_disorder):
            if not self._is_open:
                break
            yield raw
        if not self._is_open:
            raise BagError("bag: closed while it was read; need an open bag")

    def cdr_messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Yield messages as bytes of CDR with its encapsulation, decompressed; those of ROS 1 bags are converted.

        A message that cannot be had so is skipped, and said in `warnings`.
        """
        expansion = Expansion(self._limits)
        for raw in self.raw_messages(topics):
            try:
                if isinstance(raw.message, UnreadableFrame):
                    raise BagError(raw.message.reason)
                data = self._decoder.cdr(self._plain(raw, expansion))
            except BagError as error:
                self._warn_of_message(raw, error)
                continue
            yield RawMessage(raw.channel, raw.time_ns, data)

    def close(self) -> None:
        """Close all files; closing twice does nothing."""
        self._is_open = False
        self._resources.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _with_messages(self) -> list[Storage]:
        if not self._is_open:
            raise BagError("bag: closed; need an open bag")
        return [storage for storage in self._storages if any(storage.counts.values())]

    def _plain(self, raw: RawMessage, expansion: Expansion) -> RawMessage:
        """Return the message, decompressed when rosbag2 compressed it by itself."""
        data = decompressed_message(raw.data, self._limits, expansion)
        return raw if data is raw.data else RawMessage(raw.channel, raw.time_ns, data)

    def _warn_of_disorder(self) -> None:
        self._warnings.add(
            "messages come out of the order of their times: the times of their chunks are wrong, or chunks that "
            f"overlap take more than {1.5 * self._limits.message_mb:.0f} MB (limits.message_mb)"
        )

    def _warn_of_message(self, raw: RawMessage, error: BagError) -> None:
        channel: Channel = raw.channel
        kind = f"{channel.topic}: damaged messages"
        if self._warnings.is_full(kind):
            return
        reason = self._decoder.type_error(channel)
        if reason:
            self._warnings.add(f"{channel.topic}: its messages cannot be read: {reason}")
        else:
            self._warnings.add(
                f"{channel.topic}: the message at {seconds(raw.time_ns)} is damaged and skipped: {error}",
                kind=kind,
            )
