# SPDX-License-Identifier: Apache-2.0
"""Intrinsics and distortion from views of a chessboard, to a camera_info YAML as ROS writes it.

Takes image files, folders of them, a video, or a bag. --board counts inner corners: a board of 10 x 7 squares has 9x6.
Hold it at different places, up to the corners of the picture, tilted by 20 to 50 degrees in different directions.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from imgu_ros.cli.options import add_parameter_options, parameters_of
from imgu_ros.cli.terminal import say

if TYPE_CHECKING:
    from imgu_ros.cli.board_views import BoardViews, RefusedPicture
    from imgu_ros.config.parameters import Parameters
    from imgu_ros.vision.camera.calibration import Calibration
    from imgu_ros.vision.camera.chessboard import Chessboard

HELP = "calibrate a camera from views of a chessboard: a camera_info YAML with its uncertainty"

_MODELS = ("plumb_bob", "rational_polynomial", "equidistant")
_SHOWN_REASONS = 8
#: No board has larger squares; 25 is of millimetres.
_LARGEST_SQUARE_M = 2.0
#: Views whose tilt differs by less are warned of.
_LEAST_TILT_DEG = 15.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "input", nargs="+", type=Path, metavar="BAG_OR_IMAGES", help="a bag, a video, images, folders of images"
    )
    parser.add_argument("--board", type=_board, required=True, metavar="9x6", help="inner corners along its sides")
    parser.add_argument("--square", type=_length, required=True, metavar="M", help="side of a square, m, as measured")
    parser.add_argument("--model", choices=_MODELS, default=_MODELS[0], help="lens distortion; default: %(default)s")
    parser.add_argument(
        "--out", type=Path, default=Path("camera_info.yaml"), metavar="YAML", help="default: %(default)s"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every number, with the covariance, to FILE")
    parser.add_argument(
        "--picture", type=Path, metavar="FILE", help="draw the residuals into FILE (PNG, SVG, PDF, EPS)"
    )
    parser.add_argument("--name", default="camera", help="the camera's name in the YAML; default: %(default)s")
    parser.add_argument("--topic", metavar="NAME", help="image topic of a bag; default: the first")
    parser.add_argument("--pattern", choices=("rggb", "bggr", "grbg", "gbrg"), help="image files are Bayer mosaics")
    parser.add_argument(
        "--max-views", type=_views, default=50, metavar="N", help="most views used; default: %(default)s"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace files that exist")
    add_parameter_options(parser, ("raw", "demosaic", "image_topic", "limits"))


def run(arguments: argparse.Namespace) -> int:
    """Find the boards, calibrate, write, and say how good it is."""
    parameters = _parameters(arguments)
    _refuse_to_replace(arguments)
    from imgu_ros.cli.board_views import find_board_views
    from imgu_ros.cli.progress import Progress
    from imgu_ros.files.camera_info_file import write_camera_info
    from imgu_ros.vision.camera.calibration import calibrate
    from imgu_ros.vision.camera.camera_covariance import with_covariance
    from imgu_ros.vision.camera.chessboard import Chessboard

    columns, rows = arguments.board
    board = Chessboard(columns, rows, arguments.square)
    with Progress("calibrate", "pictures") as progress, Progress("calibrate: other boards", "trials") as trials:
        found = find_board_views(
            arguments.input,
            board,
            parameters,
            pattern=arguments.pattern,
            most=arguments.max_views,
            on_progress=progress,
            on_trial=trials,
        )
    calibration = calibrate(
        board.corners(), [view.corners for view in found.views], found.width, found.height, arguments.model
    )
    say(*described(calibration, found, board).split("\n"))
    write_camera_info(arguments.out, with_covariance(calibration.camera, calibration.covariance), arguments.name)
    if arguments.json:
        from imgu_ros.file_access.text_files import write_text

        write_text(arguments.json, json.dumps(document(calibration, found, board), indent=2, allow_nan=False) + "\n")
    if arguments.picture:
        from imgu_ros.report.calibration import draw_calibration

        draw_calibration(arguments.picture, calibration, [view.corners for view in found.views])
    say("", f"{arguments.out}: use it with -p camera.info_file:={arguments.out}, in imgu replay as in imgu node")
    return 0


def described(calibration: Calibration, found: BoardViews, board: Chessboard) -> str:
    """Return the calibration as lines of text for people."""
    import numpy as np

    from imgu_ros.cli.board_views import and_others
    from imgu_ros.vision.camera.angle_of_view import angle_of_view

    camera = calibration.camera
    refused = refused_pictures(calibration, found)
    total = len(calibration.views) + len(refused)
    lines = [f"{len(calibration.views)} of {total} pictures used, {board.columns}x{board.rows} corners in each"]
    for reason in list(dict.fromkeys(picture.reason for picture in refused))[:_SHOWN_REASONS]:
        names = [picture.name for picture in refused if picture.reason == reason]
        lines.append(f"  refused: {names[0]}{and_others(len(names) - 1)}: {reason}")
    lines.append(f"{camera.model}, {camera.width} x {camera.height} px")
    for name, value, sigma in zip(names_of(calibration), values_of(calibration), calibration.sigma, strict=True):
        lines.append(
            f"  {name:<4} {value:>12.{4 if name[0] in 'fc' else 6}f} ± {sigma:.{3 if name[0] in 'fc' else 6}f}"
        )
    view = angle_of_view(camera.K, camera.width, camera.height)
    horizontal, vertical = np.rad2deg([view.horizontal, view.vertical])
    if str(camera.model) != "equidistant":
        lines.append(f"angle of view {horizontal:.1f} x {vertical:.1f} deg (without distortion)")
    lines.append(
        f"residual {calibration.rms_px:.3f} px a coordinate, {calibration.rms_corner_px:.3f} px a corner "
        "(as OpenCV counts)"
    )
    return "\n".join([*lines, *(f"warning: {text}" for text in warnings_of(calibration, found))])


def names_of(calibration: Calibration) -> tuple[str, ...]:
    """Return the names of the parameters, in the order of the covariance."""
    from imgu_ros.vision.camera.distortion_model import COEFFICIENT_NAMES

    return ("fx", "fy", "cx", "cy", *COEFFICIENT_NAMES[calibration.camera.model])


def values_of(calibration: Calibration) -> list[float]:
    """Return the parameters' values, in the order of the covariance."""
    K = calibration.camera.K
    return [float(v) for v in (K[0, 0], K[1, 1], K[0, 2], K[1, 2], *calibration.camera.distortion)]


