# SPDX-License-Identifier: Apache-2.0
"""Publish a recorded bag on live topics, with the bag's timing and /clock.

Headers are left as they were recorded. ROS arguments (remaps, QoS overrides) follow `--ros-args`.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from imgu_ros.cli.options import BAG_LIMITS, add_parameter_options, parameters_of, whole_number
from imgu_ros.cli.terminal import say, tell

HELP = "publish a bag on live topics"

#: Seconds, and times the recorded speed.
_MOST = 1e9


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.usage = "imgu play BAG... [options] [--ros-args ...]"
    parser.add_argument("bags", nargs="+", type=Path, metavar="BAG", help="a bag: its folder, or its files")
    parser.add_argument("--rate", type=_positive, default=1.0, metavar="R", help="times the recorded speed (default 1)")
    parser.add_argument("--loop", action="store_true", help="start over at the end, until Ctrl-C")
    parser.add_argument("--start", type=_not_negative, default=0.0, metavar="S", help="leave out the first S seconds")
    parser.add_argument("--duration", type=_positive, metavar="S", help="play S seconds of the recording")
    parser.add_argument(
        "--wait-for", type=whole_number, default=0, metavar="N",
        help="start when the image topics have N subscribers in all (default 0: start after at most a second)",
    )  # fmt: skip
    parser.add_argument("--timeout", type=_positive, metavar="S", help="give up waiting after S seconds")
    add_parameter_options(parser, BAG_LIMITS)
    parser.add_argument("--ros-args", nargs=argparse.REMAINDER, default=[], help="ROS 2 arguments: -r FROM:=TO, ...")


def run(arguments: argparse.Namespace) -> int:
    """Play the bag and say what was published."""
    from imgu_ros.ros.middleware import require_room_to_start, set_profile
    from imgu_ros.ros.stopping import StopRequested, StopSignal

    limits = parameters_of(arguments).limits
    require_room_to_start()
    set_profile()
    with StopSignal() as stop:
        try:
            with stop.interruptible():
                from imgu_ros.ros.player import PlayOptions, play
            options = PlayOptions(
                rate=arguments.rate,
                loop=arguments.loop,
                start_s=arguments.start,
                duration_s=arguments.duration,
                wait_for=arguments.wait_for,
                timeout_s=arguments.timeout,
                limits=limits,
            )
            ros_arguments = ["--ros-args", *arguments.ros_args] if arguments.ros_args else []
            report = play(arguments.bags, options, ros_arguments, stop, tell)
        except StopRequested:
            return 0
    say(*report.lines())
    return 0


def _positive(text: str) -> float:
    value = _number(text)
    if not 0 < value <= _MOST:
        raise argparse.ArgumentTypeError(f"{text!r}; need a number more than 0 and at most {_MOST:g}")
    return value


def _not_negative(text: str) -> float:
    value = _number(text)
    if not 0 <= value <= _MOST:
        raise argparse.ArgumentTypeError(f"{text!r}; need a number from 0 to {_MOST:g}")
    return value


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
