# SPDX-License-Identifier: Apache-2.0
"""What every storage of a bag gives: channels, messages in time order, warnings; and how several are read as one."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from imgu_ros.params import LimitsParameters

#: Of whoever has no parameters at hand.
DEFAULT_LIMITS = LimitsParameters()
#: No chunk and no message of a sane bag is larger; a forged length must not make us allocate it.
MAX_BYTES = 2**30
#: Times of messages are signed 64-bit nanoseconds everywhere in ROS.
MAX_TIME_NS = 2**63 - 1

_MAX_COUNTED = 10_000


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
    data : its serialised bytes, decompressed
    """

    channel: Channel
    time_ns: int
    data: bytes | memoryview


class Warnings:
    """What is missing or damaged: each kind once, with a count, so that a bad bag cannot fill the memory."""

    def __init__(self) -> None:
        self._kinds: dict[str, set[str]] = {}
        self._first: dict[str, str] = {}

    def add(self, text: str, kind: str = "") -> None:
        """Note `text`, once; of several with the same `kind` the first is kept and the others are counted."""
        key = kind or text
        self._first.setdefault(key, text)
        texts = self._kinds.setdefault(key, set())
        if len(texts) < _MAX_COUNTED:
            texts.add(text)

    def listed(self) -> tuple[str, ...]:
        """Return one line for each kind."""
        return tuple(self._line(text, len(self._kinds[key]) - 1) for key, text in self._first.items())

    @staticmethod
    def _line(text: str, others: int) -> str:
        if not others:
            return text
        return f"{text} (and {others}{' or more' if others + 1 == _MAX_COUNTED else ''} others)"


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

    def messages(self, topics: Collection[str] | None) -> Iterator[RawMessage]:
        """Yield the messages of `topics` (None: all) in time order; damage is skipped and noted as a warning."""

    def close(self) -> None:
        """Release the file."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A stretch of messages that can be opened late.

    Attributes
    ----------
    start_ns : no message is earlier
    open : gives the messages in time order
    """

    start_ns: int
    open: Callable[[], Iterator[RawMessage]]


def merge_by_time(parts: Iterable[Part]) -> Iterator[RawMessage]:
    """Yield the messages of all parts in time order; equal times in the order of the parts.

    A part is opened when its turn comes, so that only parts that overlap in time are in memory together.
    """
    waiting = sorted(enumerate(parts), key=lambda numbered: numbered[1].start_ns)
    waiting.reverse()  # taken from the end
    heap: list[tuple[int, int, RawMessage, Iterator[RawMessage]]] = []
    while waiting or heap:
        while waiting and (not heap or waiting[-1][1].start_ns <= heap[0][0]):
            number, part = waiting.pop()
            source = part.open()
            first = next(source, None)
            if first is not None:
                heapq.heappush(heap, (first.time_ns, number, first, source))
        if not heap:
            continue
        _, number, message, source = heap[0]
        following = next(source, None)
        if following is None:
            heapq.heappop(heap)
        else:
            heapq.heapreplace(heap, (following.time_ns, number, following, source))
        yield message


def seconds(time_ns: int) -> str:
    """Return a time as warnings give it."""
    return f"{time_ns // 10**9}.{time_ns % 10**9:09d} s"
