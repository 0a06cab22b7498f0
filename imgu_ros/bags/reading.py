# SPDX-License-Identifier: Apache-2.0
"""Read recorded bags, whole or damaged: rosbag1, and rosbag2 in SQLite or MCAP, compressed or not."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Any, Self

from imgu_ros.bags.byte_file import ByteFile
from imgu_ros.bags.chunked import ChunkedStorage
from imgu_ros.bags.compression import ZSTD_MAGIC, decompress_file
from imgu_ros.bags.decoding import MessageDecoder
from imgu_ros.bags.mcap_format import MAGIC as MCAP_MAGIC
from imgu_ros.bags.mcap_format import mcap_records
from imgu_ros.bags.mcap_index import index_mcap
from imgu_ros.bags.rosbag1_format import MAGIC as ROSBAG1_MAGIC
from imgu_ros.bags.rosbag1_format import index_rosbag1, rosbag1_records
from imgu_ros.bags.rosbag2 import METADATA, splits
from imgu_ros.bags.sqlite import SqliteStorage
from imgu_ros.bags.storage import (
    DEFAULT_LIMITS,
    Channel,
    Part,
    RawMessage,
    Storage,
    Warnings,
    merge_by_time,
    seconds,
)
from imgu_ros.errors import BagError
from imgu_ros.params import LimitsParameters

_SQLITE_MAGIC = b"SQLite format 3\0"
_NEED = "need a ROS 1 bag, or a rosbag2 folder, .mcap or .db3 file"


@dataclass(frozen=True, slots=True)
class Topic:
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


def open_bag(paths: Sequence[Path], *, limits: LimitsParameters = DEFAULT_LIMITS) -> Bag:
    """Open one or several bags, to be read as one.

    Parameters
    ----------
    paths : each a ROS 1 bag, a rosbag2 folder (or its metadata.yaml), or a single .mcap, .db3 or .zstd file of one
    limits : what reading may cost

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
        raise BagError(f"no bag given; {_NEED}")
    _require_different(paths)
    with ExitStack() as stack:
        warnings = Warnings()
        storages = [storage for path in paths for storage in _storages(Path(path), warnings, stack, limits)]
        return Bag(storages, warnings, stack.pop_all(), limits)


class Bag:
    """One or several open bags, read as one, in time order and in bounded memory. Made by `open_bag`."""

    def __init__(
        self,
        storages: Sequence[Storage],
        warnings: Warnings,
        resources: ExitStack,
        limits: LimitsParameters = DEFAULT_LIMITS,
    ) -> None:
        self._storages = storages
        self._warnings = warnings
        self._resources = resources
        self._decoder = MessageDecoder(limits)
        self._is_open = True
        totals: dict[str, Topic] = {}
        for storage in storages:
            for channel, count in storage.counts.items():
                known = totals.get(channel.topic, Topic(channel.topic, channel.type_name, 0))
                totals[channel.topic] = Topic(known.name, known.type_name or channel.type_name, known.count + count)
        self._topics = tuple(totals.values())

    @property
    def topics(self) -> tuple[Topic, ...]:
        """The topics, in the bag's order."""
        return self._topics

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is missing or damaged, a line each; grows while messages are read."""
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
        for raw in self.raw_messages(topics):
            try:
                message = self._decoder.decoded(raw)
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
        for raw in merge_by_time(
            Part(storage.start_ns, partial(storage.messages, wanted)) for storage in self._with_messages()
        ):
            if not self._is_open:
                raise BagError("bag: closed while it was read; need an open bag")
            yield raw

    def cdr_messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Yield messages as bytes of CDR with its encapsulation, decompressed; those of ROS 1 bags are converted.

        A message that cannot be had so is skipped, and said in `warnings`.
        """
        for raw in self.raw_messages(topics):
            try:
                data = self._decoder.cdr(raw)
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

    def _warn_of_message(self, raw: RawMessage, error: BagError) -> None:
        channel: Channel = raw.channel
        reason = self._decoder.type_error(channel)
        if reason:
            self._warnings.add(f"{channel.topic}: its messages cannot be read: {reason}")
        else:
            self._warnings.add(
                f"{channel.topic}: the message at {seconds(raw.time_ns)} is damaged and skipped: {error}",
                kind=f"{channel.topic}: damaged messages",
            )


