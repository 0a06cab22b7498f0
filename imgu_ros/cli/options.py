# SPDX-License-Identifier: Apache-2.0
"""Options shared by commands: parameters, set as in ROS 2."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from imgu_ros.cli.terminal import warn

if TYPE_CHECKING:
    from imgu_ros.config.parameters import Parameters

_GROUP = "parameters (see `imgu params`)"


#: Limits on decoding images, for `only`.
PICTURE_LIMITS = ("limits.picture_mb", "limits.picture_megapixels")
#: Limits on reading bags, for `only`.
BAG_LIMITS = tuple(f"limits.{name}" for name in ("message_mb", "temporary_mb", "expansion", "schema_fields", "text_mb"))


def add_parameter_options(
    parser: argparse.ArgumentParser, only: tuple[str, ...] = (), without: tuple[str, ...] = ()
) -> None:
    """Add `-p NAME:=VALUE` and `--params-file FILE`; both may be repeated and combine as in ROS 2.

    Parameters
    ----------
    parser : of the command
    only : names and groups of the parameters that the command uses; empty: all. `-p` refuses the others; a file may
        hold them, as it may be that of the whole pipeline
    without : names of the parameters that the command does not use, although it uses their group
    """
    used = ", ".join(f"{name}.*" if _is_group(name) else name for name in only)
    group = parser.add_argument_group(_GROUP, f"used here: {used}" if used else None)
    parser.set_defaults(used_parameters=only, unused_parameters=without)
    group.add_argument(
        "-p", "--param", dest="overrides", metavar="NAME:=VALUE", action="append", type=_override, default=[],
        help="set one parameter; the value is YAML, as with --ros-args",
    )  # fmt: skip
    group.add_argument(
        "--params-file", dest="overrides", metavar="FILE", action="append", type=_file,
        help="set parameters from a ROS 2 parameter file",
    )  # fmt: skip


def short_forms(targets: Sequence[str], widths_m: Sequence[float], camera_info: str | None) -> dict[str, object]:
    """Return what `--target`, `--width-m` and `--camera-info` stand for, for `options` of `parameters_of`.

    Raises
    ------
    ParameterError
        If there are widths of more, or of some, of the targets.
    """
    from imgu_ros.errors import ParameterError

    if len(widths_m) not in (0, len(targets)):
        raise ParameterError(f"--width-m: {len(widths_m)} for {len(targets)} --target; need one for each, or none")
    values: dict[str, object] = {}
    if targets:
        values["targets.images"] = list(targets)
    if widths_m:
        values["targets.widths_m"] = list(widths_m)
    if camera_info is not None:
        values["camera.info_file"] = camera_info
    return values


def input_path(text: str) -> Path:
    """Return the path of an input; an empty name, as of a variable that is not set, is none."""
    if not text:
        raise argparse.ArgumentTypeError("empty name; need a path")
    return Path(text)


def whole_number(text: str) -> int:
    """Return a number of things, 0 or more."""
    try:
        value = int(text)
    except ValueError:
        value = -1
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text!r}; need a whole number, 0 or more")
    return value


def picture_rate(text: str) -> float:
    """Return the value of `--rate`: pictures a second."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value <= 1e6:
        raise argparse.ArgumentTypeError(f"{text!r}; need pictures a second, more than 0 and at most 1e6")
    return value


def parameters_of(
    arguments: argparse.Namespace,
    extra: Mapping[str, object] | None = None,
    options: Mapping[str, object] | None = None,
) -> Parameters:
    """Return the parameters that the command line asks for.

    Parameters
    ----------
    arguments : parsed by a parser that went through `add_parameter_options`
    extra : values that the command sets; those of the user take precedence
    options : values of options that stand for parameters; they take precedence over files, and exclude `-p`

    Raises
    ------
    ParameterError
        If a parameter is unknown, of the wrong type, out of range, not used by the command, or given in two ways.
    FileError
        If a parameter file cannot be read.
    """
    from imgu_ros.config.files import GivenParameters
    from imgu_ros.config.values import parameters_from
    from imgu_ros.errors import ParameterError

    given = GivenParameters()
    overridden: list[str] = []
    for kind, text in arguments.overrides or ():
        if kind == "file":
            given.add_file(Path(text))
        else:
            overridden.append(given.add_override(text))
    twice = [name for name in options or () if name in overridden]
    if twice:
        raise ParameterError(f"{twice[0]}: given by -p and by an option that stands for it; need one of them")
    parameters = parameters_from(dict(extra or {}) | given.values() | dict(options or {}))
    if parameters.raw.encoding:
        from imgu_ros.files.frame_reading import check_encoding

        check_encoding(parameters.raw.encoding)
    for line in given.warnings():
        warn(line)
    only = arguments.used_parameters
    for name in overridden:
        if only and not any(name == one or name.startswith(f"{one}.") for one in only):
            raise ParameterError(f"{name}: not used by this command; need one of {', '.join(only)}")
        if name in arguments.unused_parameters:
            raise ParameterError(
                f"{name}: not used by this command, which renders its own frames; need other parameters"
            )
    return parameters


def _is_group(name: str) -> bool:
    return "." not in name and not name.endswith("_topic")


def _override(text: str) -> tuple[str, str]:
    return ("value", text)


def _file(text: str) -> tuple[str, str]:
    return ("file", text)
