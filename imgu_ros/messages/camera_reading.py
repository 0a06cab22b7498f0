# SPDX-License-Identifier: Apache-2.0
"""Content of a camera_info message or a calibration file -> the camera that took an image, or why there is none.

Messages and files are brought into one form, `CameraDescription`, and read by one function.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from imgu_ros.errors import EncodingError, ShapeError
from imgu_ros.messages.distortion_names import Lens, listed, named_lens
from imgu_ros.messages.intrinsics_check import Verdict, check_intrinsics, focal_ratio_remark, tangential_remark
from imgu_ros.types import Floats, Matrix3
from imgu_ros.vision.camera.camera_covariance import as_covariance, with_covariance
from imgu_ros.vision.camera.distortion_model import DistortionModel
from imgu_ros.vision.camera.intrinsics import Camera, make_camera
from imgu_ros.vision.camera.projection import as_intrinsic_matrix

#: What should be 0 or 1 in K may be off by this, of a scale of 1: float32, products of matrices. Less than 0.01 px.
_ROUNDING = 1e-6
#: Of the image, the share in which the lens model must have an inverse; a circular fisheye covers less.
_INVERTIBLE, _INVERTIBLE_FISHEYE = 0.5, 0.05


@dataclass(frozen=True, slots=True)
class CameraDescription:
    """Description of a camera, unchecked.

    Attributes
    ----------
    source : what says it, for people: `camera_info`, or a file's path
    K, D, R, P : row by row; empty when they are not said
    model : name of the distortion model
    width, height : of the whole sensor at full resolution, px; 0 when they are not said
    binning : sensor pixels in one of the image's, along x and y
    roi : x, y, width and height of the window that is read, px of the sensor; width or height 0: to the edge
    covariance : of fx, fy, cx, cy and the numbers of D, row by row; empty: they are exact
    """

    source: str
    K: tuple[float, ...]
    D: tuple[float, ...]
    model: str
    width: int
    height: int
    R: tuple[float, ...] = ()
    P: tuple[float, ...] = ()
    binning: tuple[int, int] = (1, 1)
    roi: tuple[int, int, int, int] = (0, 0, 0, 0)
    covariance: tuple[float, ...] = ()

    @property
    def window(self) -> tuple[int, int, int, int]:
        """Return x, y, width and height of the part of the sensor that is read."""
        x, y, width, height = self.roi
        return x, y, width or self.width - x, height or self.height - y

    @property
    def image_size(self) -> tuple[int, int]:
        """Return width and height of the image: the window after binning."""
        _, _, width, height = self.window
        return width // max(1, self.binning[0]), height // max(1, self.binning[1])


@dataclass(frozen=True, slots=True, eq=False)
class CameraReading:
    """Result of reading a description.

    Attributes
    ----------
    camera : that took the image; None when what is said of it cannot be used
    reason : why there is no camera; empty when there is one
    remarks : what people should know of the camera that is used, one line each
    """

    camera: Camera | None
    reason: str = ""
    remarks: tuple[str, ...] = ()


@lru_cache(maxsize=32)  # hardly a camera says anything new with its next frame
def read_camera(
    description: CameraDescription,
    *,
    rectified: bool,
    image_size: tuple[int, int] | None = None,
    covariance: tuple[float, ...] = (),
) -> CameraReading:
    """Read the camera that took an image of `image_size`. An unusable description raises nothing.

    K and P are given for the whole sensor at full resolution; the image may be a window of it and combine
    `binning` sensor pixels into one. With pixel centres at integers, x_image = (x_sensor - x - (b - 1) / 2) / b.

    Parameters
    ----------
    description : what is said
    rectified : the image is rectified: P[:3, :3] and no distortion; else K and D
    image_size : width, height of the image that it belongs to, px; None: what window and binning make of the sensor
    covariance : of the described numbers, known from elsewhere, see `CameraDescription`; empty: what is described
    """
    try:
        if covariance:
            description = replace(description, covariance=covariance)
        return _read(description, rectified, image_size)
    except (EncodingError, ShapeError) as error:
        return CameraReading(None, f"{description.source}: {error}")


def _read(said: CameraDescription, rectified: bool, image_size: tuple[int, int] | None) -> CameraReading:
    used = "P" if rectified else "KD"
    broken = [name for name in "KDRP" if not np.isfinite(getattr(said, name)).all()]
    for name in broken:
        if name in used:
            raise EncodingError(f"{name} {listed(getattr(said, name))}; need finite numbers")
    name = "P[:3, :3]" if rectified else "K"
    try:
        matrix = _matrix(said, rectified)
    except EncodingError as error:
        raise EncodingError(f"{error}{_other_matrix(said, rectified)}") from None
    lens = Lens(DistortionModel.PLUMB_BOB, ()) if rectified else named_lens(said.model, said.D)
    size = image_size or _own_size(said)
    _check_sizes(said, matrix, size)
    verdict = _judged(said, matrix, lens.model)
    if verdict.problem:
        raise EncodingError(f"{name} {verdict.problem}{_other_matrix(said, rectified)}")
    camera = make_camera(_windowed(matrix, said), lens.coefficients, lens.model, *size)
    _require_lens(camera, said)
    if said.covariance:
        camera = with_covariance(camera, _covariance_in_image(said, matrix, rectified))
    # Many frames have this very object.
    camera.K.flags.writeable = camera.distortion.flags.writeable = False
    remarks = [*(f"{name} {remark}" for remark in verdict.remarks), lens.remark]
    remarks += tangential_remark(lens.model, lens.coefficients), _disagreement(said)
    remarks += [
        f"{name} {listed(getattr(said, name))} has numbers that are not finite; it is not used" for name in broken
    ]
    return CameraReading(camera, remarks=tuple(f"{said.source}: {remark}" for remark in remarks if remark))


def _matrix(said: CameraDescription, rectified: bool) -> Matrix3:
    """Return the matrix of the sensor that the images are seen by, (3, 3); EncodingError when it has not K's form."""
    values, shape = (said.P, (3, 4)) if rectified else (said.K, (3, 3))
    letter, name = ("P", "P[:3, :3]") if rectified else ("K", "K")
    if len(values) != shape[0] * shape[1]:
        raise EncodingError(f"{letter} has {len(values)} values; need {shape[0] * shape[1]}")
    matrix = np.reshape(values, shape)[:, :3]
    if not matrix[:2].any():  # some write the last 1 all the same
        raise EncodingError(f"{letter} is all zero: the camera is not calibrated")
    try:
        return as_intrinsic_matrix(_without_rounding(matrix), name)
    except ShapeError as error:
        raise EncodingError(str(error)) from None


