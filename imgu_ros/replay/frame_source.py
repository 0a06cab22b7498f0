# SPDX-License-Identifier: Apache-2.0
"""The frames of a recording: one image topic, each image with its camera_info; and their development ahead of time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from imgu_ros.bags.frame_files import UnreadableFrame
from imgu_ros.bags.reading import Bag, BagMessage, BagTopic
from imgu_ros.bags.recorded_images import choose_image_topic
from imgu_ros.bags.topics import find_camera_info_topic
from imgu_ros.config.components import DevelopmentParameters, RecordedFramesParameters
from imgu_ros.errors import EncodingError
from imgu_ros.files.frame_reading import FrameReading, frame_reading
from imgu_ros.frame import Frame
from imgu_ros.image.frame_image import Development, develop_frame
from imgu_ros.messages.header import decode_header
from imgu_ros.messages.header_checks import HeaderChecks
from imgu_ros.messages.pairing import Pair, Pairing
from imgu_ros.remarks import Remarks
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage


@dataclass(frozen=True, slots=True, eq=False)
class RecordedFrame:
    """One recorded image.

    Attributes
    ----------
    time_ns : when it was recorded
    frame : decoded; with an image of no pixels when it could not be
    reason : why it could not be decoded; empty when it was
    """

    time_ns: int
    frame: Frame
    reason: str


class FrameSource:
    """Reads frames from an open bag, in the bag's order and bounded memory.

    Parameters
    ----------
    bag : open
    parameters : those of recorded frames

    Attributes
    ----------
    image_topic : the topic that is read
    camera_info_topic : its camera_info; None when there is none, or `camera.info_file` is used instead
    camera_info_file : the file that is used instead; empty: none
    warnings : what the user should know about the choice of topics and the calibration; grows while frames are read

    Raises
    ------
    BagError, ParameterError
        If there is no such topic; see `choose_image_topic` and `find_camera_info_topic`.
    FileError, ParameterError
        If `camera.info_file` or `raw.encoding` cannot be used; see `frame_reading`.
    """

    def __init__(self, bag: Bag, parameters: RecordedFramesParameters) -> None:
        self._bag = bag
        self._reading = frame_reading(parameters)
        self._camera_frame = parameters.frames.camera
        self.warnings: list[str] = []
        choice = choose_image_topic(bag, parameters.image_topic, parameters.raw.encoding, limits=parameters.limits)
        self.image_topic = choice.topic
        if choice.remark:
            self.warnings.append(choice.remark)
        self.camera_info_topic: BagTopic | None = None
        self.camera_info_file = ""
        if self._reading.file_camera is None:
            name = parameters.camera_info_topic
            self.camera_info_topic = find_camera_info_topic(bag.topics, self.image_topic.name, name)
        else:
            self.camera_info_file = self._reading.file_camera.source
        if not self._reading.rectified and "rect" in self.image_topic.name:
            self.warnings.append(f"{self.image_topic.name}: sounds rectified; if it is, set -p camera.rectified:=true")

    def frames(self) -> Iterator[RecordedFrame]:
        """Yield every recorded image."""
        info_name = None if self.camera_info_topic is None else self.camera_info_topic.name
        names = [self.image_topic.name] if info_name is None else [self.image_topic.name, info_name]
        pairing: Pairing[BagMessage, Any] = Pairing(expects_camera_info=info_name is not None)
        headers = HeaderChecks(self.image_topic.name, info_name or "")
        remarks = Remarks()
        has_remark = False
        for pair in self._pairs(pairing, headers, names):
            recorded = _recorded(pair, self._reading)
            if recorded.frame.image.remark and not has_remark:
                has_remark = True
                self.warnings.append(f"{self.image_topic.name}: {recorded.frame.image.remark}")
            if not recorded.reason:
                self.warnings += remarks.news(self._said_of_camera(pair, recorded.frame))
            yield recorded
        if pairing.unmatched:
            share = f"{pairing.unmatched} of {pairing.matched + pairing.unmatched} images"
            self.warnings.append(f"{info_name}: none has the stamp of {share}; the latest one before was used")
        self.warnings += headers.told(self._camera_frame).values()

    def _pairs(
        self, pairing: Pairing[BagMessage, Any], headers: HeaderChecks, names: list[str]
    ) -> Iterator[Pair[BagMessage, Any]]:
        for message in self._bag.messages(names):
            header = decode_header(message.message)
            if message.topic == self.image_topic.name:
                headers.add_image(message.message)
                yield from pairing.add_image(header.stamp_ns, message, header.frame_id)
            else:
                headers.add_camera_info(message.message)
                yield from pairing.add_camera_info(header.stamp_ns, message.message, header.frame_id)
        yield from pairing.flush()

    def _said_of_camera(self, pair: Pair[BagMessage, Any], frame: Frame) -> Sequence[str]:
        if frame.camera is not None:
            return frame.camera_remarks
        why = frame.camera_reason or self._why_no_camera_info(pair)
        helps = (
            ""
            if self.camera_info_file
            else "; a calibration file helps: --camera-info FILE, or -p camera.info_file:=FILE"
        )
        return [f"uncalibrated: {why}; homographies, but no poses{helps}"]

    def _why_no_camera_info(self, pair: Pair[BagMessage, Any]) -> str:
        if self.camera_info_topic is None:
            return f"the recording has no camera_info beside {self.image_topic.name}"
        return f"{self.camera_info_topic.name} has none for the image at {pair.stamp_ns} ns"


@dataclass(frozen=True, slots=True, eq=False)
class ReadFrame:
    """A recorded frame, ready for the localizer.

    Attributes
    ----------
    time_ns : when it was recorded
    frame : decoded; with an image of no pixels when it could not be
    reason : why it could not be decoded; empty when it was
    development : of the frame; None when it could not be decoded
    warnings : those of bag and source until it was read
    """

    time_ns: int
    frame: Frame
    reason: str
    development: Development | None
    warnings: tuple[str, ...]


def read_ahead(bag: Bag, source: FrameSource, parameters: DevelopmentParameters) -> Iterator[ReadFrame]:
    """Yield the developed frames of a source; for a thread of its own, which alone then uses `bag` and `source`."""
    for recorded in source.frames():
        development = None if recorded.reason else develop_frame(recorded.frame, parameters)
        warnings = (*bag.warnings, *source.warnings)
        yield ReadFrame(recorded.time_ns, recorded.frame, recorded.reason, development, warnings)


def size_of(read: ReadFrame) -> int:
    """Return about how many bytes a frame holds: its raw pixels, and as many of grey."""
    return 2 * read.frame.image.pixels.nbytes


def _recorded(pair: Pair[BagMessage, Any], reading: FrameReading) -> RecordedFrame:
    message = pair.image.message
    try:
        if isinstance(message, UnreadableFrame):
            raise EncodingError(message.reason)
        frame = reading.frame(message, pair.camera_info)
        return RecordedFrame(pair.image.time_ns, frame, "")
    except EncodingError as error:
        header = decode_header(message)
        nothing = RawImage(np.zeros((0, 0), np.uint8), PixelLayout(ColorModel.MONO))
        return RecordedFrame(pair.image.time_ns, Frame(nothing, header.stamp_ns, header.frame_id, None), str(error))
