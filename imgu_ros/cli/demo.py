# SPDX-License-Identifier: Apache-2.0
"""See the whole thing work: simulate a Bayer bag with exact ground truth, replay it, and report how accurate it is.

DIR/bag holds the simulated bag, DIR/replay what `imgu replay` writes, report.html among it. Only an earlier demo is
ever overwritten.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from imgu_ros.cli.options import add_parameter_options, parameters_of
from imgu_ros.cli.terminal import say
from imgu_ros.errors import FileError, ParameterError

HELP = "simulate a Bayer bag, replay it, and report the accuracy"

_MARK = ".imgu_demo"
_OUT = Path("imgu_demo")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--out", type=Path, default=_OUT, metavar="DIR", help="folder (default: %(default)s)")
    parser.add_argument("--frames", type=int, default=60, metavar="N", help="frames to simulate (default: %(default)s)")
    add_parameter_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Simulate, replay, print the table, and say how to open the report."""
    if arguments.frames < 1:
        raise ParameterError(f"--frames: {arguments.frames}; need at least 1")
    # What the user sets is checked before minutes are spent on the simulation.
    parameters_of(arguments)
    from imgu_ros.replay.folder_lock import locked_folder

    _claim(arguments.out)
    with locked_folder(arguments.out):
        return _demo(arguments)


def _demo(arguments: argparse.Namespace) -> int:
    from imgu_ros.cli.progress import Progress
    from imgu_ros.cli.replay import accuracy_table
    from imgu_ros.config.files import read_parameter_file
    from imgu_ros.replay.recording import PARAMETER_FILE, TRUTH_FILE, record_simulation
    from imgu_ros.replay.replay import replay
    from imgu_ros.simulate.sequence import Simulation

    bag, results = arguments.out / "bag", arguments.out / "replay"
    simulation = Simulation(frames=arguments.frames)
    say(
        f"simulating {simulation.frames} frames of {simulation.width} x {simulation.height}, Bayer, into {bag}",
        flush=True,
    )
    with Progress("simulate") as progress:
        record_simulation(bag, simulation, overwrite=True, on_progress=progress)
    parameters = parameters_of(arguments, read_parameter_file(bag / PARAMETER_FILE))
    say(f"replaying it into {results}", flush=True)
    with Progress("replay") as progress:
        summary = replay(
            [bag],
            results,
            parameters,
            truth=bag / TRUTH_FILE,
            overwrite=True,
            command=arguments.command_line,
            on_progress=progress,
            on_warning=lambda text: progress.say(f"imgu: warning: {text}"),
        )
    say("", *accuracy_table(summary).split("\n"), "")
    say(f"The report, for any browser: {(results / 'report.html').resolve().as_uri()}")
    return 0


def _claim(out: Path) -> None:
    """Make the folder, unless it holds something that is not an earlier demo."""
    try:
        if out.is_dir() and any(out.iterdir()) and not (out / _MARK).is_file():
            raise FileError(f"{out}: folder is not empty and no earlier demo; need another --out")
        out.mkdir(parents=True, exist_ok=True)
        (out / _MARK).touch()
    except OSError as error:
        raise FileError(f"{out}: {error.strerror}; need a folder that can be written") from None
