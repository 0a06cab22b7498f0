# SPDX-License-Identifier: Apache-2.0
"""What goes to those who write results."""

from __future__ import annotations

from dataclasses import dataclass

from imgu_ros.config.parameters import Parameters
from imgu_ros.replay.output_folder import RunFolder
from imgu_ros.result import Result


@dataclass(frozen=True, slots=True, eq=False)
class ResultItem:
    """One frame's result, and when the bag recorded the frame."""

    result: Result
    time_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class Files:
    """What is to be written.

    Attributes
    ----------
    folder : where
    parameters : of the replay
    targets : names
    record : outputs to record beside those that always are
    expected : number of frames, as far as it is known
    """

    folder: RunFolder
    parameters: Parameters
    targets: tuple[str, ...]
    record: tuple[str, ...]
    expected: int
