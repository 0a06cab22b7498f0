# SPDX-License-Identifier: Apache-2.0
"""Publish a webcam, videos or pictures as a camera: `image_raw` and `camera_info`, as a ROS driver would.

Stamps are those of now. ROS arguments (remaps, QoS overrides) follow `--ros-args`.
"""

from __future__ import annotations

import argparse

from imgu_ros.cli.options import PICTURE_LIMITS, add_parameter_options, parameters_of, picture_rate, whole_number
from imgu_ros.cli.terminal import say, tell

HELP = "publish a webcam, a video or pictures as a camera"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.usage = "imgu camera [SOURCE...] [options] [--ros-args ...]"
    parser.add_argument(
        "sources", nargs="*", default=["0"], metavar="SOURCE",
        help="a webcam (0, /dev/video0; default 0), videos, or pictures (files, a folder, a pattern)",
    )  # fmt: skip
    parser.add_argument(
        "--camera-info", default="", metavar="FILE",
        help="calibration of the camera, as `imgu calibrate` writes it, for camera_info",
    )  # fmt: skip
    parser.add_argument("--frame-id", default="camera", metavar="NAME", help="of the messages (default camera)")
    parser.add_argument(
        "--rate", type=picture_rate, default=0.0, metavar="HZ",
        help="pictures a second (default: as their names or Exif say), or what to ask of a webcam",
    )  # fmt: skip
    parser.add_argument("--size", type=_size, metavar="WxH", help="what to ask of a webcam, px")
    parser.add_argument("--loop", action="store_true", help="start over at the end of videos or pictures, until Ctrl-C")
    parser.add_argument(
        "--wait-for", type=whole_number, default=0, metavar="N",
        help="start when the image topic has N subscribers (default 0: at once, as a camera does)",
    )  # fmt: skip
    add_parameter_options(parser, PICTURE_LIMITS)
    parser.add_argument("--ros-args", nargs=argparse.REMAINDER, default=[], help="ROS 2 arguments: -r FROM:=TO, ...")


def run(arguments: argparse.Namespace) -> int:
    """Publish until the end, or Ctrl-C, and say how many frames there were."""
    from imgu_ros.ros.middleware import require_room_to_start, set_profile
    from imgu_ros.ros.stopping import StopRequested, StopSignal

    limits = parameters_of(arguments).limits
    require_room_to_start()
    set_profile()
    with StopSignal() as stop:
        try:
            with stop.interruptible():
                from imgu_ros.ros.camera import CameraOptions, run_camera
            options = CameraOptions(
                sources=tuple(arguments.sources),
                camera_info=arguments.camera_info,
                frame_id=arguments.frame_id,
                rate_hz=arguments.rate,
                size=arguments.size,
                loop=arguments.loop,
                wait_for=arguments.wait_for,
                limits=limits,
            )
            ros_arguments = ["--ros-args", *arguments.ros_args] if arguments.ros_args else []
            published = run_camera(options, ros_arguments, stop, tell)
        except StopRequested:
            return 0
    say(f"{published} frames published")
    return 0


def _size(text: str) -> tuple[int, int]:
    width, separator, height = text.partition("x")
    if not (separator and width.isdecimal() and height.isdecimal() and 0 < int(width) < 65536 > int(height) > 0):
        raise argparse.ArgumentTypeError(f"{text!r}; need WIDTHxHEIGHT in px, such as 1280x720")
    return int(width), int(height)
