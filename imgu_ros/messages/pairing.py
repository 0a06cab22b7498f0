# SPDX-License-Identifier: Apache-2.0
"""Pairs each image with the camera_info that describes it, by stamp and frame_id.

The order of arrival differs between a bag and a live graph, and between two runs of a live graph. The rules below
look at stamps and at each topic's own order, so that the pairs are the same in every interleaving in which no topic
runs ahead of the other by more than the hold depth:

- Images of one frame_id leave in the order in which they came. Each frame_id is paired by itself: several cameras may
  share the topics.
- An image's camera_info are those of its own frame_id. Where there are none (drivers that name the two differently)
  they are those whose frame_id no image has had so far; the first image waits for two more before it takes them, for
  its own may follow. A camera whose camera_info comes later than that, and whose images come later still, may lend it.
- A camera_info with the image's stamp is its match. Of several with one stamp the last to arrive counts.
- An image without a match waits, until its match arrives; or a camera_info with a later stamp (by a second at most:
  those of another clock tell nothing), since then its own was lost; or `hold` more images. In the last two cases it
  falls back to the camera_info with the latest stamp before its own; where there is none (a recording that starts
  between the two, stamps of different clocks) to the first after it; and to none when no camera_info has come at all.
- After `_PATIENCE` images in a row without a match (camera_info latched, sent at a lower rate, or not at all) images
  no longer wait, so that they are not late for nothing; the first match, or a camera_info that comes just after its
  image, ends that.
- Stamps that jump back by more than a second start a new recording (a bag played in a loop): camera_info from after
  the jump's target is forgotten, since it would make everything look lost; the newest of it serves until another
  comes (camera_info that is sent once, a stamp of 0 among others).
"""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from imgu_ros.errors import ParameterError

ImageT = TypeVar("ImageT")
InfoT = TypeVar("InfoT")

