# SPDX-License-Identifier: Apache-2.0
"""Run a live ROS 2 node. `perception` is the whole pipeline, from image to pose, in one process; the others are one
stage each, to be spread over processes and hosts.

Everything after the name is for the node: `-p NAME:=VALUE` and `--params-file FILE`, `-r FROM:=TO` to remap, with or
without `--ros-args` before them.
"""

from __future__ import annotations

import argparse
import importlib

from imgu_ros.cli.terminal import fail, say
from imgu_ros.errors import ParameterError, nearest_name
from imgu_ros.shown_text import quoted

HELP = "run a live node"

#: Every node and the module that runs it: `run(ros_arguments, stop) -> int`.
NODES = {
    "perception": "imgu_ros.ros.perception",
    "demosaic": "imgu_ros.ros.stages.demosaic",
    "pyramid": "imgu_ros.ros.stages.pyramid",
    "features": "imgu_ros.ros.stages.features",
    "matcher": "imgu_ros.ros.stages.matcher",
    "homography": "imgu_ros.ros.stages.homography",
    "pose": "imgu_ros.ros.stages.pose",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.usage = "imgu node NAME [-p NAME:=VALUE] [--params-file FILE] [--ros-args ...]"
    parser.add_argument(
        "--print-dds-profile", action="store_true", help="print the path of the DDS profile for large images"
    )
    parser.add_argument("name", nargs="?", metavar="NAME", help=f"the node: {', '.join(NODES)}")
    parser.add_argument("rest", nargs=argparse.REMAINDER, metavar="...", help="arguments of the node")


def run(arguments: argparse.Namespace) -> int:
    """Run the node until SIGINT or SIGTERM; both end it with exit code 0."""
    if arguments.print_dds_profile:
        from imgu_ros.ros.middleware import profile_path

        say(profile_path())
        return 0
    if arguments.name is None:
        fail("no node given; need one of " + ", ".join(NODES))
        return 2
    if arguments.name not in NODES:
        fail(_unknown(arguments.name))
        return 2
    if "-h" in arguments.rest or "--help" in arguments.rest:
        say(
            f"usage: imgu node {arguments.name} [-p NAME:=VALUE] [--params-file FILE] [-r FROM:=TO] [--ros-args ...]",
            "",
            "`imgu params` lists the parameters to start with, `imgu params --all` all.",
        )
        return 0
    try:
        ros_arguments = ros_arguments_of(arguments.rest)
    except ParameterError as error:
        fail(str(error))
        return 2

    from imgu_ros.process_memory import bound_free_memory
    from imgu_ros.ros.middleware import require_room_to_start, set_profile
    from imgu_ros.ros.stopping import StopRequested, StopSignal

    require_room_to_start()
    set_profile()
    bound_free_memory()
    with StopSignal() as stop:
        try:
            with stop.interruptible():
                module = importlib.import_module(NODES[arguments.name])
            return int(module.run(ros_arguments, stop))
        except StopRequested:
            return 0


def ros_arguments_of(rest: list[str]) -> list[str]:
    """Return a node's arguments as ROS wants them, `--ros-args` first.

    Parameters
    ----------
    rest : `-p`, `--param`, `--params-file`, `-r`, `--remap` with their values and `--log-level`, before `--ros-args`
        or after it

    Raises
    ------
    ParameterError
        If there is an argument that is none of ROS's.
    """
    direct: list[str] = []
    position = 0
    while position < len(rest) and rest[position] != "--ros-args":
        option, equals, value = rest[position].partition("=")
        if option not in _ROS_OPTIONS:
            raise ParameterError(
                f"{rest[position]}: unknown argument; need -p NAME:=VALUE, --params-file FILE or --ros-args ..."
            )
        if equals and option.startswith("--"):
            position += 1
        elif position + 1 < len(rest):
            value = rest[position + 1]
            position += 2
        else:
            raise ParameterError(f"{option}: no value; need one after it")
        direct += [option, value]
    return ["--ros-args", *direct, *rest[position + 1 :]] if direct else rest[position:]


_ROS_OPTIONS = ("-p", "--param", "--params-file", "-r", "--remap", "--log-level")


def _unknown(name: str) -> str:
    near = nearest_name(name, NODES)
    hint = f" (did you mean {near}?)" if near else ""
    return f"{quoted(name)} is no node{hint}; need one of {', '.join(NODES)}"
