# SPDX-License-Identifier: Apache-2.0
"""The exact answer to a sequence, its file, and how far an estimate is from it."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import FileError, ShapeError
from imgu_ros.file_access.bounded_reading import file_lines
from imgu_ros.file_access.text_files import write_text
from imgu_ros.files.frames_csv import H_COLUMNS, Q_COLUMNS, T_COLUMNS
from imgu_ros.shown_text import as_cell, cell_text
from imgu_ros.types import Floats, Mask, Matrix3, Points, as_matrix
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.rigid import RigidTransform, rigid_transform
from imgu_ros.vision.camera.rotation import log_so3

_POSE_COLUMNS = (*T_COLUMNS, *Q_COLUMNS)
COLUMNS = ("stamp_ns", "target", *H_COLUMNS, *_POSE_COLUMNS)

#: Median and 95 % point of `normalised_squared_error` when the covariance is right: chi-squared, 6 degrees of freedom.
NEES_MEDIAN, NEES_95 = 5.35, 12.59

_GRID = 9
_MOST_ROWS = 1_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """One target in one frame.

    Attributes
    ----------
    stamp_ns : the frame's stamp
    target : its name
    H : (3, 3) H_image_template in ideal (undistorted) pixels, unit Frobenius norm, w > 0 at the target's centre
    pose : camera_from_target; None when only H is known
    """

    stamp_ns: int
    target: str
    H: Matrix3
    pose: RigidTransform | None


def write_truth(path: Path, truths: Iterable[Truth]) -> None:
    """Write `truth.csv`: numbers round-trip, quaternions have w >= 0.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for truth in truths:
        numbers = [repr(float(x)) for x in truth.H.ravel()]
        pose = [""] * 7 if truth.pose is None else [repr(float(x)) for x in truth.pose.numbers()]
        writer.writerow([truth.stamp_ns, as_cell(truth.target), *numbers, *pose])
    write_text(path, text.getvalue())


def read_truth(path: Path) -> tuple[Truth, ...]:
    """Read a truth file; further columns (as in frames.csv) are ignored, and so are rows without H.

    Raises
    ------
    FileError
        If it cannot be read, lacks a column, or holds something that is not a number.
    """
    try:
        reader = csv.DictReader(file_lines(path, "a readable truth file"))
        missing = [c for c in COLUMNS if c not in (reader.fieldnames or ())]
        if missing:
            raise FileError(f"{path}: no column {missing[0]}; need {', '.join(COLUMNS)}")
        rows = tuple(_truth(row, f"{path}:{reader.line_num}") for row in islice(reader, _MOST_ROWS) if row["h11"])
        if next(reader, None) is not None:
            raise FileError(f"{path}: more than {_MOST_ROWS} rows; need fewer")
        return rows
    except csv.Error as error:
        raise FileError(f"{path}: {error}; need a CSV file") from None


def corner_error(
    H_estimate: ArrayLike,
    H_truth: ArrayLike,
    template_size: tuple[int, int],
    image_size: tuple[int, int],
    camera: Camera | None = None,
) -> float:
    """Return how far an estimated homography is from the true one, px.

    The mean over the four outer corners of the distance between the estimate's and the truth's projection; when the
    truth puts a corner outside the image, the mean over those points of a 9x9 grid on the target that fall inside.

    Parameters
    ----------
    H_estimate, H_truth : (3, 3) H_image_template, w > 0 at the target's centre
    template_size : width, height of the template, px
    image_size : width, height of the image, px
    camera : only for a distorted one, whose homographies are in ideal pixels: decides what falls inside its raw image

    Returns
    -------
    px; infinity when the estimate puts one of the points on or behind the horizon

    Raises
    ------
    ShapeError
        If a matrix is not (3, 3), or no point of the target is inside the image.
    """
    H_estimate, H_truth = as_matrix(H_estimate, (3, 3), "H_estimate"), as_matrix(H_truth, (3, 3), "H_truth")
    points = target_grid(template_size, 2)
    if not points_in_image(H_truth, points, image_size, camera).all():
        points = target_grid(template_size, _GRID)
        points = points[points_in_image(H_truth, points, image_size, camera)]
        if not len(points):
            raise ShapeError(
                f"target: no point inside the {image_size[0]} x {image_size[1]} image; need a visible target"
            )
    estimated, truth = _project(H_estimate, points), _project(H_truth, points)
    if not (estimated[:, 2] > 0).all():
        return math.inf
    difference = estimated[:, :2] / estimated[:, 2:] - truth[:, :2] / truth[:, 2:]
    return float(np.hypot(difference[:, 0], difference[:, 1]).mean())


def target_grid(template_size: tuple[int, int], count: int) -> Points:
    """Return count x count points, (N, 2) template px, evenly spread over the target from outer edge to outer edge."""
    width, height = template_size
    x, y = np.meshgrid(np.linspace(-0.5, width - 0.5, count), np.linspace(-0.5, height - 0.5, count))
    return np.column_stack((x.ravel(), y.ravel()))


def points_in_image(H: Matrix3, points: Points, image_size: tuple[int, int], camera: Camera | None = None) -> Mask:
    """Return which template points, (N, 2), the raw image shows: (N,) bool."""
    projected = _project(H, points)
    inside = projected[:, 2] > 0
    xy = projected[inside, :2] / projected[inside, 2:]
    limit = np.array(image_size, dtype=np.float64) - 0.5
    shown = ((xy >= -0.5) & (xy <= limit)).all(axis=1)
    if camera is not None and camera.is_distorted:
        raw = camera.raw_pixels(xy)
        shown = ((raw >= -0.5) & (raw <= limit)).all(axis=1)
        # Far outside, a polynomial lens may fold a point back into the image: the inverse then leads elsewhere.
        back, valid = camera.ideal_pixels(raw)
        shown &= valid & (np.abs(back - xy).max(axis=1, initial=0.0) < 1e-3)
    inside[inside] = shown
    return inside


def _project(H: Matrix3, points: Points) -> Floats:
    projected: Floats = np.column_stack((points, np.ones(len(points)))) @ H.T
    return projected


def _truth(row: dict[str, str], where: str) -> Truth:
    try:
        H = as_matrix(np.reshape([float(row[c]) for c in H_COLUMNS], (3, 3)), (3, 3), "H")
        known = all(row[c] for c in _POSE_COLUMNS)
        pose = rigid_transform([float(row[c]) for c in _POSE_COLUMNS], "pose") if known else None
        return Truth(int(row["stamp_ns"]), cell_text(row["target"]), H, pose)
    except ShapeError as error:
        raise FileError(f"{where}: {error}") from None
    except (TypeError, ValueError) as error:
        raise FileError(f"{where}: {error}; need finite numbers") from None


def normalised_squared_error(truth: RigidTransform, estimate: RigidTransform, covariance: Floats) -> float | None:
    """Return the squared error of a pose in units of its covariance (normalised estimation error squared, NEES).

    Of poses whose covariance is right its mean is 6, its median `NEES_MEDIAN`, and 95 % lie below `NEES_95`
    (Bar-Shalom, Li & Kirubarajan 2001, section 5.4.2).

    Parameters
    ----------
    truth, estimate : of the same frames
    covariance : (6, 6), x y z rx ry rz; R_true = Exp(delta) R_est

    Returns
    -------
    None when the covariance is singular.
    """
    delta = np.concatenate((truth.t - estimate.t, log_so3(truth.R @ estimate.R.T)))
    try:
        return float(delta @ np.linalg.solve(covariance, delta))
    except np.linalg.LinAlgError:
        return None
