# SPDX-License-Identifier: Apache-2.0
"""Videos and pictures as recordings: which paths are such files, and the messages of their frames."""

from __future__ import annotations

import glob
import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from imgu_ros.bags.messages import make_message
from imgu_ros.bags.storage import Channel, Serialization
from imgu_ros.errors import BagError
from imgu_ros.messages.header import Header
from imgu_ros.messages.image import image_message
from imgu_ros.types import Image

#: The topic of frames that come from videos or pictures, and the frame in which their poses are.
FRAME_CHANNEL = Channel("/image_raw", "sensor_msgs/msg/Image", Serialization.CDR, "", "")
FRAME_ID = "camera"

_VIDEOS = {
    ".3gp", ".avi", ".flv", ".gif", ".m2ts", ".m4v", ".mjpeg", ".mjpg", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".mts",
    ".ogv", ".ts", ".webm", ".wmv", ".y4m",
}  # fmt: skip
_PICTURES = {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".pgm", ".ppm", ".pnm", ".pbm", ".bmp", ".webp"}
_BAGS = {".bag", ".mcap", ".db3", ".zstd"}
_METADATA = "metadata.yaml"


class InputKind(StrEnum):
    """What holds the frames of a recording."""

    BAG = "bag"
    VIDEO = "video"
    PICTURES = "pictures"


@dataclass(frozen=True, slots=True)
class RecordingFiles:
    """The files of one recording, all of one kind: bags as they were named, other files one by one, in order."""

    kind: InputKind
    paths: tuple[Path, ...]


@dataclass(frozen=True, slots=True)
class UnreadableFrame:
    """Stands for the image message of a picture file that cannot be read: its header, and why.

    Whoever decodes the frame takes `reason` for what decoding would have said: the frame has its row among the others.
    """

    header: Any
    reason: str


def frame_message(stamp_ns: int, pixels: Image, encoding: str) -> Any:
    """Return a frame's sensor_msgs/Image."""
    return image_message(make_message, Header(stamp_ns, FRAME_ID), pixels, encoding)


def recording_files(paths: Sequence[Path | str]) -> RecordingFiles:
    """Find out what `paths` name: bags, videos, or pictures.

    Parameters
    ----------
    paths : files; folders of a bag, of videos, or of pictures; patterns such as `frames/*.png`. By the suffix; what has
        none that is known counts as a bag, whose first bytes tell

    Raises
    ------
    BagError
        If they are of several kinds, or a folder holds none of these, or a pattern fits nothing.
    """
    kinds: dict[InputKind, Path] = {}
    found: list[Path] = []
    for path in (one for given in paths for one in _expanded(Path(given))):
        kind, files = _files_of(path)
        kinds.setdefault(kind, path)
        found += files
    if len(kinds) > 1:
        named = ", ".join(f"{path} ({kind})" for kind, path in kinds.items())
        raise BagError(f"inputs of several kinds: {named}; need bags, or videos, or pictures alone")
    kind = next(iter(kinds), InputKind.BAG)
    if kind is not InputKind.BAG and found == sorted(found):
        # As a shell lists what fits a pattern: frame10 before frame2. Another order is the user's own.
        found.sort(key=lambda path: (path.parent, natural_order(path)))
    return RecordingFiles(kind, tuple(found))


def is_picture_name(path: Path) -> bool:
    """Return whether a file's suffix is that of a picture."""
    return path.suffix.lower() in _PICTURES


def is_recording(path: Path) -> bool:
    """Return whether a path names a bag or a video, or a folder of one, by names."""
    if path.is_dir():
        return any(entry.name == _METADATA or entry.suffix.lower() in _BAGS | _VIDEOS for entry in path.iterdir())
    return path.name == _METADATA or path.suffix.lower() in _BAGS | _VIDEOS


def natural_order(path: Path) -> tuple[str | int, ...]:
    """Return the key that sorts `frame2.png` before `frame10.png`."""
    parts = re.split(r"(\d+)", path.name)
    return tuple(int(part) if index % 2 else part for index, part in enumerate(parts))


def _expanded(path: Path) -> list[Path]:
    if not glob.has_magic(str(path)) or path.exists():
        return [path]
    found = sorted(map(Path, glob.glob(str(path), recursive=True)), key=natural_order)
    if not found:
        raise BagError(f"{path}: no file fits this pattern; need bags, videos or pictures")
    return found


def _files_of(path: Path) -> tuple[InputKind, list[Path]]:
    try:
        inside = sorted(path.iterdir(), key=natural_order) if path.is_dir() else None
    except (OSError, RuntimeError, ValueError):  # symbolic links in a circle, a zero byte: who opens it says so
        return InputKind.BAG, [path]
    if inside is None:
        suffix = path.suffix.lower()
        kind = InputKind.VIDEO if suffix in _VIDEOS else InputKind.PICTURES if suffix in _PICTURES else InputKind.BAG
        return kind, [path]
    if any(entry.name == _METADATA or entry.suffix in _BAGS for entry in inside):
        return InputKind.BAG, [path]
    videos = [entry for entry in inside if entry.suffix.lower() in _VIDEOS]
    pictures = [entry for entry in inside if is_picture_name(entry)]
    if videos and pictures:
        raise BagError(f"{path}: videos and pictures in one folder; need to know which: name the files")
    if videos:
        return InputKind.VIDEO, videos
    return (InputKind.PICTURES, pictures) if pictures else (InputKind.BAG, [path])
