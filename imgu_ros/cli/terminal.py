# SPDX-License-Identifier: Apache-2.0
"""What commands say on stdout and stderr; text from outside acts on no terminal."""

from __future__ import annotations

import argparse
import re
import sys
from typing import IO, NoReturn

from imgu_ros.errors import nearest_name
from imgu_ros.shown_text import shown


def say(*lines: object, flush: bool = False) -> None:
    """Print lines on stdout."""
    _print(lines, sys.stdout, flush)


def tell(*lines: object) -> None:
    """Print lines on stderr."""
    _print(lines, sys.stderr, True)


def warn(text: str) -> None:
    """Print a warning that does not end the command."""
    tell(f"imgu: warning: {text}")


def fail(text: str) -> None:
    """Print the line about an error that ends the command."""
    tell(f"imgu: error: {text}")


class Parser(argparse.ArgumentParser):
    """A parser whose complaints show the arguments as `shown` does, and name the option that is nearest."""

    def error(self, message: str) -> NoReturn:
        """Print usage and complaint, and exit."""
        unknown = re.match(r"unrecognized arguments: (--[^\s=]+)", message)
        near = nearest_name(unknown[1], self._option_string_actions) if unknown else ""
        super().error(shown(message) + (f" (did you mean {near}?)" if near else ""))


def let_streams_print_everything() -> None:
    """Let stdout and stderr print escapes for what their encoding has not, instead of failing (`LC_ALL=C`)."""
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)  # what a program put there instead may have none
        if reconfigure is not None:
            reconfigure(errors="backslashreplace")


def _print(lines: tuple[object, ...], stream: IO[str], flush: bool) -> None:
    print(*(shown(str(line)) for line in lines or ("",)), sep="\n", file=stream, flush=flush)
