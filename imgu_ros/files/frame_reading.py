# SPDX-License-Identifier: Apache-2.0
"""How frames are read, as `camera.*` and `raw.encoding` say."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from imgu_ros.config.components import ReadingParameters
from imgu_ros.config.parameters import DEFAULT_LIMITS, LimitsParameters
from imgu_ros.errors import FileError, ParameterError, nearest_name
from imgu_ros.files.camera_info_file import read_description
from imgu_ros.files.target_images import expanded_path
from imgu_ros.frame import Frame
from imgu_ros.messages.camera_reading import CameraDescription, CameraReading, read_camera
from imgu_ros.messages.encodings import encoding_names, is_image_encoding
from imgu_ros.messages.frame import decode_frame, read_camera_info


@dataclass(frozen=True, slots=True)
class FrameReading:
    """How frames are read.

    Attributes
    ----------
    info_file : the parameter `camera.info_file`
    rectified : images are rectified
    encoding : what pixels are; empty: what messages say
    covariance : of the camera's numbers, row by row; empty: what is said with them
    limits : what decoding a picture may cost
    file_camera : what `camera.info_file` says; None: camera_info counts
    """

    info_file: str = ""
    rectified: bool = False
    encoding: str = ""
    covariance: tuple[float, ...] = ()
    limits: LimitsParameters = DEFAULT_LIMITS
    file_camera: CameraDescription | None = None

    def frame(self, image_message: Any, camera_info_message: Any | None) -> Frame:
        """Return an image message with its camera; EncodingError as `decode_frame`."""
        camera_info = camera_info_message if self.file_camera is None else self.file_camera
        return decode_frame(
            image_message,
            camera_info,
            rectified=self.rectified,
            encoding=self.encoding,
            covariance=self.covariance,
            limits=self.limits,
        )

    def camera(self, camera_info_message: Any | None, image_size: tuple[int, int] | None) -> CameraReading:
        """Return the camera of an image that others have seen; None as its size: that which the camera is for."""
        camera_info = camera_info_message if self.file_camera is None else self.file_camera
        if camera_info is None:
            return CameraReading(None)
        return read_camera_info(
            camera_info, rectified=self.rectified, image_size=image_size, covariance=self.covariance
        )


def frame_reading(parameters: ReadingParameters, before: FrameReading | None = None) -> FrameReading:
    """Read what the parameters say of frames, and check it before there are any.

    Parameters
    ----------
    parameters : those of reading
    before : no file is read when `camera.info_file` is still the same; returned when the parameters still say the same

    Raises
    ------
    FileError
        If `camera.info_file` is missing or cannot be read, or no camera can be as it says.
    ParameterError
        If `raw.encoding` is unknown.
    """
    wanted = as_read(parameters)
    if before is not None and wanted == replace(before, file_camera=None):
        return before
    check_encoding(wanted.encoding)
    if not wanted.info_file:
        return wanted
    if before is not None and before.file_camera is not None and before.info_file == wanted.info_file:
        description = before.file_camera
    else:
        description = _described(wanted.info_file, parameters.limits)
    alone = read_camera(description, rectified=wanted.rectified, image_size=None, covariance=wanted.covariance)
    if alone.camera is None:
        raise FileError(f"camera.info_file: {alone.reason}")
    return replace(wanted, file_camera=description)


def check_change(parameters: ReadingParameters, before: ReadingParameters) -> None:
    """Raise what `frame_reading` would; other encodings and limits have nothing to do with the camera's file."""
    wanted, was = as_read(parameters), as_read(before)
    if wanted == replace(was, encoding=wanted.encoding, limits=wanted.limits):
        check_encoding(wanted.encoding)
    else:
        frame_reading(parameters)


def as_read(parameters: ReadingParameters) -> FrameReading:
    """Return what the parameters say of frames, without the file's content."""
    camera = parameters.camera
    return FrameReading(
        camera.info_file, camera.rectified, parameters.raw.encoding, camera.covariance, parameters.limits
    )


def check_encoding(name: str) -> None:
    """Raise ParameterError, with all known names, unless `raw.encoding` is empty or the name of an encoding."""
    if name and not is_image_encoding(name):
        near = nearest_name(name, encoding_names())
        nearest = f" (nearest: {near})" if near else ""
        raise ParameterError(
            f"raw.encoding: {name[:40]!r} is unknown{nearest}; need one of {', '.join(encoding_names())}"
        )


def _described(info_file: str, limits: LimitsParameters) -> CameraDescription:
    try:
        return read_description(expanded_path(info_file), limits)
    except FileError as error:
        raise FileError(f"camera.info_file: {error}") from None