def _require_different(paths: Sequence[Path]) -> None:
    """Refuse a bag, or a file of a bag, beside itself: every frame would come twice."""
    known: dict[Path, Path] = {}
    for path in map(Path, paths):
        if path.parts and path.parts[0] == "file:":
            raise BagError(f"{path}: a URL; need a path, {_NEED.removeprefix('need ')}")
        real = path.resolve()
        real = real.parent if real.name == METADATA else real
        for earlier, given in known.items():
            if earlier in (real, real.parent) or earlier.parent == real:
                raise BagError(f"{path}: the same bag as {given}; need each bag once")
        known[real] = path


def _storages(path: Path, warnings: Warnings, stack: ExitStack, limits: LimitsParameters) -> list[Storage]:
    """Open all files of the bag at `path`; `stack` closes them."""
    if path.name == METADATA and path.is_file():
        path = path.parent
    if not path.is_dir():
        return [_opened(path, path.name, warnings, stack, limits)]
    storages: list[Storage] = []
    errors: list[BagError] = []
    for split in splits(path, warnings):
        try:
            storage = _opened(split.path, split.path.name, warnings, stack, limits)
        except BagError as error:
            errors.append(error)
            continue
        storages.append(storage)
        count = sum(storage.counts.values())
        if count < split.message_count:
            warnings.add(f"{split.path.name}: {count} of the {split.message_count} messages that {METADATA} announces")
    if errors and not storages:
        raise errors[0]
    for skipped in errors:
        warnings.add(f"skipped: {skipped}")
    return storages


def _opened(path: Path, name: str, warnings: Warnings, stack: ExitStack, limits: LimitsParameters) -> Storage:
    """Open one file, whatever its name says, by its first bytes."""
    file = ByteFile(path)
    try:
        if not path.is_file():
            raise BagError(f"{path}: not a regular file; {_NEED}")
        if file.size == 0:
            raise BagError(f"{path}: empty file; {_NEED}")
        magic = file.read(0, min(file.size, 16))
        storage: Storage
        if magic.startswith(MCAP_MAGIC):
            storage = ChunkedStorage(file, name, warnings, index_mcap(file), mcap_records, limits)
        elif magic.startswith(ROSBAG1_MAGIC):
            storage = ChunkedStorage(file, name, warnings, index_rosbag1(file), rosbag1_records, limits)
        elif magic == _SQLITE_MAGIC:
            file.close()
            storage = SqliteStorage(path, name, warnings, limits)
        elif magic.startswith(ZSTD_MAGIC) and path.suffix == ".zstd":
            file.close()
            return _decompressed(path, name, warnings, stack, limits)
        else:
            raise BagError(f"{path}: not a bag (begins with {magic[:8].hex()}); {_NEED}")
    except BaseException:
        file.close()
        raise
    stack.callback(storage.close)
    return storage


def _decompressed(path: Path, name: str, warnings: Warnings, stack: ExitStack, limits: LimitsParameters) -> Storage:
    """Open a file that rosbag2 compressed as a whole, from a temporary copy that `stack` removes."""
    try:
        folder = Path(stack.enter_context(TemporaryDirectory(prefix="imgu_bag_")))
    except OSError as error:
        raise BagError(f"{path}: no temporary folder to decompress it: {error.strerror}") from None
    plain = folder / (path.stem or "bag")
    damage = decompress_file(path, plain, limits)
    if damage:
        warnings.add(f"{name}: {damage}")
    if plain.stat().st_size == 0:
        raise BagError(f"{path}: nothing can be decompressed ({damage or 'it is empty'}); {_NEED}")
    return _opened(plain, name, warnings, stack, limits)
