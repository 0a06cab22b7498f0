# SPDX-License-Identifier: Apache-2.0
"""Look at the results of a replay in the Rerun viewer, or in Foxglove: pictures, outlines, the camera's path, curves.

Writes RESULTS/view.rrd, which `rerun` opens; with --foxglove RESULTS/view.mcap, for Foxglove. Pictures come from
the recording that was replayed; neither it nor the results are changed. Rerun needs the `view` extra.
"""

from __future__ import annotations

import argparse
import importlib.util
import time
from pathlib import Path

from imgu_ros.cli.terminal import say

HELP = "open the results of a replay in a viewer"

#: The server is looked at so often, s.
_POLL_S = 0.5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("results", type=Path, metavar="RESULTS", help="folder that `imgu replay` wrote")
    parser.add_argument(
        "--recording", nargs="+", type=Path, default=[], metavar="PATH",
        help="the recording that was replayed (default: where it was then)",
    )  # fmt: skip
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="file to write (default: RESULTS/view.rrd or RESULTS/view.mcap)"
    )
    viewer = parser.add_mutually_exclusive_group()
    viewer.add_argument(
        "--web", action="store_true", help="then serve Rerun's web viewer on this machine, until Ctrl-C"
    )
    viewer.add_argument(
        "--foxglove", action="store_true",
        help="write an .mcap for Foxglove instead: image topic and camera_info of the recording, and all results",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Write the file, and say what opens it or serve it."""
    from imgu_ros.cli.progress import Progress
    from imgu_ros.errors import FileError
    from imgu_ros.view.view import view_with_foxglove, view_with_rerun

    if not arguments.foxglove and importlib.util.find_spec("rerun") is None:
        need = """the view extra: pip install ".[view]" in imgu_ros's source folder (or --foxglove, without it)"""
        raise FileError(f"rerun: not installed; need {need}")
    write = view_with_foxglove if arguments.foxglove else view_with_rerun
    with Progress("view") as progress:
        path = write(
            arguments.results,
            arguments.out,
            arguments.recording,
            on_progress=progress,
            on_warning=lambda text: progress.say(f"imgu: warning: {text}"),
        )
    say(path, flush=True)
    if arguments.web:
        return _serve(path)
    if arguments.foxglove:
        say("open it in Foxglove, with the layout config/perception.foxglove.json")
    else:
        say(f"open it with: rerun {path}", f"or in a browser: imgu view {arguments.results} --web")
    return 0


def _serve(path: Path) -> int:
    from imgu_ros.errors import ImguError
    from imgu_ros.view.web_viewer import web_viewer

    try:
        with web_viewer(path) as (address, server):
            say(f"{address} (Ctrl-C ends it)", flush=True)
            while server.poll() is None:
                time.sleep(_POLL_S)
    except KeyboardInterrupt:  # which is what ends it
        return 0
    raise ImguError(f"rerun: its server ended with code {server.returncode}; need one that runs")
