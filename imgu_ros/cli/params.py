# SPDX-License-Identifier: Apache-2.0
"""List every parameter: name, type, default, range or choices, unit, description."""

from __future__ import annotations

import argparse
import sys
import textwrap
from typing import TYPE_CHECKING

from imgu_ros.cli.options import add_parameter_options, parameters_of
from imgu_ros.cli.terminal import say

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imgu_ros.config.parameters import Declaration

#: On top of what is printed to be a file of the repository. REUSE-IgnoreStart
LICENCE = "SPDX-License-Identifier: Apache-2.0"
# REUSE-IgnoreEnd
HELP = "list every parameter, or print a ready parameter file"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--yaml", action="store_true", help="print a ROS 2 parameter file: defaults, and what -p sets")
    form.add_argument("--markdown", action="store_true", help="print the reference page")
    parser.add_argument("names", nargs="*", metavar="NAME", help="only these parameters, or groups (`homography`)")
    add_parameter_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Print the parameters."""
    from imgu_ros.config.parameters import declaration, declarations
    from imgu_ros.config.values import parameter_values

    parameters = parameters_of(arguments)
    chosen = [known for known in declarations() if _is_asked_for(known.name, arguments.names)]
    for asked in arguments.names:
        if not any(_is_asked_for(known.name, [asked]) for known in chosen):
            declaration(asked)  # raises, and names the nearest known one
    if arguments.yaml:
        from imgu_ros.config.files import parameter_file_text

        # For programs: exact, where the rest is for people.
        text = parameter_file_text(parameter_values(parameters), [known.name for known in chosen])
        sys.stdout.write(f"# {LICENCE}\n{text}")
        return 0
    if arguments.markdown:
        sys.stdout.write(reference_page(chosen))
        return 0
    for known in chosen:
        say(*described(known).split("\n"))
    return 0


def reference_page(chosen: Sequence[Declaration]) -> str:
    """Return the parameters as a table in Markdown."""
    rows = [
        f"<!-- {LICENCE} -->",
        "# Parameters",
        "",
        "Made by `imgu params --markdown`. Set them with `-p NAME:=VALUE` or `--params-file FILE`, in every command as",
        "in ROS 2; `imgu params --yaml` prints a file to start from.",
        "",
        "| name | type | default | values | |",
        "|---|---|---|---|---|",
    ]
    for known in chosen:
        note = known.description + (" *Fixed while running.*" if known.read_only else "")
        rows.append(f"| `{known.name}` | {known.type_name} | `{_value(known.default)}` | {_values(known)} | {note} |")
    return "\n".join(rows) + "\n"


def _values(known: Declaration) -> str:
    if known.choices:
        return ", ".join(f"`{choice}`" for choice in known.choices)
    if known.minimum is None and known.maximum is None:
        return known.unit
    low = "" if known.minimum is None else _number(known.minimum)
    high = "" if known.maximum is None else _number(known.maximum)
    return f"{low} to {high} {known.unit}".strip()


def described(known: Declaration) -> str:
    """Return one parameter as two indented lines of text."""
    notes = [known.type_name, f"default {_value(known.default)}"]
    if known.choices:
        notes.append("one of " + ", ".join(known.choices))
    if known.minimum is not None or known.maximum is not None:
        low = "-inf" if known.minimum is None else _number(known.minimum)
        high = "inf" if known.maximum is None else _number(known.maximum)
        notes.append(f"{low} to {high}{' ' + known.unit if known.unit else ''}")
    elif known.unit:
        notes.append(known.unit)
    if known.read_only:
        notes.append("read-only while running")
    text = textwrap.indent(textwrap.fill(known.description, 96), "    ")
    return f"{known.name}\n    {'; '.join(notes)}\n{text}\n"


def _is_asked_for(name: str, asked: list[str]) -> bool:
    return not asked or any(name == one or name.startswith(f"{one}.") for one in asked)


def _value(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return "[" + ", ".join(_value(v) for v in value) + "]"
    return repr(value).replace("'", '"')


def _number(value: float) -> str:
    return str(int(value)) if float(value).is_integer() else repr(value)
