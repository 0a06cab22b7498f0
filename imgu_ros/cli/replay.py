# SPDX-License-Identifier: Apache-2.0
"""Run the whole pipeline over one recorded image topic, offline: no DDS, no rclpy.

Reads rosbag1 and rosbag2 (SQLite, MCAP, compressed), video files, and pictures (files, folders, patterns); several
paths are the parts of one recording. Writes into DIR: frames.csv (a row for every frame and target),
poses_<target>.tum, ambiguous.csv, results/ (a rosbag2), summary.json and report.html.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from imgu_ros.cli.options import add_parameter_options, input_path, parameters_of, picture_rate, short_forms
from imgu_ros.cli.terminal import say

if TYPE_CHECKING:
    from imgu_ros.report.summary import Percentiles, Summary, TargetSummary

HELP = "run the pipeline over a recorded bag: poses, a results bag, a report"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "bags", nargs="+", type=input_path, metavar="INPUT",
        help="a bag (rosbag1 file, rosbag2 folder or file), videos, or pictures (files, a folder, a pattern)",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the results; made if needed")
    parser.add_argument(
        "--target", action="append", default=[], metavar="FILE",
        help="picture of a target, or a marker such as tag36h11:7; short for -p targets.images:=...; can be repeated",
    )  # fmt: skip
    parser.add_argument(
        "--width-m", action="append", type=float, default=[], metavar="W",
        help="printed width of the target, m; one for each --target",
    )  # fmt: skip
    parser.add_argument(
        "--camera-info", metavar="FILE",
        help="calibration of the camera, as `imgu calibrate` writes it; short for -p camera.info_file:=FILE",
    )  # fmt: skip
    parser.add_argument(
        "--rate", type=picture_rate, default=0.0, metavar="HZ",
        help="of pictures: so many a second; default: their names or Exif tell when they were taken",
    )  # fmt: skip
    parser.add_argument("--truth", type=Path, metavar="FILE", help="truth.csv of `imgu simulate`: report the errors")
    parser.add_argument(
        "--record", nargs="+", action="extend", default=[], metavar="TOPIC",
        help="also record these: keypoints, matches, path, image_color, image_mono, debug_image, ...",
    )  # fmt: skip
    parser.add_argument(
        "--check", action="store_true", help="put the targets' scores of `imgu check` into the report: seconds each"
    )
    parser.add_argument(
        "--overwrite", action="store_true", help="replace the files of an earlier replay in DIR, nothing else"
    )
    add_parameter_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Replay, print what came out, and say where it is."""
    options = short_forms(arguments.target, arguments.width_m, arguments.camera_info)
    parameters = parameters_of(arguments, options=options)
    from imgu_ros.cli.progress import Progress
    from imgu_ros.replay.replay import replay

    with Progress("replay") as progress:
        summary = replay(
            arguments.bags,
            arguments.out,
            parameters,
            truth=arguments.truth,
            record=arguments.record,
            overwrite=arguments.overwrite,
            rate_hz=arguments.rate,
            check=arguments.check,
            command=arguments.command_line,
            on_progress=progress,
            on_warning=lambda text: progress.say(f"imgu: warning: {text}"),
        )
    say(*accuracy_table(summary).split("\n"), "", arguments.out / "report.html")
    return 0


def accuracy_table(summary: Summary) -> str:
    """Return what came out of a replay as lines of text."""
    from imgu_ros.report.digits import figures

    lines: list[str] = []
    for target in summary.targets:
        lines += _target_lines(target)
    lines.append(f"{summary.frames} frames, {summary.rejected} rejected, {figures(summary.frames_per_s)} frames/s")
    if summary.total_ms is not None:
        lines.append("ms, p50 / p95")
        for name, times in (*summary.stage_ms.items(), ("whole frame", summary.total_ms)):
            where = "" if times.count == summary.frames else f"   in {times.count} frames"
            lines.append(f"  {name:<32}{figures(times.p50)} / {figures(times.p95)}{where}")
    return "\n".join(lines)


def _target_lines(target: TargetSummary) -> list[str]:
    from imgu_ros.report.digits import figures

    lines = [f"{target.name}", f"  {'found / frames':<32}{target.found} / {target.frames}"]

    def add(name: str, values: Percentiles | None) -> None:
        if values is not None:
            lines.append(f"  {name:<32}{figures(values.p50, 2)} / {figures(values.p95, 2)}")

    if target.n_inliers is not None:
        lines.append(f"  {'inliers, p50':<32}{figures(target.n_inliers.p50)}")
    add("residual px, p50 / p95", target.rms_px)
    add("corner error px, p50 / p95", target.corner_error_px)
    add("rotation error deg, p50 / p95", target.rotation_error_deg)
    add("translation error %, p50 / p95", target.translation_error_percent)
    missing = [f"{count} {name}" for name, count in target.status.items() if count and name not in _FOUND]
    missing += [f"{count} {name}" for name, count in target.pose_status.items() if count and name != "metric"]
    if missing:
        lines.append(f"  {'without a find or a pose':<32}{', '.join(missing)}")
    return lines


_FOUND = ("tracked", "detected")