def _without_rounding(matrix: Matrix3) -> Matrix3:
    """Return it with exact zeros and the exact 1 where it has them but for rounding."""
    scale = np.array((1.0, abs(matrix[1, 1]), 1.0))[:, None]
    exact = np.array(((0, 0, 0), (0, 0, 0), (0, 0, 1.0)))
    fixed = np.array(((0, 0, 0), (1, 0, 0), (1, 1, 1)), bool)
    return np.where(fixed & (np.abs(matrix - exact) <= _ROUNDING * scale), exact, matrix)


def _judged(said: CameraDescription, matrix: Matrix3, model: DistortionModel) -> Verdict:
    return check_intrinsics(matrix, model, (said.width, said.height), said.window, said.binning)


def _own_size(said: CameraDescription) -> tuple[int, int]:
    _, _, width, height = said.window
    return max(width, 0) // said.binning[0], max(height, 0) // said.binning[1]


def _check_sizes(said: CameraDescription, matrix: Matrix3, image_size: tuple[int, int]) -> None:
    x, y, width, height = said.window
    if said.width < 1 or said.height < 1:
        raise EncodingError(
            f"width and height are {said.width} x {said.height}: which resolution K is for is not said; need the size "
            f"of the sensor ({image_size[0]} x {image_size[1]} px when the image is all of it)"
            if min(image_size) > 0
            else f"width and height are {said.width} x {said.height}; need the size of the images"
        )
    if not (0 <= x < x + width <= said.width and 0 <= y < y + height <= said.height):
        raise EncodingError(
            f"roi {width} x {height} px at ({x}, {y}); need a window inside {said.width} x {said.height} px"
            f"{_window_readings(said, matrix)}"
        )
    # A window that is not a multiple of the binning may be rounded either way.
    fits = all(
        -bin_px < sensor - got * bin_px < bin_px
        for sensor, bin_px, got in zip((width, height), said.binning, image_size, strict=True)
    )
    if not fits:
        binned = f" binned {said.binning[0]} x {said.binning[1]}" if max(said.binning) > 1 else ""
        raise EncodingError(
            f"size {width} x {height} px{binned}, image {image_size[0]} x {image_size[1]} px; need the same size"
            f"{_window_readings(said, matrix) or _binned_readings(said, image_size)}"
        )


