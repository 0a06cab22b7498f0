# SPDX-License-Identifier: Apache-2.0
"""The results bag of a replay: the messages that the live node would have published, stamped as the input."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from imgu_ros.bags.messages import make_message
from imgu_ros.bags.writing import BagWriter
from imgu_ros.config.components import OutputParameters
from imgu_ros.errors import ParameterError, nearest_name
from imgu_ros.messages import results
from imgu_ros.messages.geometry import tf_message
from imgu_ros.messages.output_topic import OutputTopic, Recording, Scope
from imgu_ros.messages.result_converter import ResultConverter
from imgu_ros.messages.results import target_transforms
from imgu_ros.report.overlay import draw_result
from imgu_ros.result import Result

_LEVEL = re.compile(r"pyramid/level_\d{1,2}")


class ResultsBag:
    """Writes the results bag (MCAP).

    Parameters
    ----------
    path : the bag's folder
    parameters : names of frames, length of a path, and the targets' places in the map
    targets : names, the first one's topics appear without a prefix too
    record : topics to record beside those that always are, see `checked_record`
    """

    def __init__(self, path: Path, parameters: OutputParameters, targets: Sequence[str], record: Sequence[str]) -> None:
        self._converter = ResultConverter(make_message, draw_result, targets, parameters)
        topics = self._converter.topics()
        self._recorded = frozenset(topic for topic, row in topics.items() if is_recorded(topic, row, record))
        self._target_prefix = parameters.frames.target_prefix
        self._writer = BagWriter(path)

    def close(self) -> None:
        """Complete the bag.

        Raises
        ------
        BagError
            If it cannot be completed.
        """
        self._writer.close()

    def write(self, result: Result, time_ns: int) -> None:
        """Write the messages of one frame; `time_ns` is when the bag recorded the frame."""
        frame = self._converter.frame(result)
        for made in self._converter.messages(frame, self._recorded.__contains__):
            first, *others = (f"/{topic}" for topic in made.topics)
            self._writer.write(first, made.message, time_ns, *others)
        # A transform needs the names of both frames.
        transforms = target_transforms(frame.result, self._target_prefix) if frame.header.frame_id else []
        if transforms:
            self._writer.write("/tf", tf_message(make_message, transforms), time_ns)


def checked_record(record: Sequence[str]) -> tuple[str, ...]:
    """Return the topics to record on request, relative and each once.

    Raises
    ------
    ParameterError
        If there is no such output; the message names the nearest.
    """
    rows = [row for row in results.OUTPUTS if row.scope in (Scope.FRAME, Scope.TARGET)]
    always = [row.name for row in rows if row.recording is Recording.ALWAYS]
    optional = [row.name for row in rows if row.recording is Recording.ON_REQUEST]
    names = tuple(dict.fromkeys(name.removeprefix("/") for name in record))
    for name in names:
        if name not in (*always, *optional) and not _LEVEL.fullmatch(name):
            near = nearest_name(name, optional)
            hint = f" (nearest: {near})" if near else ""
            raise ParameterError(
                f"--record: {name!r} is no output{hint}; need one of {', '.join(optional)}, pyramid/level_<k>"
            )
    return tuple(name for name in names if name not in always)


def is_recorded(topic: str, row: OutputTopic, record: Sequence[str]) -> bool:
    """Return whether the results bag has a topic: `path` asks for that of the map and of every target as well.

    Parameters
    ----------
    topic, row : of `ResultConverter.topics`
    record : of `checked_record`
    """
    asked = topic if row.scope is Scope.LEVEL else row.name.removeprefix("map/")
    return row.recording is Recording.ALWAYS or (row.recording is Recording.ON_REQUEST and asked in record)
