# SPDX-License-Identifier: Apache-2.0
"""Pairs each image with the camera_info that describes it, by stamp.

The order of arrival differs between a bag and a live graph, and between two runs of a live graph. The rules below
look at stamps and at each topic's own order, so that the pairs are the same in every interleaving in which no topic
runs ahead of the other by more than the hold depth:

- Images leave in the order in which they came.
- A camera_info with the image's stamp is its match. Of several with one stamp the last to arrive counts.
- An image without a match waits, until its match arrives; or a camera_info with a later stamp, since then its own was
  lost; or `hold` more images. In the last two cases it falls back to the camera_info with the latest stamp before its
  own; where there is none (a recording that starts between the two, stamps of different clocks) to the first after
  it; and to none when no camera_info has come at all.
- After `_PATIENCE` images in a row without a match (camera_info latched, sent at a lower rate, or not at all) images
  no longer wait, so that they are not late for nothing; the first match, or a camera_info that comes just after its
  image, ends that.
- Stamps that jump back by more than a second start a new recording (a bag played in a loop): camera_info from after
  the jump's target is forgotten, since it would make everything look lost; the newest of it serves until another
  comes (camera_info that is sent once, a stamp of 0 among others).
"""

from __future__ import annotations

from collections import OrderedDict, deque
from dataclasses import dataclass
from typing import Generic, TypeVar

from imgu_ros.errors import ParameterError

ImageT = TypeVar("ImageT")
InfoT = TypeVar("InfoT")

_HOLD = 2
_PATIENCE = 10
_KEPT_INFOS = 256
_JUMP_NS = 1_000_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Pair(Generic[ImageT, InfoT]):
    """An image and the camera_info to decode it with.

    Attributes
    ----------
    stamp_ns : the image's stamp
    image : as given
    camera_info : as given; None when there is none
    matched : whether the stamps are equal; False too when no camera_info is expected
    """

    stamp_ns: int
    image: ImageT
    camera_info: InfoT | None
    matched: bool


class Pairing(Generic[ImageT, InfoT]):
    """Pairs the messages of one image topic and one camera_info topic; see the module for the rules.

    Every method returns the pairs that it completed, in order. At most `hold` + 1 images and 256 camera_info are kept.
    Not thread-safe: a node calls it under a lock, or from one callback group.

    Parameters
    ----------
    expects_camera_info : False: every image passes at once, alone
    hold : images that may come after one before it stops waiting, >= 0; ParameterError when negative

    Attributes
    ----------
    matched, unmatched : images that left with, and without, a camera_info of their own stamp; not counted when none
        is expected
    misses_in_a_row : images without one since the last match, or since a camera_info came late for its image
    last_image_ns, last_info_ns : the latest stamp of each topic; None before the first message
    """

    def __init__(self, *, expects_camera_info: bool = True, hold: int = _HOLD) -> None:
        if hold < 0:
            raise ParameterError(f"hold: {hold}; need 0 or more")
        self.matched = 0
        self.unmatched = 0
        self.misses_in_a_row = 0
        self.last_image_ns: int | None = None
        self.last_info_ns: int | None = None
        self._expects = expects_camera_info
        self._hold = hold
        self._waiting: deque[_Waiting[ImageT]] = deque()
        self._infos: OrderedDict[int, InfoT] = OrderedDict()  # by stamp, in order of arrival
        self._missed: deque[int] = deque(maxlen=_PATIENCE)  # stamps of the last images without a match
        self._forgotten: InfoT | None = None

    def add_image(self, stamp_ns: int, image: ImageT) -> list[Pair[ImageT, InfoT]]:
        """Take the next image."""
        if not self._expects:
            return [Pair(stamp_ns, image, None, False)]
        if self.last_image_ns is not None and stamp_ns < self.last_image_ns - _JUMP_NS:
            self._forget_after(stamp_ns)
        self.last_image_ns = stamp_ns
        self._waiting.append(_Waiting(stamp_ns, image))
        return self._completed(self._depth())

    def add_camera_info(self, stamp_ns: int, camera_info: InfoT) -> list[Pair[ImageT, InfoT]]:
        """Take the next camera_info."""
        if not self._expects:
            return []
        if self.last_info_ns is not None and stamp_ns < self.last_info_ns - _JUMP_NS:
            self._forget_after(stamp_ns)
        self.last_info_ns = stamp_ns
        self._infos.pop(stamp_ns, None)
        self._infos[stamp_ns] = camera_info
        if len(self._infos) > _KEPT_INFOS:
            self._infos.popitem(last=False)
        if stamp_ns in self._missed:
            self.misses_in_a_row = 0
        return self._completed(self._depth())

    def flush(self) -> list[Pair[ImageT, InfoT]]:
        """Complete every image that still waits: nothing more will come."""
        return self._completed(0)

    def _depth(self) -> int:
        return self._hold if self.misses_in_a_row < _PATIENCE else 0

    def _completed(self, depth: int) -> list[Pair[ImageT, InfoT]]:
        """Take images from the head of the queue while each is matched, given up, or pushed out by `depth` others."""
        pairs: list[Pair[ImageT, InfoT]] = []
        while self._waiting:
            head = self._waiting[0]
            matched = head.stamp_ns in self._infos
            if not matched and len(self._waiting) <= depth and not self._is_overtaken(head.stamp_ns):
                break
            self._waiting.popleft()
            camera_info = self._infos[head.stamp_ns] if matched else self._nearest(head.stamp_ns)
            self._count(head.stamp_ns, matched)
            pairs.append(Pair(head.stamp_ns, head.image, camera_info, matched))
        return pairs

    def _is_overtaken(self, stamp_ns: int) -> bool:
        return any(info_ns > stamp_ns for info_ns in self._infos)

    def _nearest(self, stamp_ns: int) -> InfoT | None:
        """Return the latest camera_info before a stamp, else the first after it, else one of before a jump, or None."""
        if not self._infos:
            return self._forgotten
        earlier = [info_ns for info_ns in self._infos if info_ns < stamp_ns]
        return self._infos[max(earlier) if earlier else min(self._infos)]

    def _count(self, stamp_ns: int, matched: bool) -> None:
        if matched:
            self.matched += 1
            self.misses_in_a_row = 0
        else:
            self.unmatched += 1
            self.misses_in_a_row += 1
            self._missed.append(stamp_ns)

    def _forget_after(self, stamp_ns: int) -> None:
        for info_ns in [ns for ns in self._infos if ns > stamp_ns + _JUMP_NS]:
            self._forgotten = self._infos.pop(info_ns)


@dataclass(frozen=True, slots=True, eq=False)
class _Waiting(Generic[ImageT]):
    stamp_ns: int
    image: ImageT
