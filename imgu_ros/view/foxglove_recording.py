# SPDX-License-Identifier: Apache-2.0
"""The results of a replay and what was replayed in one MCAP file, for Foxglove."""

from __future__ import annotations

import contextlib
import heapq
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

from imgu_ros.bags.frame_files import InputKind, recording_files
from imgu_ros.bags.messages import make_message
from imgu_ros.bags.reading import Bag, open_bag
from imgu_ros.bags.writing import BagWriter, bag_files
from imgu_ros.file_access.atomic_files import file_errors, part_path
from imgu_ros.messages.compressed_image import compressed_image_message
from imgu_ros.messages.header import Header
from imgu_ros.replay.result_files import RESULTS
from imgu_ros.view.recorded_frames import ScreenFrame
from imgu_ros.view.results_folder import ReplayResults

#: Where the layout in config/ looks for pictures.
PICTURES = "/image_color/compressed"
_QUALITY = 80
#: What may be in the folder in which the file is written.
_FOLDER = "view"


@dataclass(frozen=True, slots=True, eq=False)
class _Timed:
    """A message: serialised, with the type's name, or made here."""

    time_ns: int
    topic: str
    type_name: str
    data: bytes | memoryview
    made: Any = None


def write_foxglove(
    path: Path,
    results: ReplayResults,
    recording: Sequence[Path],
    pictures: Iterator[ScreenFrame],
    on_progress: Callable[[int, int | None], None] = lambda done, total: None,
) -> None:
    """Write one MCAP file with the image topic and the camera_info of a recording, and all topics of the results.

    A bag's messages are copied unchanged. Beside them are pictures for a screen, as JPEG.

    Parameters
    ----------
    path : the file, replaced when it exists
    results : of the replay
    recording : what was replayed; empty: it is gone
    pictures : its frames
    on_progress : called after each frame with the number of frames done and of all

    Raises
    ------
    FileError, BagError
        If the file cannot be written, or the results or the recording cannot be read.
    """
    folder = part_path(path)
    _make_empty(folder)
    try:
        with ExitStack() as stack:
            streams = [_pictures(pictures)]
            results_bag = stack.enter_context(open_bag([results.folder / RESULTS], limits=results.parameters.limits))
            names = {results.image_topic, results.camera_info_topic} - {""}
            streams.append(_copied(results_bag, {topic.name for topic in results_bag.topics} - names - {PICTURES}))
            # Frames of videos and pictures are messages only while they are read.
            if recording and recording_files(recording).kind is InputKind.BAG:
                bag = stack.enter_context(
                    open_bag(recording, limits=results.parameters.limits, rate_hz=results.rate_hz)
                )
                streams.append(_copied(bag, names))
            writer = stack.enter_context(BagWriter(folder / _FOLDER, compression="zstd"))
            done = 0
            for message in heapq.merge(*streams, key=attrgetter("time_ns")):
                if message.made is None:
                    writer.copy(message.topic, message.type_name, message.data, message.time_ns)
                    continue
                writer.write(message.topic, message.made, message.time_ns)
                done += 1
                on_progress(done, results.frames)
        with file_errors(path):
            os.replace(folder / _FOLDER / bag_files(_FOLDER)[0], path)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _make_empty(folder: Path) -> None:
    """Make a folder anew, beside the file that it is for."""
    with file_errors(folder):
        with contextlib.suppress(FileNotFoundError):
            shutil.rmtree(folder)
        folder.mkdir()


def _copied(bag: Bag, topics: set[str]) -> Iterator[_Timed]:
    for raw in bag.cdr_messages(topics):
        yield _Timed(raw.time_ns, raw.channel.topic, raw.channel.type_name, raw.data)


def _pictures(frames: Iterator[ScreenFrame]) -> Iterator[_Timed]:
    for each in frames:
        if each.picture is None:
            continue
        header = Header(each.frame.stamp_ns, each.frame.frame_id)
        made = compressed_image_message(
            make_message, header, each.picture, "rgb8", file_format="jpeg", jpeg_quality=_QUALITY, png_level=1
        )
        yield _Timed(each.time_ns, PICTURES, "", b"", made)
