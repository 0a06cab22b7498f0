# SPDX-License-Identifier: Apache-2.0
"""The reference page of the commands, from their argparse parsers: what `imgu COMMAND --help` prints, as Markdown.

Written by docs/make_reference.py. It is made from the parsers' arguments, not from argparse's text, which differs
between versions of Python.
"""

from __future__ import annotations

import argparse
import importlib
import re
from types import ModuleType

from imgu_ros.cli.main import COMMANDS
from imgu_ros.cli.terminal import Parser

INTRODUCTION = """\
Generated from the code by `docs/make_reference.py`. `imgu --help` lists the commands, `imgu COMMAND --help` prints what
is here. [interfaces.md](../interfaces.md#commands) says more about what they read and write.

Every command exits 0 on success, 1 on a failure that one line on stderr explains, 2 on wrong usage."""


def page() -> list[str]:
    """Return the lines of the page, without its licence."""
    modules = {name: importlib.import_module(path) for name, path in COMMANDS.items()}
    lines = ["# Commands", "", *INTRODUCTION.splitlines(), "", "| command | does |", "|---|---|"]
    lines += [f"| [`imgu {name}`](#imgu-{name}) | {_cell(module.HELP)} |" for name, module in modules.items()]
    for name, module in modules.items():
        lines += ["", f"## imgu {name}", "", *_command(name, module)]
    return [*lines, ""]


def _command(name: str, module: ModuleType) -> list[str]:
    parser = Parser(prog=f"imgu {name}", description=module.__doc__ or module.HELP, allow_abbrev=False)
    module.add_arguments(parser)
    lines = _described(parser.description or "")
    for group in parser._action_groups:
        actions = [action for action in group._group_actions if not isinstance(action, argparse._HelpAction)]
        shown = [action for action in actions if action.help is not argparse.SUPPRESS]
        if not shown:
            continue
        lines += ["", f"**{(group.title or 'options').partition(' (see')[0]}**", ""]
        if group.description:
            lines += [_text(group.description), ""]
        lines += ["| argument | meaning |", "|---|---|"]
        lines += [f"| {_cell(_name(action))} | {_cell(_help(action, parser))} |" for action in shown]
    if parser.epilog:
        lines += ["", *_described(parser.epilog)]
    return lines


def _described(text: str) -> list[str]:
    """Return a description, with its indented lines as code."""
    lines: list[str] = []
    for paragraph in text.strip().split("\n\n"):
        if all(line.startswith("    ") for line in paragraph.splitlines()):
            lines += ["```text", *(line[4:] for line in paragraph.splitlines()), "```", ""]
        else:
            lines += [_text(paragraph), ""]
    return lines[:-1]


def _name(action: argparse.Action) -> str:
    value = action.metavar if isinstance(action.metavar, str) else action.dest
    if not action.option_strings:
        return f"`{value}`" + (" ..." if action.nargs in ("+", "*") else "")
    takes_value = action.nargs != 0
    if action.choices is not None and action.metavar is None:
        value = "{" + ",".join(map(str, action.choices)) + "}"
    elif action.metavar is None:
        value = action.dest.upper()
    if isinstance(action.metavar, tuple):
        value = " ".join(action.metavar)
    suffix = f" {value}" + (" ..." if action.nargs in ("+", "*") else "") if takes_value else ""
    return ", ".join(f"`{option}{suffix}`" for option in action.option_strings)


def _help(action: argparse.Action, parser: argparse.ArgumentParser) -> str:
    values = {**vars(action), "prog": parser.prog}
    text = (action.help or "") % values
    if action.required and action.option_strings:
        text += " (required)"
    return _text(text)


def _text(text: str) -> str:
    """Return a text on one line; what a page would take for a tag or a link is shown as it is."""
    text = " ".join(text.split())
    parts = re.split(r"(`[^`]*`)", text)
    return "".join(part if part.startswith("`") else re.sub(r"([<*])", r"\\\1", part) for part in parts)


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
