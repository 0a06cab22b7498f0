# SPDX-License-Identifier: Apache-2.0
"""The `imgu` command: finds the subcommand, runs it, and turns its errors into one line and an exit code."""

from __future__ import annotations

import argparse
import contextlib
import errno
import importlib
import os
import shlex
import signal
import sys
from collections.abc import Sequence
from types import ModuleType

from imgu_ros.cli.completion import SHELLS, completion_script
from imgu_ros.cli.terminal import Parser, fail, let_streams_print_everything, say, tell
from imgu_ros.errors import ImguError, ParameterError, nearest_name
from imgu_ros.shown_text import quoted
from imgu_ros.stop_signals import Stopped, requested, stop_signals

#: Every command and the module that does it. A module has `HELP`, `add_arguments(parser)` and `run(arguments)`,
#: and imports nothing heavy before `run`.
COMMANDS = {
    "demo": "imgu_ros.cli.demo",
    "simulate": "imgu_ros.cli.simulate",
    "replay": "imgu_ros.cli.replay",
    "view": "imgu_ros.cli.view",
    "play": "imgu_ros.cli.play",
    "camera": "imgu_ros.cli.camera",
    "node": "imgu_ros.cli.node",
    "match": "imgu_ros.cli.match",
    "demosaic": "imgu_ros.cli.demosaic",
    "filter": "imgu_ros.cli.filter",
    "warp": "imgu_ros.cli.warp",
    "make": "imgu_ros.cli.make",
    "check": "imgu_ros.cli.check",
    "calibrate": "imgu_ros.cli.calibrate",
    "params": "imgu_ros.cli.params",
    "doctor": "imgu_ros.cli.doctor",
    "bench": "imgu_ros.cli.bench",
}

#: Top-level modules that come with the `ros` extra.
ROS_MODULES = ("rclpy", "rcl_interfaces", "sensor_msgs", "geometry_msgs", "nav_msgs", "std_msgs", "std_srvs")

OK, FAILED, USAGE, BROKEN_PIPE = 0, 1, 2, 141
_STOPPED = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the `imgu` command and return its exit code.

    Parameters
    ----------
    argv : arguments without the program's name; those of the process when None

    Returns
    -------
    0 on success, 1 on a failure that one line on stderr explains, 2 on wrong usage, 128 and the signal's number after
    one that asked for a stop (SIGINT: 130, SIGTERM: 143, SIGHUP: 129; of a node 0), once files are complete;
    141 when the reader of the output went away (as if by SIGPIPE)
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    let_streams_print_everything()
    # What OpenCV warns of (a cut PNG) becomes an error that says more. It reads this when it is imported.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")
    # The pipeline's matrices are small: a second thread of BLAS gains nothing, and spins on a core that others need.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with stop_signals():
        try:
            return _run_and_explain(arguments)
        except KeyboardInterrupt as stop:
            if arguments[:1] == ["node"]:  # which only a signal ends, however early
                return OK
            return _stopped(getattr(stop, "number", signal.SIGINT))


def _run_and_explain(arguments: list[str]) -> int:
    try:
        try:
            _refuse_unspeakable(arguments)
            code = _run(arguments)
            sys.stdout.flush()
            return code
        except Exception:
            # What was interrupted may have made an error of its own of it, as C code does in an import.
            if requested():
                raise Stopped(requested()) from None
            raise
    except ImguError as error:
        return _failed(str(error))
    except BrokenPipeError:
        # What is still buffered would raise again when the interpreter flushes stdout at exit.
        _discard_stdout()
        return BROKEN_PIPE
    except ImportError as error:
        if not _is_of_ros(error):
            raise
        need = """the ros extra: pip install ".[ros]" in imgu_ros's source folder"""
        return _failed(f"{error.name or 'rclpy'}: cannot be imported; need {need}")
    except MemoryError:
        return _failed("memory: not enough for what was asked for; need more of it, or less to do")
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            # A write that fails does not know its file's name. What stdout still holds would fail again at exit.
            _flush_or_discard_stdout()
            return _failed(f"output: {error.strerror}; need room for what is written")
        if error.filename is None:
            raise
        name = error.filename if isinstance(error.filename, int) else os.fsdecode(error.filename)
        return _failed(f"{name}: {error.strerror}")


def _refuse_unspeakable(arguments: list[str]) -> None:
    """Refuse what no shell can pass, and no system call take; callers in Python can."""
    for argument in arguments:
        try:
            possible = b"\0" not in os.fsencode(argument)
        except UnicodeEncodeError:
            possible = False
        if not possible:
            raise ParameterError(f"argument {quoted(argument)}: holds what no file name can; need other text")


def _run(arguments: list[str]) -> int:
    name = next((a for a in arguments if not a.startswith("-")), None)
    if name is not None and arguments[0] == name:
        if name not in COMMANDS:
            return _unknown_command(name)
        # Only the module that is asked for is imported.
        module = importlib.import_module(COMMANDS[name])
        parser = Parser(
            prog=f"imgu {name}",
            description=module.__doc__ or module.HELP,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )
        module.add_arguments(parser)
        parser.set_defaults(command_line=shlex.join(["imgu", *arguments]))
        return _parsed_and_run(module, parser, arguments[1:])
    return _top_level(arguments)


def _parsed_and_run(module: ModuleType, parser: argparse.ArgumentParser, arguments: list[str]) -> int:
    try:
        parsed = parser.parse_args(arguments)
    except SystemExit as stop:  # argparse has printed its help or its complaint
        return int(stop.code or 0)
    return int(module.run(parsed))


def _top_level(arguments: list[str]) -> int:
    parser = Parser(
        prog="imgu",
        description="From raw Bayer frames to metric camera poses: live, from bags, and from files.",
        epilog="`imgu COMMAND --help` describes a command.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    parser.add_argument(
        "--print-completion", choices=SHELLS, metavar="SHELL", help=f"print tab completion for {', '.join(SHELLS)}"
    )
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    for name, module_name in COMMANDS.items():
        commands.add_parser(name, help=importlib.import_module(module_name).HELP)
    try:
        parsed = parser.parse_args(arguments)
    except SystemExit as stop:
        return int(stop.code or 0)
    if parsed.version:
        from imgu_ros.report.versions import package_version

        say(f"imgu_ros {package_version()}")
        return OK
    if parsed.print_completion:
        say(*completion_script(parsed.print_completion, COMMANDS).split("\n"))
        return OK
    parser.print_help(sys.stderr)
    return USAGE


def _unknown_command(name: str) -> int:
    near = nearest_name(name, COMMANDS)
    hint = f" (did you mean {near}?)" if near else ""
    fail(f"{quoted(name)} is no command{hint}; need one of {', '.join(COMMANDS)}")
    return USAGE


def _stopped(number: int) -> int:
    _flush_or_discard_stdout()
    name = _STOPPED.get(signal.Signals(number), "hung up")
    with contextlib.suppress(OSError):  # the terminal is gone
        tell(f"imgu: {name}")
    return 128 + number


def _failed(reason: str) -> int:
    fail(reason)
    return FAILED


def _is_of_ros(error: ImportError) -> bool:
    module = (error.name or "").partition(".")[0]
    # Without the extra's middleware rclpy is there, but the import fails on its library.
    return module in ROS_MODULES or "rmw" in str(error) or "rclpy" in str(error)


def _flush_or_discard_stdout() -> None:
    try:
        sys.stdout.flush()
    except OSError:
        _discard_stdout()


def _discard_stdout() -> None:
    with contextlib.suppress(OSError, ValueError):  # stdout may be no file (a test captures it)
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == "__main__":
    sys.exit(main())
