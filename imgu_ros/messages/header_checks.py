# SPDX-License-Identifier: Apache-2.0
"""Checks of the headers of an image topic and its camera_info: stamps that do not rise, invalid frame names."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from imgu_ros.messages.header import decode_header, frame_name
from imgu_ros.shown_text import quoted

#: As in the pipeline: stamps that jump back by more belong to another recording, or to the same one played again.
_JUMP_NS = 1_000_000_000
#: What was seen in none of so many images is over.
_FORGOTTEN = 300
#: So many frame_ids are kept apart.
_CAMERAS = 8


class Oddity(StrEnum):
    """Kinds of odd headers."""

    SLASH = "frame_slash"  #: frame_id begins with a slash
    NO_FRAME = "no_frame"  #: frame_id is empty
    OTHER_FRAME = "other_frame"  #: camera_info has another frame_id than the images
    SHARED = "several_cameras"  #: images of several frame_ids come in turn
    ZERO = "zero_stamps"
    REPEATED = "repeated_stamps"
    FALLING = "falling_stamps"
    JUMP = "stamps_jump_back"

    @property
    def is_about_frames(self) -> bool:
        """Whether the name of a frame is odd, not a stamp."""
        return self in (Oddity.SLASH, Oddity.NO_FRAME, Oddity.OTHER_FRAME)


class HeaderChecks:
    """Looks at the headers of one image topic and of its camera_info.

    Parameters
    ----------
    image_topic, info_topic : their names, for people
    """

    def __init__(self, image_topic: str, info_topic: str) -> None:
        self._image_topic, self._info_topic = image_topic, info_topic
        self._images = 0
        self._counts: dict[Oddity, int] = {}
        self._last_seen: dict[Oddity, int] = {}
        self._details: dict[Oddity, str] = {}
        self._frame_id: str | None = None
        # By frame_id, that of the last image last.
        self._cameras: OrderedDict[str, _Stamps] = OrderedDict()

    @property
    def counts(self) -> Mapping[Oddity, int]:
        """How many messages had each oddity."""
        return self._counts

    @property
    def cameras(self) -> tuple[str, ...]:
        """The frame_ids that images came with, in turn, lately; empty while all have the same."""
        if Oddity.SHARED not in self._counts or self._images - self._last_seen[Oddity.SHARED] >= _FORGOTTEN:
            return ()
        return tuple(sorted(self._cameras))

    def add_image(self, message: Any) -> None:
        """Look at the next image."""
        self._images += 1
        given, header = str(message.header.frame_id), decode_header(message)
        name = self._frame_id = header.frame_id
        if name in self._cameras and name != next(reversed(self._cameras)):
            self._note(Oddity.SHARED, "")
        camera = self._cameras.setdefault(name, _Stamps())
        self._cameras.move_to_end(name)
        if len(self._cameras) > _CAMERAS:
            self._cameras.popitem(last=False)
        if given.startswith("/"):
            self._note(Oddity.SLASH, f"{quoted(given)}; tf2 refuses a leading slash: {quoted(name)} goes out")
        if not name:
            self._note(Oddity.NO_FRAME, "")
        self._look_at_stamp(camera, header.stamp_ns)

    def add_camera_info(self, message: Any) -> None:
        """Look at the next camera_info."""
        frame_id = frame_name(str(message.header.frame_id))
        if self._cameras and frame_id not in self._cameras:
            self._note(Oddity.OTHER_FRAME, quoted(frame_id))

    def told(self, camera_frame: str = "", *, lately: bool = False) -> dict[Oddity, str]:
        """Return a line for people about each oddity.

        Parameters
        ----------
        camera_frame : the parameter `frames.camera`, which stands for all names of the images' frame
        lately : only what was seen in the last 300 images
        """
        return {
            oddity: self._line(oddity)
            for oddity in Oddity
            if oddity in self._counts
            and not (camera_frame and oddity.is_about_frames)
            and not (lately and self._images - self._last_seen[oddity] >= _FORGOTTEN)
        }

    def _look_at_stamp(self, camera: _Stamps, stamp_ns: int) -> None:
        last_ns, before_zero = camera.last_ns, camera.before_zero
        camera.last_ns, camera.before_zero = stamp_ns, None
        if stamp_ns == 0:
            # A recording may start or restart at 0: the next stamps show it.
            if last_ns == 0 or Oddity.ZERO in self._counts:
                self._note(Oddity.ZERO, "")
            else:
                camera.before_zero = last_ns
            return
        if before_zero is not None:
            if stamp_ns >= before_zero - _JUMP_NS:
                self._note(Oddity.ZERO, "")
            last_ns = before_zero
        if last_ns is None or stamp_ns > last_ns:
            return
        if stamp_ns == last_ns:
            self._note(Oddity.REPEATED, f"first at {stamp_ns} ns")
        else:
            back_ns = last_ns - stamp_ns
            kind = Oddity.JUMP if back_ns > _JUMP_NS else Oddity.FALLING
            self._note(kind, f"by {back_ns / 1e9:.6g} s at {stamp_ns} ns")

    def _note(self, oddity: Oddity, detail: str) -> None:
        self._counts[oddity] = self._counts.get(oddity, 0) + 1
        self._last_seen[oddity] = self._images
        self._details.setdefault(oddity, detail)

    def _line(self, oddity: Oddity) -> str:
        topic, detail = self._image_topic, self._details[oddity]
        share = f"{self._counts[oddity]} of {self._images} images"
        match oddity:
            case Oddity.SLASH:
                return f"frame_id of {topic}: {detail}"
            case Oddity.NO_FRAME:
                return (
                    f"frame_id of {topic} is empty: poses are in no frame, nothing can go to /tf; set frames.camera "
                    "to the name of the camera's optical frame"
                )
            case Oddity.OTHER_FRAME:
                return (
                    f"frame_id of {self._info_topic}: {detail}, of {topic}: {quoted(self._frame_id or '')}; the "
                    "images' goes out; set frames.camera if it is wrong"
                )
            case Oddity.SHARED:
                names = self.cameras or tuple(self._cameras)
                return f"{topic} carries images of several cameras: {what_becomes(names)}"
            case Oddity.ZERO:
                return (
                    f"stamps of {topic} are 0 in {share}: motion is predicted as if they came evenly, and /tf and "
                    ".tum files need stamps that rise; have the driver stamp its images"
                )
            case Oddity.REPEATED:
                return (
                    f"stamps of {topic} are repeated in {share} ({detail}): motion is predicted as if they came "
                    "evenly, and a .tum file has the first of each alone"
                )
            case Oddity.FALLING:
                return (
                    f"stamps of {topic} fall in {share} (first {detail}): images are worked on as they come, and a "
                    ".tum file leaves out what does not rise"
                )
            case Oddity.JUMP:
                return (
                    f"stamps of {topic} jump back in {share} (first {detail}): a recording that restarts, or a "
                    "clock that was set; tracks and paths restart"
                )


def what_becomes(frame_ids: Sequence[str]) -> str:
    """Return how images of several cameras on one topic are treated, and what to do; `frame_ids`: those known."""
    names = f" ({', '.join(quoted(name) for name in frame_ids)})" if len(frame_ids) > 1 else ""
    return f"each frame_id{names} is paired and tracked by itself; give each camera a topic and a node of its own"


@dataclass(slots=True, eq=False)
class _Stamps:
    """The last stamps of one frame_id."""

    last_ns: int | None = None
    before_zero: int | None = None
