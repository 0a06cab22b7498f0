# SPDX-License-Identifier: Apache-2.0
"""Parameters in files that have no effect, without a message of ROS 2; apart from process.py, as it needs no ROS."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from imgu_ros.config.files import parameter_file_bytes
from imgu_ros.config.rcl_parameters import RclParameters, section_applies, with_slash
from imgu_ros.errors import ImguError


def unheeded_parameters(ros_arguments: Sequence[str], node_name: str) -> list[str]:
    """Return a line for each file without a section for the node, and for each value that ROS 2 does not put in force.

    Parameters
    ----------
    ros_arguments : as given to rclpy, which has read them already and decides what they mean
    node_name : fully qualified, "/namespace/name"
    """
    lines = []
    given = RclParameters()
    try:
        for file, sections in _read(given, ros_arguments):
            if not any(section_applies(section, node_name) for section in sections):
                found = ", ".join(dict.fromkeys(sections)) or "no node"
                lines.append(f"{file}: sections for {found}; need one for {node_name} or /**")
    except ImguError:
        return []  # rcl has read it, and rcl decides
    return lines + given.overruled(lambda section: section_applies(with_slash(section), node_name))


def parameter_fault(ros_arguments: Sequence[str]) -> str:
    """Return what is wrong with the parameters in arguments that rcl has refused; "" when it is something else."""
    try:
        for _ in _read(RclParameters(), ros_arguments):
            pass
    except ImguError as error:
        return str(error)
    return ""


def _read(given: RclParameters, ros_arguments: Sequence[str]) -> Iterator[tuple[str, list[str]]]:
    """Add files and overrides in their order; yield each file with its sections."""
    for kind, text in _parameter_arguments(ros_arguments):
        if kind == "value":
            given.add_override(text)
        # A pipe has been emptied by rcl.
        elif not Path(text).exists() or Path(text).is_file():
            yield text, given.add_file(parameter_file_bytes(text), text)


def _parameter_arguments(arguments: Sequence[str]) -> Iterator[tuple[str, str]]:
    following = iter(arguments)
    for argument in following:
        if argument in ("-p", "--param"):
            yield "value", next(following, "")
        elif argument == "--params-file":
            yield "file", next(following, "")
