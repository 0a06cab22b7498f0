# SPDX-License-Identifier: Apache-2.0
"""Find a target in an image, two files, with the very pipeline of the live node; exits 1 when it is not found."""

from __future__ import annotations

import argparse
import dataclasses
import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from imgu_ros.cli.options import add_parameter_options, parameters_of
from imgu_ros.cli.terminal import fail, say, warn

if TYPE_CHECKING:
    from imgu_ros.config.parameters import Parameters
    from imgu_ros.frame import Frame
    from imgu_ros.result import ReferenceResult, Result
    from imgu_ros.vision.camera.pose import Pose

HELP = "find a target in an image file: homography, and the pose when the camera is given"

#: `vision.processing.interpolation` has the same; importing it would cost `--help` half a second.
INTERPOLATIONS = ("area", "nearest", "linear", "cubic")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("target", type=Path, metavar="TARGET", help="picture of the flat target")
    parser.add_argument("image", type=Path, metavar="IMAGE", help="picture in which to look for it")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every number to FILE")
    parser.add_argument(
        "--draw", type=Path, metavar="FILE",
        help="write the image with the find drawn over to FILE; .svg, .pdf, .eps and .ps: drawn as vectors",
    )  # fmt: skip
    parser.add_argument(
        "--warp", type=Path, metavar="FILE",
        help="write the target as IMAGE shows it, seen straight on, on the pixel grid of TARGET, to FILE",
    )  # fmt: skip
    parser.add_argument(
        "--interpolation", choices=INTERPOLATIONS,
        help="of --warp; default: area, the mean over a pixel's area where IMAGE shows more detail than TARGET",
    )  # fmt: skip
    parser.add_argument("--width-m", type=float, metavar="W", help="printed width of the target, m; for the pose")
    parser.add_argument(
        "--camera-info",
        type=Path,
        metavar="YAML",
        help="calibration of the camera, of ROS, OpenCV or Kalibr, for the pose; short for -p camera.info_file:=YAML",
    )
    parser.add_argument(
        "--pattern", choices=("rggb", "bggr", "grbg", "gbrg"), help="IMAGE is a Bayer mosaic; as -p raw.encoding"
    )
    add_parameter_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the pipeline on the image, and report."""
    parameters = _with_target(parameters_of(arguments), arguments)
    _check_outputs(arguments)
    from imgu_ros.files.target_images import load_target_images
    from imgu_ros.localizer import Localizer
    from imgu_ros.reference.size_checks import SizeChecks
    from imgu_ros.reference_kinds import prepare_references

    targets = prepare_references(load_target_images(parameters.targets, warn, limits=parameters.limits), parameters)
    frame = _frame(arguments, parameters)
    if arguments.warp:
        _check_warp(arguments.warp, frame)
    result = Localizer(_with_transfer(parameters, frame), targets).process(frame)
    found = result.first
    for line in (frame.camera_reason, *result.camera_remarks):
        if line:
            warn(line)
    say(*described(result).split("\n"))
    for warning in SizeChecks(targets).add(result):
        warn(warning)
    if arguments.json:
        from imgu_ros.file_access.text_files import write_text

        write_text(arguments.json, json.dumps(document(result), indent=2, allow_nan=False) + "\n")
    if arguments.draw:
        from imgu_ros.report.overlay import write_overlay

        write_overlay(arguments.draw, result)
    if arguments.warp and found.homography is not None:
        _write_warped(arguments, result, targets[0].size)
    if found.status.found:
        return 0
    fail(f"{arguments.image}: {found.name} not found: {found.reason}")
    return 1


def described(result: Result) -> str:
    """Return the first target's result as a few lines for people."""
    import numpy as np

    target = result.first
    keypoints = 0 if result.keypoints is None else len(result.keypoints)
    lines = [f"{target.name}: {target.status.value}", f"  keypoints   {keypoints}"]
    if target.matches is not None:
        agree = np.count_nonzero(target.matches.inliers)
        lines.append(f"  matches     {len(target.matches.matches)}, of which {agree} agree")
    if target.homography is not None and target.outline is not None:
        inliers = target.homography.inliers
        lines.append(f"  inliers     {np.count_nonzero(inliers)} of {len(inliers)} points in the final fit")
        lines.append(f"  residual    {target.homography.rms_px:.3f} px rms")
        lines.append("  H           " + "\n              ".join(_row(row) for row in target.homography.H))
        lines.append("  corners     " + ", ".join(f"({x:.2f}, {y:.2f})" for x, y in target.outline) + " px")
    if target.pose is not None:
        position, sigma = target.pose.t, np.sqrt(np.diag(target.pose.covariance))
        lines.append(
            f"  position    {', '.join(f'{p:.5f}' for p in position)} m, "
            f"± {', '.join(f'{1e3 * s:.2g}' for s in sigma[:3])} mm"
        )
        lines.append(f"  rotation    ± {', '.join(f'{s:.3f}' for s in np.rad2deg(sigma[3:]))} deg")
    elif target.pose_status:
        lines.append(f"  no pose     {_no_pose(target, result.frame.camera_reason)}")
    lines.append(f"  time        {result.total_ns / 1e6:.1f} ms")
    return "\n".join(lines)


