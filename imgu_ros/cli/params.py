# SPDX-License-Identifier: Apache-2.0
"""List parameters: name, type, default, range or choices, unit, description."""

from __future__ import annotations

import argparse
import sys
import textwrap
from typing import TYPE_CHECKING

from imgu_ros.cli.options import add_parameter_options, parameters_of
from imgu_ros.cli.terminal import say

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from imgu_ros.config.parameters import Declaration

#: On top of what is printed to be a file of the repository. REUSE-IgnoreStart
LICENCE = "SPDX-License-Identifier: Apache-2.0"
# REUSE-IgnoreEnd
#: On top of the file of those to start with.
_BEGIN = """\
# To start with: set the targets, then run one of
#     imgu node perception --params-file basic.yaml -r image_raw:=/camera/image_raw
#     imgu replay BAG --params-file basic.yaml --out results
# `imgu params --all` lists the other parameters; their lines may be added here.
"""
HELP = "list the parameters, or print a ready parameter file"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--yaml", action="store_true", help="print a ROS 2 parameter file: defaults, and what -p sets")
    form.add_argument("--markdown", action="store_true", help="print the reference page")
    which = parser.add_mutually_exclusive_group()
    which.add_argument(
        "names", nargs="*", default=[], metavar="NAME", help="only these parameters, or groups (`homography`)"
    )
    which.add_argument(
        "--all", action="store_true", help="all parameters, group by group (a file or page: the default)"
    )
    which.add_argument("--basic", action="store_true", help="only those to start with (a list: the default)")
    add_parameter_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Print the parameters."""
    from imgu_ros.config.parameters import basic_declarations, declaration, declarations
    from imgu_ros.config.values import parameter_values

    parameters = parameters_of(arguments)
    is_list = not (arguments.yaml or arguments.markdown)
    only_basic = arguments.basic or (is_list and not arguments.all and not arguments.names)
    known_ones = basic_declarations() if only_basic else declarations()
    chosen = [known for known in known_ones if _is_asked_for(known.name, arguments.names)]
    for asked in arguments.names:
        if not any(_is_asked_for(known.name, [asked]) for known in chosen):
            declaration(asked)  # raises, and names the nearest known one
    if arguments.yaml:
        from imgu_ros.config.files import parameter_file_text

        # For programs: exact, where the rest is for people.
        text = parameter_file_text(
            parameter_values(parameters), [known.name for known in chosen], empty_lists=only_basic
        )
        sys.stdout.write(f"# {LICENCE}\n{_BEGIN if only_basic else ''}{text}")
    elif arguments.markdown:
        sys.stdout.write(reference_page(chosen, with_basic=arguments.all or not arguments.names))
    elif arguments.all:
        for heading, members in _by_group(chosen):
            say(f"# {heading}", "")
            _say(members)
    else:
        _say(chosen)
        if only_basic:
            say(f"`imgu params --all` lists all {len(declarations())}, `imgu params GROUP` one group, `--yaml` a file.")
    return 0


def _say(members: Sequence[Declaration]) -> None:
    for known in members:
        say(*described(known).split("\n"))


def _by_group(chosen: Sequence[Declaration]) -> Iterator[tuple[str, list[Declaration]]]:
    """Yield the heading of each group and its parameters."""
    from imgu_ros.config.parameters import group_headings

    for group, heading in group_headings().items():
        members = [known for known in chosen if known.group == group]
        if members:
            yield (f"{group}: {heading}" if group else heading), members


def reference_page(chosen: Sequence[Declaration], with_basic: bool = True) -> str:
    """Return the parameters as a page in Markdown, a table for each group.

    Parameters
    ----------
    chosen : what the page lists
    with_basic : begin with those to start with; they are in their groups as well
    """
    lines = [
        f"<!-- {LICENCE} -->",
        "# Parameters",
        "",
        "Made by `imgu params --markdown`. Set them with `-p NAME:=VALUE` or `--params-file FILE`, in every command as",
        "in ROS 2; `imgu params --yaml` prints a file to start from. One value serves as a list of one.",
    ]
    basic = sorted((known for known in chosen if known.basic and with_basic), key=lambda known: known.basic)
    if basic:
        lines += [
            "",
            "## To start with",
            "",
            "`config/basic.yaml` holds these (`imgu params --basic --yaml`).",
            *_table(basic),
        ]
    for heading, members in _by_group(chosen):
        lines += ["", f"## {heading}", *_table(members)]
    return "\n".join(lines) + "\n"


def _table(members: Sequence[Declaration]) -> Iterator[str]:
    yield from ("", "| name | type | default | values | |", "|---|---|---|---|---|")
    for known in members:
        note = known.description + (" *Fixed while running.*" if known.read_only else "")
        values = ", ".join(f"`{choice}`" for choice in known.choices) or f"{known.range_text} {known.unit}".strip()
        yield f"| `{known.name}` | {known.type_name} | `{_value(known.default)}` | {values} | {note} |"


def described(known: Declaration) -> str:
    """Return one parameter as two indented lines of text."""
    notes = [known.type_name, f"default {_value(known.default)}"]
    if known.choices:
        notes.append("one of " + ", ".join(known.choices))
    if known.bounds or known.unit:
        notes.append(f"{known.range_text} {known.unit}".strip())
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