def _window_readings(said: CameraDescription, matrix: Matrix3) -> str:
    """Return both readings of a window that does not fit: width, height and K of the sensor, or of the window."""
    x, y = said.roi[:2]
    if not (x or y):
        return ""
    cx, cy = matrix[0, 2], matrix[1, 2]
    return (
        f"; K may be the sensor's (then the image's principal point is ({cx - x:g}, {cy - y:g})) or the window's "
        f"(then it is ({cx:g}, {cy:g})): need the sensor's width, height and K"
    )


def _binned_readings(said: CameraDescription, image_size: tuple[int, int]) -> str:
    if max(said.binning) == 1 or said.window[2:] != image_size:
        return ""
    return "; K may be the sensor's or the binned image's: need the sensor's width, height and K, or binning 0"


def _windowed(matrix: Matrix3, said: CameraDescription) -> Matrix3:
    (x, y, _, _), (bx, by) = said.window, said.binning
    image_from_sensor = np.diag((1 / bx, 1 / by, 1.0))
    image_from_sensor[:2, 2] = -(x + (bx - 1) / 2) / bx, -(y + (by - 1) / 2) / by
    return image_from_sensor @ matrix


def _covariance_in_image(said: CameraDescription, matrix: Matrix3, rectified: bool) -> Floats:
    """Return the covariance of the image's numbers, (P, P): binning scales K, a window moves it.

    Of rectified images those of D are left out: what D is not known to bends a rectified image in its own way.
    """
    covariance = as_covariance(said.covariance)
    if not rectified:
        scale = 1 / np.array(said.binning, np.float64)
    else:
        covariance = covariance[:4, :4]
        K = _matrix(said, rectified=False)
        scale = np.array((matrix[0, 0] / K[0, 0], matrix[1, 1] / K[1, 1])) / said.binning
    by_image = np.ones(len(covariance))
    by_image[:4] = np.tile(scale, 2)
    return np.asarray(covariance * np.outer(by_image, by_image), np.float64)


def _other_matrix(said: CameraDescription, rectified: bool) -> str:
    """Return a hint when the matrix that is not used can be a camera's."""
    if said.width < 1 or said.height < 1:
        return ""
    try:
        other = _matrix(said, not rectified)
    except EncodingError:
        return ""
    if _judged(said, other, DistortionModel.PLUMB_BOB).problem:
        return ""
    name, what, value = ("K", "not rectified", "false") if rectified else ("P", "rectified", "true")
    return f"; {name} has fx {other[0, 0]:g} px: if the images are {what}, set camera.rectified to {value}"


def _require_lens(camera: Camera, said: CameraDescription) -> None:
    """Raise unless the lens model can be inverted over most of the image."""
    if not camera.is_distorted:
        return
    x, y = np.meshgrid(np.linspace(0, camera.width - 1, 15), np.linspace(0, camera.height - 1, 11))
    share = float(camera.undistort(np.column_stack((x.ravel(), y.ravel())))[1].mean())
    fisheye = camera.model is DistortionModel.EQUIDISTANT
    if share < (_INVERTIBLE_FISHEYE if fisheye else _INVERTIBLE):
        raise EncodingError(
            f"D {listed(said.D)} folds the image over {100 * (1 - share):.0f} % of its area; need those of "
            f"a lens, in the order of {camera.model}"
        )


def _disagreement(said: CameraDescription) -> str:
    try:
        K, P, lens = _matrix(said, False), _matrix(said, True), named_lens(said.model, said.D)
    except EncodingError:
        return ""  # one of them is not there, or of a lens of which nothing is known
    return focal_ratio_remark(K, P, lens.model, bool(lens.coefficients) or lens.model is DistortionModel.EQUIDISTANT)
