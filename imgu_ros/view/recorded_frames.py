# SPDX-License-Identifier: Apache-2.0
"""The frames of the recording that was replayed, as pictures for a screen."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path

from imgu_ros.bags.reading import open_bag
from imgu_ros.config.components import DevelopmentParameters, RecordedFramesParameters
from imgu_ros.frame import Frame
from imgu_ros.image.frame_image import develop_frame
from imgu_ros.replay.frame_source import FrameSource
from imgu_ros.types import Image
from imgu_ros.view.results_folder import ReplayResults


@dataclass(frozen=True, slots=True, eq=False)
class ScreenFrame:
    """A recorded frame, with its picture.

    Attributes
    ----------
    time_ns : when it was recorded
    frame : as read
    picture : for a screen, (H, W, 3) RGB uint8; None: the frame could not be read or developed
    """

    time_ns: int
    frame: Frame
    picture: Image | None


def screen_frames(recording: Sequence[Path], results: ReplayResults) -> Generator[ScreenFrame]:
    """Yield every frame of a recording, read and developed as in the replay; bounded memory.

    Raises
    ------
    BagError, FileError, ParameterError
        If it cannot be read.
    """
    parameters = results.parameters
    reading, development = RecordedFramesParameters.of(parameters), DevelopmentParameters.of(parameters)
    with open_bag(recording, limits=parameters.limits, rate_hz=results.rate_hz) as bag:
        for recorded in FrameSource(bag, reading).frames():
            image = None if recorded.reason else develop_frame(recorded.frame, development).image
            yield ScreenFrame(recorded.time_ns, recorded.frame, None if image is None else image.for_screen())