def document(result: Result) -> dict[str, object]:
    """Return the first target's result as what JSON can hold; null for what is unknown."""
    import numpy as np

    target, estimate = result.first, result.first.homography
    matches = target.matches
    return {
        "target": target.name,
        "status": target.status.value,
        "pose_status": target.pose_status.value,
        "reason": target.reason,
        "n_keypoints": None if result.keypoints is None else len(result.keypoints),
        "n_matches": None if matches is None else len(matches.matches),
        "n_inliers": None if estimate is None else int(np.count_nonzero(estimate.inliers)),
        "rms_px": None if estimate is None else estimate.rms_px,
        "confirmed_share": target.confirmed_share,
        "H": None if estimate is None else estimate.H.tolist(),
        "H_covariance": None if estimate is None else estimate.covariance.tolist(),
        "outline_px": None if target.outline is None else target.outline.tolist(),
        "pose": None if target.pose is None else _pose_document(target.pose),
        "solutions": [_pose_document(pose) for pose in target.solutions],
        "ambiguity": target.ambiguity,
        "calibration": None if result.calibration is None else dataclasses.asdict(result.calibration),
        "matches": None
        if matches is None
        else {
            "template_xy": matches.template_xy.tolist(),
            "image_xy": matches.image_xy.tolist(),
            "distance": np.asarray(matches.matches.distance, float).tolist(),
            "inlier": matches.inliers.tolist(),
        },
        "ms": {stage.value: time / 1e6 for stage, time in (result.times_ns or {}).items()},
        "total_ms": result.total_ns / 1e6,
    }


def _check_outputs(arguments: argparse.Namespace) -> None:
    """Before the work, not after it."""
    from imgu_ros.errors import FileError

    for path in (arguments.json, arguments.draw, arguments.warp):
        if path is not None and not path.absolute().parent.is_dir():
            raise FileError(f"{path}: its folder does not exist; need a place that can be written")
    if arguments.draw:
        from imgu_ros.report.overlay import check_overlay_suffix

        check_overlay_suffix(arguments.draw)
    if arguments.warp:
        from imgu_ros.image_files.images import check_image_file

        check_image_file(arguments.warp)
    elif arguments.interpolation:
        from imgu_ros.errors import ParameterError

        raise ParameterError(f"--interpolation: {arguments.interpolation} without --warp; need --warp FILE")


