# SPDX-License-Identifier: Apache-2.0
"""The interface of a storage: channels, messages in time order, warnings; and the merge of several by time."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from operator import itemgetter
from typing import Any, Protocol

from imgu_ros.shown_text import shown

#: Times of messages are signed 64-bit nanoseconds everywhere in ROS.
MAX_TIME_NS = 2**63 - 1

_MAX_COUNTED = 10_000
#: What an open part holds beside its data.
_OPEN_BYTES = 4096


class Serialization(StrEnum):
    """How the bytes of a message came about."""

    CDR = "cdr"
    ROS1 = "ros1"


def serialization_named(text: str) -> str:
    """Return how messages are serialised by the name that a file gives to it, in any case; CDR when it gives none."""
    return text.strip().lower() or Serialization.CDR


@dataclass(frozen=True, slots=True)
class Channel:
    """One stream of messages in one file.

    Attributes
    ----------
    topic : as recorded
    type_name : "package/msg/Name"
    serialization : "cdr", "ros1", or what else the file says
    schema_format : "ros2msg", "ros2idl", "ros1msg"; empty: the file has no definition
    schema : the type's definition with those that it needs
    """

    topic: str
    type_name: str
    serialization: str
    schema_format: str
    schema: str


@dataclass(frozen=True, slots=True, eq=False)
class RawMessage:
    """A message as recorded.

    Attributes
    ----------
    channel : where it belongs
    time_ns : when it was recorded
    data : its serialised bytes, decompressed; none where the message was made here
    message : made here, of a video's or a picture's pixels; None: it is in `data`
    """

    channel: Channel
    time_ns: int
    data: bytes | memoryview
    message: Any = None


class WarningLog:
    """Warnings of missing or damaged parts: each kind once, with a count, so that they take bounded memory."""

    def __init__(self) -> None:
        self._kinds: dict[str, set[str]] = {}
        self._first: dict[str, str] = {}

    def add(self, text: str, kind: str = "") -> None:
        """Note `text`, once; of several with the same `kind` the first is kept and the others are counted."""
        text = shown(text)  # with names of any length
        key = shown(kind) or text
        self._first.setdefault(key, text)
        texts = self._kinds.setdefault(key, set())
        if len(texts) < _MAX_COUNTED:
            texts.add(text)

    def is_full(self, kind: str) -> bool:
        """Whether no more texts of a kind are counted: to make another is of no use."""
        return len(self._kinds.get(shown(kind), ())) >= _MAX_COUNTED

    def listed(self) -> tuple[str, ...]:
        """Return one line for each kind."""
        return tuple(self._line(text, len(self._kinds[key]) - 1) for key, text in self._first.items())

    @staticmethod
    def _line(text: str, others: int) -> str:
        if not others:
            return text
        return f"{text} (and {others}{' or more' if others + 1 == _MAX_COUNTED else ''} others)"


@dataclass(frozen=True, slots=True, eq=False)
class MessageBlock:
    """A extent of messages that can be opened late.

    Attributes
    ----------
    start_ns : no message is earlier
    open : gives the messages in time order
    place : among the parts of its storage, where times are equal
    size : bytes that it holds while it is open
    """

    start_ns: int
    open: Callable[[], Iterator[RawMessage]]
    place: int = 0
    size: int = 0


class Storage(Protocol):
    """One file of a bag.

    Attributes
    ----------
    counts : messages of each channel, in the order of the file
    start_ns, end_ns : times of the first and the last message; both 0 when there is none
    """

    @property
    def counts(self) -> dict[Channel, int]:
        """Messages of each channel."""

    @property
    def start_ns(self) -> int:
        """Time of the first message."""

    @property
    def end_ns(self) -> int:
        """Time of the last message."""

    def parts(self, topics: Collection[str] | None) -> Iterator[MessageBlock]:
        """Yield what holds the messages of `topics` (None: all), in the order of its beginning.

        Damage is skipped and noted as a warning.
        """

    def close(self) -> None:
        """Release the file."""


def merge_by_time(
    storages: Iterable[Iterator[MessageBlock]], most_bytes: int, on_disorder: Callable[[], None] = lambda: None
) -> Iterator[RawMessage]:
    """Yield the messages of all storages in time order; equal times in the order of storages and their parts.

    A part is opened when its turn comes, so that only parts that overlap in time are in memory together. Those that are
    more than `most_bytes` wait until one of them is done; `on_disorder` is called when a message then comes too late.
    """
    waiting = heapq.merge(*(_numbered(number, parts) for number, parts in enumerate(storages)), key=itemgetter(0))
    heap: list[tuple[int, int, int, int, RawMessage, Iterator[RawMessage]]] = []
    held, latest_ns = 0, 0
    upcoming = next(waiting, None)
    while upcoming is not None or heap:
        while upcoming is not None and (not heap or upcoming[0][0] <= heap[0][0]):
            (_, number, place), part = upcoming
            size = part.size + _OPEN_BYTES
            if heap and held + size > most_bytes:
                break
            source = part.open()
            first = next(source, None)
            if first is not None:
                held += size
                heapq.heappush(heap, (first.time_ns, number, place, size, first, source))
            upcoming = next(waiting, None)
        if not heap:
            continue
        time_ns, number, place, size, message, source = heap[0]
        following = next(source, None)
        if following is None:
            heapq.heappop(heap)
            held -= size
        else:
            heapq.heapreplace(heap, (following.time_ns, number, place, size, following, source))
        if time_ns < latest_ns:
            on_disorder()
        latest_ns = max(latest_ns, time_ns)
        yield message


def _numbered(number: int, parts: Iterator[MessageBlock]) -> Iterator[tuple[tuple[int, int, int], MessageBlock]]:
    return (((part.start_ns, number, part.place), part) for part in parts)


def seconds(time_ns: int) -> str:
    """Return a time as warnings give it."""
    return f"{time_ns // 10**9}.{time_ns % 10**9:09d} s"
