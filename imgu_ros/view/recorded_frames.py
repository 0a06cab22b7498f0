# SPDX-License-Identifier: Apache-2.0
"""The frames of the recording that was replayed, as pictures for a screen."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path

from imgu_ros.bags.reading import Bag, open_bag
from imgu_ros.config.components import DevelopmentParameters, RecordedFramesParameters
from imgu_ros.image.frame_image import develop_frame
from imgu_ros.replay.frame_source import FrameSource
from imgu_ros.report.samples import jpeg_of
from imgu_ros.view.results_folder import ReplayResults
from imgu_ros.vision.camera.intrinsics import Camera

#: Longest side of a picture, px, and its quality: a frame takes about 100 kB.
_LONGEST_SIDE = 1280
_QUALITY = 80


@dataclass(frozen=True, slots=True, eq=False)
class FramePicture:
    """A recorded frame as a picture.

    Attributes
    ----------
    stamp_ns : of the frame
    size : width and height of the frame, px
    jpeg : the picture, reduced by `scale`; empty: the frame could not be read
    scale : size of the picture over that of the frame
    camera : of the frame; None when it is not calibrated
    """

    stamp_ns: int
    size: tuple[int, int]
    jpeg: bytes
    scale: float
    camera: Camera | None


def frame_pictures(recording: Sequence[Path], results: ReplayResults) -> Generator[FramePicture]:
    """Yield every frame of a recording, read and developed as in the replay; bounded memory.

    Raises
    ------
    BagError, FileError, ParameterError
        If it cannot be read.
    """
    parameters = results.parameters
    development = DevelopmentParameters.of(parameters)
    with open_bag(recording, limits=parameters.limits, rate_hz=results.rate_hz) as bag:
        yield from _pictures(bag, RecordedFramesParameters.of(parameters), development)


def _pictures(
    bag: Bag, reading: RecordedFramesParameters, development: DevelopmentParameters
) -> Generator[FramePicture]:
    for recorded in FrameSource(bag, reading).frames():
        frame = recorded.frame
        image = None if recorded.reason else develop_frame(frame, development).image
        if image is None:
            yield FramePicture(frame.stamp_ns, (0, 0), b"", 1.0, None)
            continue
        height, width = image.shape
        scale = min(1.0, _LONGEST_SIDE / max(height, width))
        jpeg = jpeg_of(image.for_screen(), _LONGEST_SIDE, _QUALITY)
        yield FramePicture(frame.stamp_ns, (width, height), jpeg, scale, frame.camera)
