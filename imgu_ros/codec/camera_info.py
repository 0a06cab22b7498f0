"""sensor_msgs/CameraInfo <-> Camera."""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from imgu_ros.codec.factory import MessageFactory
from imgu_ros.codec.header import Header, header_message
from imgu_ros.errors import EncodingError, ShapeError
from imgu_ros.types import Floats, Matrix3
from imgu_ros.vision.camera.intrinsics import COEFFICIENTS, Camera, DistortionModel, make_camera


def decode_camera_info(message: Any, *, rectified: bool, image_size: tuple[int, int]) -> Camera | None:
    """Read the camera that took an image of `image_size`.

    K and P are given for the whole sensor at full resolution; the image may be a window of it (`roi`, in
    full-resolution pixels; width or height 0: to the edge) and combine `binning_x` x `binning_y` sensor pixels into one
    (0 means 1). With pixel centres at integers, x_image = (x_sensor - roi.x_offset - (b - 1) / 2) / b. `roi.do_rectify`
    changes nothing: ROS's rectification uses the same window for the raw and for the rectified image.

    Parameters
    ----------
    message : sensor_msgs/CameraInfo
    rectified : the image is rectified: P[:3, :3] and no distortion; else K and D
    image_size : width, height of the image that it came with, px

    Returns
    -------
    None when the matrix is all zero, which is how ROS says that a camera is not calibrated.

    Raises
    ------
    EncodingError
        If a number is not finite, a focal length is not positive, the distortion model is unknown or has too many
        coefficients, or the sizes disagree.
    """
    matrix = _numbers(message, "p", (3, 4))[:, :3] if rectified else _numbers(message, "k", (3, 3))
    if not matrix.any():
        return None
    window = _window(message)
    binning = (max(1, int(message.binning_x)), max(1, int(message.binning_y)))
    _check_size(window, binning, image_size)
    lens = _Lens(DistortionModel.PLUMB_BOB, ()) if rectified else _lens(message)
    return _camera(_Said(tuple(matrix.ravel().tolist()), rectified, lens, window, binning, image_size))


def camera_info_message(make: MessageFactory, header: Header, camera: Camera) -> Any:
    """Return the sensor_msgs/CameraInfo of a camera: K, D, R = identity, P = [K | 0], no binning, no window."""
    return make(
        "sensor_msgs/msg/CameraInfo",
        header=header_message(make, header),
        height=camera.height,
        width=camera.width,
        distortion_model=str(camera.model),
        d=np.array(camera.distortion, np.float64),
        k=np.array(camera.K, np.float64).reshape(9),
        r=np.eye(3).reshape(9),
        p=np.column_stack((camera.K, np.zeros(3))).reshape(12),
        binning_x=0,
        binning_y=0,
        roi=make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False),
    )


@dataclass(frozen=True, slots=True)
class _Window:
    """The part of the sensor that was read, full-resolution px."""

    x: int
    y: int
    width: int
    height: int


@dataclass(frozen=True, slots=True)
class _Lens:
    model: DistortionModel
    coefficients: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class _Said:
    """All that a message tells of the camera; `matrix` row by row."""

    matrix: tuple[float, ...]
    rectified: bool
    lens: _Lens
    window: _Window
    binning: tuple[int, int]
    image_size: tuple[int, int]


@lru_cache(maxsize=32)  # hardly a camera says anything new with its next frame
def _camera(said: _Said) -> Camera:
    matrix, lens = np.reshape(said.matrix, (3, 3)), said.lens
    coefficients = np.array(lens.coefficients, np.float64)
    try:
        # The sensor's matrix is checked before it is changed, so that the message shows what was sent.
        make_camera(matrix, coefficients, lens.model, *said.image_size)
        camera = make_camera(_windowed(matrix, said.window, said.binning), coefficients, lens.model, *said.image_size)
    except ShapeError as error:
        name = "P[:3, :3]" if said.rectified else "K"
        raise EncodingError(f"camera_info: {str(error).replace('K:', f'{name}:', 1)}") from None
    # Many frames have this very object.
    camera.K.flags.writeable = camera.distortion.flags.writeable = False
    return camera


def _numbers(message: Any, name: str, shape: tuple[int, ...] | None = None) -> Floats:
    """Read a field by its ROS 2 name; ROS 1 writes it in capitals."""
    values = getattr(message, name) if hasattr(message, name) else getattr(message, name.upper())
    try:
        array = np.array(values, dtype=np.float64)
        array = array.ravel() if shape is None else array.reshape(shape)
    except (TypeError, ValueError):
        raise EncodingError(f"camera_info: {name.upper()} has {np.size(values)} values; need {shape} numbers") from None
    if not np.isfinite(array).all():
        raise EncodingError(f"camera_info: {name.upper()} {array.ravel().tolist()}; need finite numbers")
    return array


def _window(message: Any) -> _Window:
    width, height, roi = int(message.width), int(message.height), message.roi
    x, y = int(roi.x_offset), int(roi.y_offset)
    window = _Window(x, y, int(roi.width) or width - x, int(roi.height) or height - y)
    inside = 0 <= x < x + window.width <= width and 0 <= y < y + window.height <= height
    # A camera_info without a size and without a window is reported as a size mismatch, which says more.
    if not inside and (x or y or int(roi.width) or int(roi.height)):
        raise EncodingError(
            f"camera_info: roi {window.width} x {window.height} px at ({x}, {y}); "
            f"need a window inside {width} x {height}"
        )
    return window


def _check_size(window: _Window, binning: tuple[int, int], image_size: tuple[int, int]) -> None:
    # A window that is not a multiple of the binning may be rounded either way.
    for sensor, bin_px, got in zip((window.width, window.height), binning, image_size, strict=True):
        if not -bin_px < sensor - got * bin_px < bin_px:
            extra = f" binned {binning[0]} x {binning[1]}" if max(binning) > 1 else ""
            raise EncodingError(
                f"camera_info: size {window.width} x {window.height} px{extra}, "
                f"image {image_size[0]} x {image_size[1]} px; need the same size"
            )


def _windowed(matrix: Matrix3, window: _Window, binning: tuple[int, int]) -> Matrix3:
    bx, by = binning
    image_from_sensor = np.array(
        [
            [1 / bx, 0, -(window.x + (bx - 1) / 2) / bx],
            [0, 1 / by, -(window.y + (by - 1) / 2) / by],
            [0, 0, 1],
        ]
    )
    return image_from_sensor @ matrix


def _lens(message: Any) -> _Lens:
    name = str(message.distortion_model)
    # Zeros at the end of D change nothing in any model: drivers pad D to a fixed length.
    given = _numbers(message, "d").tolist()
    while given and given[-1] == 0:
        given.pop()
    if name in ("", "none") and not len(given):
        return _Lens(DistortionModel.PLUMB_BOB, ())
    if name not in list(DistortionModel):
        nearest = difflib.get_close_matches(name[:40], list(DistortionModel), n=1, cutoff=0.0)[0]
        raise EncodingError(f"camera_info: distortion_model {name[:40]!r} is unknown; nearest known: '{nearest}'")
    model = DistortionModel(name)
    # Some drivers send all eight coefficients under the older name; the first five mean the same in both models.
    if model is DistortionModel.PLUMB_BOB and len(given) > COEFFICIENTS[model]:
        model = DistortionModel.RATIONAL_POLYNOMIAL
    return _Lens(model, tuple(given))
