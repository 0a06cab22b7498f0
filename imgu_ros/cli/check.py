# SPDX-License-Identifier: Apache-2.0
"""Say beforehand how good a target is: a score, what makes it worse, from which width on it is found, and how exact its
pose will be; exits 1 when one is below the score of a dependable target.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from imgu_ros.cli.options import add_parameter_options, parameters_of
from imgu_ros.cli.terminal import say, tell, warn

if TYPE_CHECKING:
    from imgu_ros.config.parameters import Parameters
    from imgu_ros.vision.camera.intrinsics import Camera

HELP = "how good a target is: score, reasons, smallest width, expected errors"

#: What the camera of the user's frames is said by: of no use here, where frames are simulated.
_USED = (
    "targets", "limits", "pyramid", "keypoints", "descriptor", "matching", "homography", "refinement", "search", "pose",
    "preprocess", "reference", "camera.info_file", "camera.rectified", "raw.grey_weights", "seed",
)  # fmt: skip


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "targets", nargs="*", metavar="TARGET",
        help="an image file, a marker such as tag36h11:7 or a board file, as in targets.images, which is the default",
    )  # fmt: skip
    parser.add_argument(
        "--width-m", type=float, metavar="W", help="printed width of every TARGET, m; for distances in m"
    )
    parser.add_argument(
        "--camera-info", type=Path, metavar="YAML",
        help="calibration of the camera that shall see them; short for -p camera.info_file:=YAML; "
        "default: 640 x 480 px, focal length 600 px (56 degrees wide)",
    )  # fmt: skip
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every number to FILE; -: to stdout, alone")
    parser.add_argument("--report", type=Path, metavar="FILE.html", help="write one page to be shown to a designer")
    add_parameter_options(parser, _USED)


def run(arguments: argparse.Namespace) -> int:
    """Check the targets, and report."""
    parameters = _with_targets(parameters_of(arguments), arguments)
    camera = _camera(parameters)
    from imgu_ros.check.listing import described, document
    from imgu_ros.check.verdict import check_targets
    from imgu_ros.file_access.text_files import write_text
    from imgu_ros.files.target_images import load_target_images
    from imgu_ros.report.versions import package_version

    entries, notes = parameters.targets.images, list[str]()
    images = load_target_images(parameters.targets, notes.append, limits=parameters.limits)
    for note in notes:
        warn(note)
    said = [[note.partition(": ")[2] for note in notes if note.startswith(f"{entry}: ")] for entry in entries]
    if sys.stderr.isatty():
        tell(f"looking at {len(images)} target{'s' * (len(images) > 1)} in simulated views: ten to thirty seconds each")
    checks = check_targets(images, entries, parameters, camera, said)
    numbers = json.dumps(document(checks, camera, package_version()), indent=1, allow_nan=False) + "\n"
    if arguments.json == Path("-"):
        say(*numbers.rstrip("\n").split("\n"))
    else:
        for check in checks:
            say(*described(check))
        if arguments.json:
            write_text(arguments.json, numbers)
    if arguments.report:
        from imgu_ros.report.check_page import write_check_page

        write_check_page(arguments.report, checks, camera, package_version())
    return 0 if all(check.is_dependable for check in checks) else 1


def _with_targets(parameters: Parameters, arguments: argparse.Namespace) -> Parameters:
    from imgu_ros.errors import ParameterError

    targets = parameters.targets
    if arguments.targets:
        # Names and widths of the file's targets are those of others.
        targets = replace(targets, images=tuple(arguments.targets), names=(), widths_m=())
    if not targets.images:
        raise ParameterError("TARGET: none; need an image file or a marker such as tag36h11:7")
    if arguments.width_m is not None:
        if not 1e-3 <= arguments.width_m <= 100:
            raise ParameterError(f"--width-m: {arguments.width_m:g} m; need 0.001 to 100 m")
        targets = replace(targets, widths_m=(arguments.width_m,) * len(targets.images))
    camera = parameters.camera
    if arguments.camera_info is not None:
        camera = replace(camera, info_file=str(arguments.camera_info))
    return replace(parameters, targets=targets, camera=camera)


def _camera(parameters: Parameters) -> Camera:
    from imgu_ros.check.trial_views import DEFAULT_CAMERA
    from imgu_ros.files.camera_info_file import read_camera_info

    if not parameters.camera.info_file:
        return DEFAULT_CAMERA
    return read_camera_info(parameters.camera.info_file, rectified=parameters.camera.rectified)
