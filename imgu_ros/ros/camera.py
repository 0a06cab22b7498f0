# SPDX-License-Identifier: Apache-2.0
"""Publishes a webcam, videos or pictures as a camera's driver would: `image_raw` and `camera_info`, stamped now."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher

from imgu_ros.bags.frame_files import InputKind, UnreadableFrame, recording_files
from imgu_ros.bags.prefetch import Prefetch
from imgu_ros.bags.reading import BagMessage, open_bag
from imgu_ros.config.parameters import DEFAULT_LIMITS, LimitsParameters
from imgu_ros.errors import BagError, FileError, ParameterError
from imgu_ros.files.camera_info_file import read_camera_info
from imgu_ros.messages.camera_info import camera_info_message
from imgu_ros.messages.header import Header
from imgu_ros.messages.image import decode_image, image_message
from imgu_ros.remarks import Remarks
from imgu_ros.ros.messages import make_message, message_class
from imgu_ros.ros.middleware import large_message_warnings, profile_line
from imgu_ros.ros.process import init_ros, spare_collector
from imgu_ros.ros.qos import output_qos, overridable
from imgu_ros.ros.stopping import StopRequested, StopSignal
from imgu_ros.ros.webcam import Webcam
from imgu_ros.types import Image
from imgu_ros.vision.camera.intrinsics import Camera

IMAGE_TOPIC, INFO_TOPIC = "image_raw", "camera_info"
_IMAGE_TYPE, _INFO_TYPE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
_POLL_S = 0.02
_REMIND_S = 5.0
#: A matched writer may still be unknown to the reader, which then drops its messages.
_SETTLE_S = 0.5
_ACKNOWLEDGE_S, _LINGER_S = 2.0, 0.5
_SECOND = 10**9
#: Between the rounds of a file, where nothing says more.
_USUAL_RATE_HZ = 30.0
#: Pictures that were taken days apart go out as a camera's frames do all the same.
_LONGEST_GAP_S = 1.0
#: A frame that is later is as if it had been taken later.
_LATE_S = 0.1
#: Frames of a file that are read ahead, bytes.
_AHEAD_BYTES = 32_000_000


@dataclass(frozen=True, slots=True)
class CameraOptions:
    """What to publish, and how.

    Attributes
    ----------
    sources : one webcam, by its number or its `/dev` file; or videos or pictures as `open_bag` takes them
    camera_info : calibration file; empty: no camera_info is published
    frame_id : of the messages
    rate_hz : of pictures, and asked of a webcam; 0: as names or Exif say, and as the webcam likes
    size : width, height asked of a webcam, px; None: as it likes
    loop : start over at the end of videos or pictures
    wait_for : subscribers of the image topic to wait for
    limits : what reading files may cost
    """

    sources: tuple[str, ...] = ("0",)
    camera_info: str = ""
    frame_id: str = "camera"
    rate_hz: float = 0.0
    size: tuple[int, int] | None = None
    loop: bool = False
    wait_for: int = 0
    limits: LimitsParameters = DEFAULT_LIMITS


@dataclass(frozen=True, slots=True, eq=False)
class CapturedFrame:
    """Pixels, (H, W) or (H, W, 3), of an encoding; `stamp_ns` on the clock of the wall."""

    stamp_ns: int
    pixels: Image
    encoding: str


def run_camera(
    options: CameraOptions, ros_arguments: Sequence[str], stop: StopSignal, say: Callable[[str], None]
) -> int:
    """Publish until the file ends or the process is asked to stop, and return the number of frames.

    Parameters
    ----------
    options : see there
    ros_arguments : `--ros-args ...`, for remaps and QoS overrides
    stop : entered already
    say : takes lines for people

    Raises
    ------
    BagError, FileError
        If there is no such webcam, or the files or the calibration cannot be read.
    ParameterError
        If the ROS arguments cannot be parsed, or an option is not for the source.
    """
    camera = read_camera_info(options.camera_info) if options.camera_info else None
    is_webcam = len(options.sources) == 1 and is_device(options.sources[0])
    if is_webcam and options.loop:
        raise ParameterError("--loop: for a webcam, which has no end; need videos or pictures")
    if not is_webcam and options.size is not None:
        raise ParameterError("--size: for files, which have their own; need a webcam")
    webcam = Webcam(options.sources[0], options.size, options.rate_hz) if is_webcam else None
    try:
        if webcam is None:
            _require_frames(options)
        with stop.interruptible():
            init_ros(ros_arguments)
        node = Node("camera", start_parameter_services=False, enable_rosout=False)
        node.get_logger().debug(profile_line())
        try:
            return _Driver(node, options, camera, stop, say).run(webcam)
        finally:
            node.destroy_node()
    finally:
        if webcam is not None:
            webcam.close()
        rclpy.try_shutdown()


def is_device(source: str) -> bool:
    """Return whether a source names a webcam: by number, or by its file."""
    return source.isdecimal() or source.startswith("/dev/")


def _now_ns() -> int:
    return round(time.monotonic() * _SECOND)


def _size_of(message: BagMessage) -> int:
    return len(getattr(message.message, "data", b""))


def _require_frames(options: CameraOptions) -> None:
    files = recording_files([Path(source) for source in options.sources])
    if files.kind is InputKind.BAG:
        missing = next((path for path in files.paths if not path.exists()), None)
        if missing is not None:
            raise FileError(f"{missing}: No such file or directory; need a webcam (0, /dev/video0), videos or pictures")
        raise BagError(f"{files.paths[0]}: no video and no picture; need one, or `imgu play` for a bag")
    with open_bag(files.paths, limits=options.limits, rate_hz=options.rate_hz):
        pass


class _Driver:
    def __init__(
        self, node: Node, options: CameraOptions, camera: Camera | None, stop: StopSignal, say: Callable[[str], None]
    ) -> None:
        self._options, self._camera, self._stop, self._say = options, camera, stop, say
        self._remarks = Remarks()
        self._images = self._publisher(node, _IMAGE_TYPE, IMAGE_TOPIC)
        self._infos = None if camera is None else self._publisher(node, _INFO_TYPE, INFO_TOPIC)
        self._published = 0

    @staticmethod
    def _publisher(node: Node, type_name: str, topic: str) -> Publisher:
        return node.create_publisher(
            message_class(type_name), topic, output_qos(10), qos_overriding_options=overridable()
        )

    def run(self, webcam: Webcam | None) -> int:
        """Publish, and return the number of frames."""
        topics = self._images.topic_name if self._infos is None else f"{self._images.topic_name} and camera_info"
        self._say(f"publishing {' '.join(self._options.sources)} on {topics}; Ctrl-C ends")
        if self._camera is None:
            self._say("no --camera-info: no camera_info goes out, and poses need it; `imgu calibrate` makes the file")
        elif self._camera.covariance is not None:
            self._say(
                "camera_info has no place for the calibration's uncertainty: for honest poses give the node the file, "
                f"-p camera.info_file:={self._options.camera_info}"
            )
        with contextlib.suppress(StopRequested):
            self._wait_for_subscribers()
            spare_collector()
            frames = self._of_files() if webcam is None else self._of_webcam(webcam)
            for frame in frames:
                self._publish(frame)
            self._finish()
        return self._published

    def _finish(self) -> None:
        """Let subscribers have the last messages before the publishers go."""
        self._images.wait_for_all_acked(Duration(seconds=_ACKNOWLEDGE_S))
        self._sleep(_LINGER_S)  # best-effort subscribers acknowledge nothing

    def _wait_for_subscribers(self) -> None:
        remind = time.monotonic() + _REMIND_S
        while self._images.get_subscription_count() < self._options.wait_for:
            if time.monotonic() >= remind:
                self._say(
                    f"waiting for subscribers of {self._images.topic_name}: {self._images.get_subscription_count()} of "
                    f"{self._options.wait_for} (`imgu node` subscribes once one of its outputs has a subscriber)"
                )
                remind += _REMIND_S
            self._sleep(_POLL_S)
        if self._options.wait_for:
            self._sleep(_SETTLE_S)

    def _of_webcam(self, webcam: Webcam) -> Iterator[CapturedFrame]:
        while not self._stop.requested:
            stamp_ns, pixels = webcam.read()
            yield CapturedFrame(stamp_ns, pixels, "bgr8")

    def _of_files(self) -> Iterator[CapturedFrame]:
        """Yield each frame when it is due, stamped with that time: as if the camera had taken it now."""
        options = self._options
        due, step_s, clock_ns = time.monotonic(), 1 / (options.rate_hz or _USUAL_RATE_HZ), time.time_ns() - _now_ns()
        while True:
            before_ns: int | None = None
            paths = [Path(source) for source in options.sources]
            with open_bag(paths, limits=options.limits, rate_hz=options.rate_hz) as bag:
                with contextlib.closing(Prefetch(bag.messages(), _size_of, _AHEAD_BYTES)) as ahead:
                    for item in ahead:
                        message = item.message
                        if isinstance(message, UnreadableFrame):
                            self._tell([message.reason])
                            continue
                        if before_ns is not None:
                            step_s = min(1e-9 * (item.time_ns - before_ns), _LONGEST_GAP_S)
                        # What a hold-up made late is not made up: a camera's frames come evenly.
                        due = max(due + step_s, time.monotonic() - _LATE_S)
                        before_ns = item.time_ns
                        self._sleep(due - time.monotonic())
                        stamp_ns = clock_ns + round(due * _SECOND)
                        yield CapturedFrame(stamp_ns, decode_image(message).pixels, message.encoding)
                self._tell(bag.warnings)
            if not options.loop:
                return
            if before_ns is None:
                raise BagError(f"{options.sources[0]}: no frame in it can be read; need at least one")

    def _publish(self, frame: CapturedFrame) -> None:
        header = Header(frame.stamp_ns, self._options.frame_id)
        height, width = frame.pixels.shape[:2]
        if self._camera is not None and (self._camera.width, self._camera.height) != (width, height):
            sizes = f"{self._camera.width} x {self._camera.height} px, not of {width} x {height}"
            self._tell([f"{self._options.camera_info}: of images of {sizes}; need a calibration of these"])
        if self._infos is not None and self._camera is not None:
            self._infos.publish(camera_info_message(make_message, header, self._camera))
        if self._images.get_subscription_count():
            message = image_message(make_message, header, frame.pixels, frame.encoding)
            self._images.publish(message)
            if self._published == 0:
                self._tell(large_message_warnings(frame.pixels.nbytes))
        self._published += 1

    def _tell(self, texts: Sequence[str]) -> None:
        for text in self._remarks.news(texts):
            self._say(f"imgu: warning: {text}")

    def _sleep(self, seconds: float) -> None:
        if self._stop.wait(max(0.0, seconds)):
            raise StopRequested
