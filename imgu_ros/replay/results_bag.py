# SPDX-License-Identifier: Apache-2.0
"""The results bag of a replay: the messages that the live node would have published, stamped as the input."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from imgu_ros.bags.messages import make_message
from imgu_ros.bags.writing import BagWriter
from imgu_ros.config.components import OutputParameters
from imgu_ros.messages.result_converter import ResultConverter
from imgu_ros.replay.recorded_topics import is_recorded
from imgu_ros.report.overlay import draw_result
from imgu_ros.result import Result


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