def _check_warp(path: Path, frame: Frame) -> None:
    """Whether the file can hold the frame's data type and channels, colours for a mosaic."""
    import numpy as np

    from imgu_ros.image_files.images import check_image_file
    from imgu_ros.vision.formation.layout import ColorModel

    colored = frame.image.layout.color is not ColorModel.MONO
    check_image_file(path, np.zeros((1, 1, 3) if colored else (1, 1), frame.image.pixels.dtype))


def _write_warped(arguments: argparse.Namespace, result: Result, size: tuple[int, int]) -> None:
    from imgu_ros.image.rectification import rectified
    from imgu_ros.image_files.images import write_image
    from imgu_ros.vision.formation.layout import ColorModel

    frame, homography = result.frame, result.first.homography
    mosaic = frame.image.layout.color is ColorModel.BAYER
    scene = result.developed.color() if mosaic and result.developed is not None else frame.image.pixels
    if homography is not None:
        way = arguments.interpolation or INTERPOLATIONS[0]
        write_image(arguments.warp, rectified(scene, homography.H, size, frame.camera, way))


def _with_target(parameters: Parameters, arguments: argparse.Namespace) -> Parameters:
    from imgu_ros.config.values import parameters_from

    width = 0.0 if arguments.width_m is None else arguments.width_m
    # The lists are checked together: clear the parallel ones that a parameter file may have set.
    values: dict[str, object] = {"targets.names": [], "targets.poses": []}
    if arguments.camera_info:
        values["camera.info_file"] = str(arguments.camera_info)
    return parameters_from(
        {**values, "targets.images": [str(arguments.target)], "targets.widths_m": [width]}, parameters
    )


def _with_transfer(parameters: Parameters, frame: Frame) -> Parameters:
    """Return the parameters with sRGB for an 8-bit image file that is no mosaic, unless they say another transfer."""
    from imgu_ros.vision.formation.layout import ColorModel

    image = frame.image
    if parameters.raw.transfer != "auto" or image.layout.color is ColorModel.BAYER or image.pixels.dtype != "uint8":
        return parameters
    return replace(parameters, raw=replace(parameters.raw, transfer="srgb"))


def _frame(arguments: argparse.Namespace, parameters: Parameters) -> Frame:
    from imgu_ros.cli.picture_layout import picture_layout
    from imgu_ros.frame import Frame
    from imgu_ros.image_files.images import read_image_file
    from imgu_ros.vision.formation.layout import RawImage

    file = read_image_file(arguments.image, limits=parameters.limits)
    pixels = file.pixels
    for note in file.notes:
        warn(f"{arguments.image}: {note}")
    layout = picture_layout(arguments.image, pixels, arguments.pattern, parameters.raw.encoding)
    image, camera = RawImage(pixels, layout), parameters.camera
    if not camera.info_file:
        return Frame(image, 0, "camera", None)
    from imgu_ros.files.camera_info_file import read_calibration
    from imgu_ros.files.target_images import expanded_path

    size = (pixels.shape[1], pixels.shape[0])
    path = expanded_path(camera.info_file)
    read = read_calibration(
        path,
        rectified=camera.rectified,
        image_size=size,
        covariance=camera.covariance,
        limits=parameters.limits,
    )
    return Frame(image, 0, "camera", read.camera, read.reason, read.remarks)


def _pose_document(pose: Pose) -> dict[str, object]:
    numbers = pose.transform.numbers().tolist()
    return {
        "position_m": numbers[:3],
        "quaternion_xyzw": numbers[3:],
        "covariance": pose.covariance.tolist(),
        "rms_px": pose.rms_px,
    }


def _row(row: object) -> str:
    import numpy as np

    return " ".join(f"{value: .6e}" for value in np.asarray(row))


def _no_pose(target: ReferenceResult, camera_reason: str) -> str:
    words = {"no_size": "need --width-m"}
    if target.pose_status.value == "uncalibrated" and not camera_reason:
        words["uncalibrated"] = "need --camera-info"
    return f"{target.pose_status.value}: {words.get(target.pose_status.value, target.reason)}"
