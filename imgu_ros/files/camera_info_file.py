# SPDX-License-Identifier: Apache-2.0
"""Camera calibration files: those of ROS, OpenCV and Kalibr are read, ROS's YAML is written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml

from imgu_ros.config.parameters import DEFAULT_LIMITS, LimitsParameters
from imgu_ros.errors import FileError
from imgu_ros.file_access.bounded_reading import file_bytes
from imgu_ros.file_access.text_files import write_text
from imgu_ros.files.calibration_formats import described_camera
from imgu_ros.messages.camera_reading import CameraDescription, CameraReading, read_camera
from imgu_ros.messages.distortion_names import message_name
from imgu_ros.types import Floats
from imgu_ros.vision.camera.intrinsics import Camera


def read_camera_info(path: Path | str, *, rectified: bool = False) -> Camera:
    """Read the camera of a calibration file.

    Parameters
    ----------
    path : a file in one of the formats of `imgu_ros.files.calibration_formats`
    rectified : of the rectified images: P and no distortion

    Raises
    ------
    FileError
        If the file is missing or none of these formats, or what it says cannot be used.
    """
    read = read_calibration(path, rectified=rectified)
    if read.camera is None:
        raise FileError(read.reason)
    return read.camera


def read_calibration(
    path: Path | str,
    *,
    rectified: bool = False,
    image_size: tuple[int, int] | None = None,
    covariance: tuple[float, ...] = (),
    limits: LimitsParameters = DEFAULT_LIMITS,
) -> CameraReading:
    """Read a calibration file as a camera_info message is read: what cannot be used is the reading's reason.

    Parameters
    ----------
    path, rectified : see `read_camera_info`
    image_size : width, height of the image that it is for, px; None: the calibration's own
    covariance : used instead of the file's, see `read_camera`; empty: the file's
    limits : `text_mb`

    Raises
    ------
    FileError
        If the file is missing or none of the formats.
    """
    description = read_description(path, limits)
    return read_camera(description, rectified=rectified, image_size=image_size, covariance=covariance)


def read_description(path: Path | str, limits: LimitsParameters = DEFAULT_LIMITS) -> CameraDescription:
    """Return what a calibration file says; FileError as `read_calibration`, or if `limits.text_mb` are exceeded."""
    return described_camera(_text(Path(path), limits), str(path), limits)[0]


def read_camera_name(path: Path | str, limits: LimitsParameters = DEFAULT_LIMITS) -> str:
    """Return the camera's name in a calibration file; empty when it has none. FileError as `read_description`."""
    return described_camera(_text(Path(path), limits), str(path), limits)[1]


def write_camera_info(path: Path | str, camera: Camera, name: str = "camera") -> None:
    """Write intrinsics as a camera_info YAML file that ROS's drivers and `read_camera_info` read; floats round-trip.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    write_text(Path(path), camera_info_text(camera, name))


def camera_info_text(camera: Camera, name: str = "camera") -> str:
    """Return the YAML text for a camera: rectification the identity, projection K (a single camera).

    Where the camera has a covariance it is `calibration_covariance`, of fx, fy, cx, cy and the distortion coefficients.
    """
    projection = np.hstack((camera.K, np.zeros((3, 1))))
    content = {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": name,
        "camera_matrix": _rows(camera.K),
        "distortion_model": message_name(camera.model),
        "distortion_coefficients": _rows(camera.distortion[None]),
        "rectification_matrix": _rows(np.eye(3)),
        "projection_matrix": _rows(projection),
    }
    if camera.covariance is not None:
        # ROS's reader looks up the names it knows and passes over this one.
        content["calibration_covariance"] = _rows(camera.covariance)
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120)


def _text(path: Path, limits: LimitsParameters) -> str:
    need = f"a calibration file of at most {limits.text_mb} MB (limits.text_mb)"
    content = file_bytes(path, need, 1_000_000 * limits.text_mb)
    try:
        return content.decode()
    except UnicodeDecodeError:
        raise FileError(f"{path}: no text; need a calibration file") from None


def _rows(matrix: Floats) -> dict[str, object]:
    rows, columns = matrix.shape
    return {"rows": rows, "cols": columns, "data": [float(value) for value in matrix.ravel()]}