def refused_pictures(calibration: Calibration, found: BoardViews) -> tuple[RefusedPicture, ...]:
    """Return all pictures that were not used: those that `found` refused, and the outliers."""
    from imgu_ros.cli.board_views import RefusedPicture

    outliers = (
        RefusedPicture(found.views[view.index].name, f"residual {view.rms_px:.2f} px, far above the other views'")
        for view in calibration.outliers
    )
    return (*found.refused, *outliers)


def warnings_of(calibration: Calibration, found: BoardViews) -> list[str]:
    """Return what a user should know before trusting the calibration."""
    import numpy as np

    camera, warnings = calibration.camera, list(found.notes)
    corners = np.concatenate([found.views[view.index].corners for view in calibration.views])
    low, high = corners.min(axis=0), corners.max(axis=0)
    reached = float(np.prod((high - low) / (camera.width, camera.height)))
    if reached < 0.5:
        warnings.append(
            f"corners reach {100 * reached:.0f} % of the picture; the distortion is a guess beyond: need views nearer "
            "to its edges"
        )
    x, y = np.linspace(0, camera.width - 1, 21), np.linspace(0, camera.height - 1, 21)
    border = np.concatenate([np.column_stack((x, np.full(21, at))) for at in (0, camera.height - 1)])
    border = np.concatenate([border, *(np.column_stack((np.full(21, at), y)) for at in (0, camera.width - 1))])
    valid = camera.undistort(border)[1]
    if not valid.all():
        warnings.append(
            "the distortion has no inverse near the picture's edges; need views nearer to them, or another --model"
        )
    share = 100 * float((calibration.sigma[:2] / camera.K[(0, 1), (0, 1)]).max())
    if share > 1:
        warnings.append(f"the focal length is known to {share:.1f} % only; need views tilted by 20 to 50 degrees")
    tilt = tilt_spread(calibration)
    if tilt < _LEAST_TILT_DEG:
        warnings.append(
            f"the board's tilt differs by {tilt:.0f} degrees at most: one tilt tells little of the focal length; need "
            "views tilted by 20 to 50 degrees in different directions"
        )
    if len(calibration.views) < 8:
        warnings.append(f"{len(calibration.views)} views; need ten or more for a good calibration")
    return warnings


