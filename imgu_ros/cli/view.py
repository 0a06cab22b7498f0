# SPDX-License-Identifier: Apache-2.0
"""Look at the results of a replay in the Rerun viewer, or in Foxglove: pictures, outlines, the camera's path, curves.

Writes RESULTS/view.rrd, which `rerun` opens; with --foxglove RESULTS/view.mcap, for Foxglove. Pictures come from
the recording that was replayed; neither it nor the results are changed. Rerun needs the `view` extra.

With --live and no RESULTS: a page on this machine that shows what `imgu node perception` finds right now.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import time
from pathlib import Path

from imgu_ros.cli.terminal import fail, say, tell

HELP = "open the results of a replay in a viewer, or watch a live node"

#: The server is looked at so often, s.
_POLL_S = 0.5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.usage = "imgu view RESULTS [options] | imgu view --live [--port N] [--ros-args ...]"
    parser.add_argument("results", nargs="?", type=Path, metavar="RESULTS", help="folder that `imgu replay` wrote")
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

    viewer.add_argument(
        "--live", action="store_true",
        help="serve a page with the overlays of a node that runs, until Ctrl-C; needs the `ros` extra",
    )  # fmt: skip
    parser.add_argument("--port", type=_port, metavar="N", help="of --live (default 8765, or a free one)")
    parser.add_argument("--ros-args", nargs=argparse.REMAINDER, default=[], help="of --live: -r FROM:=TO, ...")


def _port(text: str) -> int:
    if not text.isdecimal() or not 0 < int(text) < 65536:
        raise argparse.ArgumentTypeError(f"{text!r}; need a port, 1 to 65535")
    return int(text)


def run(arguments: argparse.Namespace) -> int:
    """Write the file, and say what opens it or serve it; or serve what is live."""
    if arguments.live == (arguments.results is not None):
        fail("view: need RESULTS, the folder that `imgu replay` wrote, or --live")
        return 2
    others = ("recording", "out") if arguments.live else ("port", "ros_args")
    useless = next((name for name in others if getattr(arguments, name)), None)
    if useless:
        owner = "of RESULTS, not of --live" if arguments.live else "of --live, not of RESULTS"
        fail(f"--{useless.replace('_', '-')}: {owner}; need it left out")
        return 2
    return _live(arguments) if arguments.live else _of_results(arguments)


def _live(arguments: argparse.Namespace) -> int:
    from imgu_ros.ros.middleware import require_room_to_start, set_profile
    from imgu_ros.ros.stopping import StopRequested, StopSignal

    require_room_to_start()
    set_profile()
    with StopSignal() as stop, contextlib.suppress(StopRequested):
        with stop.interruptible():
            from imgu_ros.ros.live_page import run_live_page
        ros_arguments = ["--ros-args", *arguments.ros_args] if arguments.ros_args else []
        run_live_page(arguments.port, ros_arguments, stop, tell)
    return 0


def _of_results(arguments: argparse.Namespace) -> int:
    from imgu_ros.cli.progress import Progress
    from imgu_ros.errors import FileError
    from imgu_ros.view.view import view_with_foxglove, view_with_rerun

    if not arguments.foxglove and importlib.util.find_spec("rerun") is None:
        need = """the view extra: pip install ".[view]" in imgu_ros's source folder (or --foxglove, without it)"""
        raise FileError(f"rerun: not installed; need {need}")
    view_file = view_with_foxglove if arguments.foxglove else view_with_rerun
    with Progress("view") as progress:
        path = view_file(
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
