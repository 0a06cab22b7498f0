# SPDX-License-Identifier: Apache-2.0
"""Tab completion of `imgu` for bash, zsh and fish, made from the commands' own parsers by shtab."""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Mapping
from pathlib import Path

from imgu_ros.errors import ImguError

SHELLS = ("bash", "zsh", "fish")


def completion_script(shell: str, commands: Mapping[str, str]) -> str:
    """Return the script that a shell sources.

    Parameters
    ----------
    shell : one of `SHELLS`
    commands : name -> module, see `cli.main.COMMANDS`

    Raises
    ------
    ImguError
        If shtab is not installed.
    """
    try:
        import shtab
    except ImportError:
        raise ImguError("completion: shtab makes it; need it: pip install shtab") from None
    from imgu_ros.config.parameters import declarations

    parser = argparse.ArgumentParser(prog="imgu")
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    parser.add_argument("--print-completion", choices=SHELLS, help="print the script of tab completion for a shell")
    subparsers = parser.add_subparsers(metavar="COMMAND")
    names = [f"{one.name}:=" for one in declarations()]
    for name, module_name in commands.items():
        module = importlib.import_module(module_name)
        command = subparsers.add_parser(name, help=module.HELP)
        module.add_arguments(command)
        for action in command._actions:
            if action.dest == "overrides" and "-p" in action.option_strings:
                action.choices = names
            elif action.choices is None and (action.type is Path or action.metavar in _FILES):
                action.complete = shtab.FILE  # type: ignore[attr-defined]
        if name == "node":
            from imgu_ros.cli.node import NODES

            next(action for action in command._actions if action.dest == "name").choices = tuple(NODES)
    return str(shtab.complete(parser, shell))


#: Placeholders of arguments that name files or folders.
_FILES = ("FILE", "DIR", "INPUT", "BAG", "SOURCE", "TARGET", "IMAGE", "PATH", "BAG_OR_IMAGES", "RESULTS", "IN", "OUT")