_HOLD = 2
_PATIENCE = 10
_KEPT_INFOS = 256
_JUMP_NS = 1_000_000_000
#: So many frame_ids are kept apart, of images and of camera_info.
_CAMERAS = 8
#: A frame_id is no camera's any more when another one has had so many images since. Endlessly many names age none.
_FORGOTTEN = 100


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

    Every method returns the pairs that it completed, in order. For each of at most 8 frame_ids at most `hold` + 1
    images and 256 camera_info are kept. Not thread-safe: a node calls it under a lock, or from one callback group.

    Parameters
    ----------
    expects_camera_info : False: every image passes at once, alone
    hold : images that may come after one before it stops waiting, >= 0; ParameterError when negative

    Attributes
    ----------
    matched, unmatched : images that left with, and without, a camera_info of their own stamp; not counted when none
        is expected
    misses_in_a_row : images without one since the last match, or since a camera_info came late for its image
    foreign_in_a_row : images that left without any camera_info, as all that came are other cameras', since the last
        that had one
    last_image_ns, last_info_ns : the latest stamp of each topic; None before the first message
    """

    def __init__(self, *, expects_camera_info: bool = True, hold: int = _HOLD) -> None:
        if hold < 0:
            raise ParameterError(f"hold: {hold}; need 0 or more")
        self.matched = 0
        self.unmatched = 0
        self.misses_in_a_row = 0
        self.foreign_in_a_row = 0
        self.last_image_ns: int | None = None
        self.last_info_ns: int | None = None
        self._expects = expects_camera_info
        self._hold = hold
        # By frame_id, that of the last message last.
        self._cameras: OrderedDict[str, _Camera[ImageT]] = OrderedDict()
        self._infos: OrderedDict[str, _Infos[InfoT]] = OrderedDict()

    def add_image(self, stamp_ns: int, image: ImageT, frame_id: str = "") -> list[Pair[ImageT, InfoT]]:
        """Take the next image."""
        if not self._expects:
            return [Pair(stamp_ns, image, None, False)]
        self.last_image_ns = stamp_ns
        camera = self._cameras.setdefault(frame_id, _Camera(knows_its_infos=not frame_id))
        camera.images += 1
        self._cameras.move_to_end(frame_id)
        pairs = self._forget_cameras()
        if camera.last_ns is not None and stamp_ns < camera.last_ns - _JUMP_NS:
            for infos in self._infos_of(frame_id, camera):
                infos.forget_after(stamp_ns)
        camera.last_ns, camera.others = stamp_ns, {name: other.images for name, other in self._cameras.items()}
        camera.waiting.append(_WaitingImage(stamp_ns, image))
        return pairs + self._completed(frame_id, camera)

    def add_camera_info(self, stamp_ns: int, camera_info: InfoT, frame_id: str = "") -> list[Pair[ImageT, InfoT]]:
        """Take the next camera_info."""
        if not self._expects:
            return []
        self.last_info_ns = stamp_ns
        self._infos.setdefault(frame_id, _Infos()).add(stamp_ns, camera_info)
        self._infos.move_to_end(frame_id)
        if len(self._infos) > _CAMERAS:
            # Those that images have matched are the last to go, then those of a camera whose images come.
            lenders = {camera.lender for camera in self._cameras.values()}
            others = list(self._infos)[:-1]
            self._infos.pop(min(others, key=lambda name: (name in lenders, name in self._cameras)))
        pairs = []
        for name, camera in self._cameras.items():
            if name == frame_id or self._infos[frame_id] in self._infos_of(name, camera):
                if stamp_ns in camera.missed:
                    self.misses_in_a_row = camera.misses_in_a_row = 0
                pairs += self._completed(name, camera)
        return pairs

    def flush(self, is_due: Callable[[ImageT], bool] = lambda _: True) -> list[Pair[ImageT, InfoT]]:
        """Complete the images that still wait, at the end of the input; or those of cameras whose last one is due."""
        return [
            pair
            for name, camera in self._cameras.items()
            if camera.waiting and is_due(camera.waiting[-1].image)
            for pair in self._completed(name, camera, depth=0)
        ]

    def is_any(self, is_due: Callable[[ImageT], bool]) -> bool:
        """Return whether `flush` would complete an image."""
        return any(camera.waiting and is_due(camera.waiting[-1].image) for camera in self._cameras.values())

    def _infos_of(self, frame_id: str, camera: _Camera[ImageT]) -> list[_Infos[InfoT]]:
        """Return the camera_info that may be a camera's: of its name, else of its lender, else of no camera's name."""
        for name in (frame_id, camera.lender):
            if name is not None and name in self._infos:
                return [self._infos[name]]
        return [infos for name, infos in self._infos.items() if name not in self._cameras]

    def _completed(self, frame_id: str, camera: _Camera[ImageT], depth: int | None = None) -> list[Pair[ImageT, InfoT]]:
        """Take images from the head of the queue while each is matched, given up, or pushed out by `depth` others."""
        if depth is None:
            depth = self._hold if camera.misses_in_a_row < _PATIENCE else 0
        pairs: list[Pair[ImageT, InfoT]] = []
        while camera.waiting:
            head = camera.waiting[0]
            candidates = self._infos_of(frame_id, camera)
            if len(camera.waiting) > depth or frame_id in self._infos:
                camera.knows_its_infos = True
            if camera.knows_its_infos:
                match = next((infos for infos in candidates if head.stamp_ns in infos.by_stamp), None)
                is_over = len(camera.waiting) > depth or any(infos.overtake(head.stamp_ns) for infos in candidates)
            else:
                match, is_over = None, False
            if match is None and not is_over:
                break
            camera.waiting.popleft()
            if match is not None:
                camera.lender = next(name for name, infos in self._infos.items() if infos is match)
                info: InfoT | None = match.by_stamp[head.stamp_ns]
            else:
                info = _nearest(candidates, head.stamp_ns)
            self._count(camera, head.stamp_ns, match is not None)
            self.foreign_in_a_row = self.foreign_in_a_row + 1 if info is None and self._infos else 0
            pairs.append(Pair(head.stamp_ns, head.image, info, match is not None))
        return pairs

    def _count(self, camera: _Camera[ImageT], stamp_ns: int, matched: bool) -> None:
        if matched:
            self.matched += 1
            self.misses_in_a_row = camera.misses_in_a_row = 0
        else:
            self.unmatched += 1
            self.misses_in_a_row += 1
            camera.misses_in_a_row += 1
            camera.missed.append(stamp_ns)

    def _forget_cameras(self) -> list[Pair[ImageT, InfoT]]:
        """Forget frame_ids that no image has any more, and of too many the least used; return their waiting images."""
        *others, newest = self._cameras
        count = self._cameras[newest].images
        gone = [name for name in others if count - self._cameras[name].others.get(newest, 0) > _FORGOTTEN]
        if len(self._cameras) - len(gone) > _CAMERAS:

            def usage(name: str) -> tuple[bool, int]:
                return self._cameras[name].lender is not None, self._cameras[name].images

            gone.append(min((name for name in others if name not in gone), key=usage))
        pairs = []
        for name in gone:
            pairs += self._completed(name, self._cameras[name], depth=0)
            del self._cameras[name]
        return pairs


@dataclass(frozen=True, slots=True, eq=False)
class _WaitingImage(Generic[ImageT]):
    stamp_ns: int
    image: ImageT


@dataclass(slots=True, eq=False)
class _Camera(Generic[ImageT]):
    """The images of one frame_id.

    Attributes
    ----------
    knows_its_infos : whether it is clear which camera_info are its own
    lender : the frame_id of the camera_info that the last match had
    missed : stamps of the last images without a match
    last_ns : stamp of the last image
    images : how many have come
    others : how many had come of each frame_id when the last one came
    """

    knows_its_infos: bool
    lender: str | None = None
    waiting: deque[_WaitingImage[ImageT]] = field(default_factory=deque)
    missed: deque[int] = field(default_factory=lambda: deque(maxlen=_PATIENCE))
    misses_in_a_row: int = 0
    last_ns: int | None = None
    images: int = 0
    others: dict[str, int] = field(default_factory=dict)


class _Infos(Generic[InfoT]):
    """The camera_info of one frame_id, by stamp, in order of arrival."""

    def __init__(self) -> None:
        self.by_stamp: OrderedDict[int, InfoT] = OrderedDict()
        self.forgotten: InfoT | None = None
        self._last_ns: int | None = None

    def add(self, stamp_ns: int, camera_info: InfoT) -> None:
        """Take the next one."""
        if self._last_ns is not None and stamp_ns < self._last_ns - _JUMP_NS:
            self.forget_after(stamp_ns)
        self._last_ns = stamp_ns
        self.by_stamp.pop(stamp_ns, None)
        self.by_stamp[stamp_ns] = camera_info
        if len(self.by_stamp) > _KEPT_INFOS:
            self.by_stamp.popitem(last=False)

    def overtake(self, stamp_ns: int) -> bool:
        """Return whether one has a somewhat later stamp."""
        return any(stamp_ns < info_ns <= stamp_ns + _JUMP_NS for info_ns in self.by_stamp)

    def forget_after(self, stamp_ns: int) -> None:
        """Forget those of before a jump back to a stamp, but for the newest."""
        for info_ns in [ns for ns in self.by_stamp if ns > stamp_ns + _JUMP_NS]:
            self.forgotten = self.by_stamp.pop(info_ns)


def _nearest(candidates: Sequence[_Infos[InfoT]], stamp_ns: int) -> InfoT | None:
    """Return the latest camera_info before a stamp, else the first after it, else one of before a jump, or None."""
    stamps = [(info_ns, infos) for infos in candidates for info_ns in infos.by_stamp]
    if not stamps:
        return next((infos.forgotten for infos in candidates if infos.forgotten is not None), None)
    earlier = [(info_ns, infos) for info_ns, infos in stamps if info_ns < stamp_ns]
    info_ns, infos = max(earlier, key=_stamp) if earlier else min(stamps, key=_stamp)
    return infos.by_stamp[info_ns]


def _stamp(entry: tuple[int, object]) -> int:
    return entry[0]