def tilt_spread(calibration: Calibration) -> float:
    """Return the largest angle between the board's normals in two of the views, in degrees."""
    import numpy as np

    normals = np.stack([view.pose.R[:, 2] for view in calibration.views])
    return float(np.rad2deg(np.arccos(np.clip((normals @ normals.T).min(), -1, 1))))


def document(calibration: Calibration, found: BoardViews, board: Chessboard) -> dict[str, object]:
    """Return the calibration as what JSON can hold."""
    camera = calibration.camera
    return {
        "board": {"columns": board.columns, "rows": board.rows, "square_m": board.square_m},
        "image_size": [camera.width, camera.height],
        "model": str(camera.model),
        "names": list(names_of(calibration)),
        "values": values_of(calibration),
        "sigma": calibration.sigma.tolist(),
        "covariance": calibration.covariance.tolist(),
        "rms_px": calibration.rms_px,
        "rms_corner_px": calibration.rms_corner_px,
        "iterations": calibration.iterations,
        "warnings": warnings_of(calibration, found),
        "views": [
            {
                "name": found.views[view.index].name,
                "rms_px": view.rms_px,
                "camera_from_board": view.pose.numbers().tolist(),
            }
            for view in calibration.views
        ],
        "refused": [
            {"name": picture.name, "reason": picture.reason} for picture in refused_pictures(calibration, found)
        ],
    }


def _parameters(arguments: argparse.Namespace) -> Parameters:
    from imgu_ros.config.values import parameters_from

    parameters = parameters_of(arguments)
    return parameters if arguments.topic is None else parameters_from({"image_topic": arguments.topic}, parameters)


def _refuse_to_replace(arguments: argparse.Namespace) -> None:
    """Before the work, not after it."""
    from imgu_ros.errors import FileError

    for path in (arguments.out, arguments.json, arguments.picture):
        if path is None:
            continue
        if path.is_dir():
            raise FileError(f"{path}: a folder; need the name of a file")
        if path.exists() and not arguments.overwrite:
            raise FileError(f"{path}: exists; need another name, or --overwrite")
        if not path.absolute().parent.is_dir():
            raise FileError(f"{path}: its folder does not exist; need a place that can be written")
    if arguments.picture:
        from imgu_ros.report.calibration import SUFFIXES

        if arguments.picture.suffix.lower() not in SUFFIXES:
            suffix = arguments.picture.suffix
            raise FileError(f"{arguments.picture}: suffix {suffix!r}; need one of {', '.join(SUFFIXES)}")


def _board(text: str) -> tuple[int, int]:
    columns, _, rows = text.lower().partition("x")
    if not (columns.isdecimal() and rows.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text!r}; need inner corners as COLUMNSxROWS, such as 9x6")
    return int(columns), int(rows)


def _length(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < 1000:
        raise argparse.ArgumentTypeError(f"{text!r}; need metres, such as 0.025")
    if value > _LARGEST_SQUARE_M:
        millimetres = f"{value:g} mm"
        raise argparse.ArgumentTypeError(f"{text!r}; need metres: did you mean {value / 1000:g} ({millimetres})?")
    return value


def _views(text: str) -> int:
    if not text.isdecimal() or int(text) < 3:
        raise argparse.ArgumentTypeError(f"{text!r}; need a whole number of at least 3")
    return int(text)
