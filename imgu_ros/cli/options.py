"""Options that several commands share: parameters, set exactly as ROS 2 sets them."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from imgu_ros.params import Parameters

_GROUP = "parameters (see `imgu params`)"


def add_parameter_options(parser: argparse.ArgumentParser) -> None:
    """Add `-p NAME:=VALUE` and `--params-file FILE`; both may be repeated, and the later one wins, as in ROS 2."""
    group = parser.add_argument_group(_GROUP)
    group.add_argument(
        "-p", "--param", dest="overrides", metavar="NAME:=VALUE", action="append", type=_override, default=[],
        help="set one parameter; the value is YAML, as with --ros-args",
    )  # fmt: skip
    group.add_argument(
        "--params-file", dest="overrides", metavar="FILE", action="append", type=_file,
        help="set parameters from a ROS 2 parameter file",
    )  # fmt: skip


def parameters_of(arguments: argparse.Namespace, extra: Mapping[str, object] | None = None) -> Parameters:
    """Return the parameters that the command line asks for.

    Parameters
    ----------
    arguments : parsed by a parser that went through `add_parameter_options`
    extra : values that the command sets itself; what the user sets wins

    Raises
    ------
    ParameterError
        If a parameter is unknown, has the wrong type, or lies outside its range.
    FileError
        If a parameter file cannot be read.
    """
    from imgu_ros.files.parameter_files import parse_override, read_parameter_file
    from imgu_ros.parameter_values import parameters_from

    values: dict[str, object] = dict(extra or {})
    for kind, text in arguments.overrides or ():
        if kind == "file":
            values.update(read_parameter_file(Path(text)))
        else:
            name, value = parse_override(text)
            values[name] = value
    return parameters_from(values)


def _override(text: str) -> tuple[str, str]:
    return ("value", text)


def _file(text: str) -> tuple[str, str]:
    return ("file", text)
