# SPDX-License-Identifier: Apache-2.0
"""Why nothing comes out of a node: one cause, its words, and which causes the log has heard of."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum

#: A cause that was gone for so long is news when it comes back.
_FORGOTTEN_S = 60.0


class Kind(StrEnum):
    """What keeps poses from coming out, in the order in which it is looked for."""

    LIFECYCLE = "lifecycle"  #: the node is not active
    PAUSED = "paused"
    LISTENER = "listener"  #: somebody listens with a quality of service that no output fits
    IDLE = "idle"  #: nobody listens
    CLOCK = "clock"  #: use_sim_time, and /clock stands still
    MEMORY = "shared_memory"  #: it is full
    NO_PUBLISHER = "no_publisher"
    WRONG_TYPE = "wrong_type"
    QOS = "qos"  #: the input's publishers offer less than is asked for
    HELD_UP = "held_up"  #: the process stood still, or one frame holds the worker
    LOST = "lost"  #: images are lost on the way
    SILENT = "silent"  #: a publisher, and no images
    REJECTED = "rejected"  #: images come and cannot be read
    NO_TARGETS = "no_targets"
    WAITING = "waiting"  #: for the first frame
    UNCALIBRATED = "uncalibrated"
    UNPAIRED = "unpaired"  #: no camera_info has an image's stamp
    NOT_SEEN = "not_seen"
    NO_POSE = "no_pose"  #: a target is seen, and its pose is ambiguous or its size unknown
    FRAMES = "frames"  #: there are poses, and no place for them among the frames of the map and of /tf
    PUBLISHERS = "publishers"  #: poses come out, and several cameras share a topic
    FRAME_ID = "frame_id"  #: poses come out, and the images' frame_id is no name of a frame
    STAMPS = "stamps"  #: poses come out, and the images' stamps do not rise, or are of another clock
    SIZE = "size"  #: poses come out, and a target is implausibly far for its width


@dataclass(frozen=True, slots=True)
class Cause:
    """Why nothing comes out.

    Attributes
    ----------
    kind : what it is
    text : one line of words, with what to do
    is_logged : whether it is logged elsewhere
    case : which of its kind it is, when several can hold at once
    """

    kind: Kind
    text: str
    is_logged: bool = False
    case: str = ""


#: What every node does for a while, or was asked to do; and what is logged where it happens.
_NOT_LOGGED = frozenset((Kind.IDLE, Kind.WAITING, Kind.REJECTED, Kind.FRAMES))


class CauseLog:
    """Tells which causes are new, so that the log has each kind, and each case of it, once.

    A cause is told again when it comes back after a minute without it.
    """

    def __init__(self) -> None:
        self._seen_s: dict[tuple[Kind, str], float] = {}

    def news(self, causes: Iterable[Cause], now_s: float) -> Iterator[Cause]:
        """Yield the causes that the log has not heard of; `now_s` is monotonic."""
        for cause in causes:
            if cause.kind in _NOT_LOGGED or cause.is_logged:
                continue
            key = (cause.kind, cause.case)
            last_s = self._seen_s.get(key)
            self._seen_s[key] = now_s
            if last_s is None or now_s - last_s > _FORGOTTEN_S:
                yield cause

    def clear(self) -> None:
        """Forget what was told: the node begins anew."""
        self._seen_s.clear()
