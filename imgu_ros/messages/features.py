# SPDX-License-Identifier: Apache-2.0
"""Keypoints, matches and homographies <-> sensor_msgs/PointCloud2.

Columns are aligned to their size, so that a reader in C may take pointers to them; the padding is zero.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imgu_ros.errors import EncodingError
from imgu_ros.messages.factory import MessageFactory
from imgu_ros.messages.header import Header
from imgu_ros.messages.point_cloud import Table, decode_point_cloud, point_cloud_message
from imgu_ros.result import ReferenceMatches, ReferenceResult
from imgu_ros.types import Image
from imgu_ros.vision.keypoints.keypoints import Keypoints
from imgu_ros.vision.matching.matches import Matches
from imgu_ros.vision.projective.homography import HomographyEstimate

_KEYPOINT = (("x", "f4"), ("y", "f4"), ("scale", "f4"), ("angle", "f4"), ("response", "f4"), ("octave", "i4"))

MATCH_DTYPE = np.dtype(
    [
        ("target", "i4"),
        ("template_x", "f4"),
        ("template_y", "f4"),
        ("image_x", "f4"),
        ("image_y", "f4"),
        ("distance", "f4"),
        ("inlier", "u1"),
    ],
    align=True,
)

_MATCH_NUMBERS = ("template_x", "template_y", "image_x", "image_y", "distance")

HOMOGRAPHY_DTYPE = np.dtype(
    [
        ("target", "i4"),
        ("h", "f8", (9,)),
        ("covariance", "f8", (81,)),
        ("n_inliers", "i4"),
        ("rms_px", "f4"),
        ("calibrated", "u1"),
        ("sharp", "u1"),
    ],
    align=True,
)
#: Columns without which a table is none of homographies.
_HOMOGRAPHY_NEEDS = ("target", "h", "covariance", "n_inliers", "rms_px")


def keypoints_message(make: MessageFactory, header: Header, keypoints: Keypoints, descriptors: Image | None) -> Any:
    """Return keypoints as a PointCloud2.

    Columns: x y scale angle response (float32), octave (int32), and with descriptors one column `descriptor` of as
    many uint8 or float32 as they are long.

    Parameters
    ----------
    descriptors : (N, D) uint8 or float32, in the keypoints' order; None: no such column

    Raises
    ------
    EncodingError
        If there is not one descriptor for each keypoint.
    """
    columns: list[Any] = list(_KEYPOINT)
    if descriptors is not None:
        if descriptors.ndim != 2 or len(descriptors) != len(keypoints) or not descriptors.shape[1]:
            raise EncodingError(f"descriptors: shape {descriptors.shape}; need ({len(keypoints)}, D >= 1)")
        columns.append(("descriptor", descriptors.dtype.newbyteorder("="), (descriptors.shape[1],)))
    table = np.zeros(len(keypoints), np.dtype(columns, align=True))
    table["x"], table["y"] = keypoints.xy.T
    for name in ("scale", "angle", "response", "octave"):
        table[name] = getattr(keypoints, name)
    if descriptors is not None:
        table["descriptor"] = descriptors
    return point_cloud_message(make, header, table)


def decode_keypoints(message: Any) -> tuple[Keypoints, Image | None]:
    """Read a message of `keypoints_message`: the keypoints, and the (N, D) descriptors or None when there are none.

    Raises
    ------
    EncodingError
        If a column is missing, or the message is not a readable PointCloud2.
    """
    table = decode_point_cloud(message)
    _require(table, [name for name, _ in _KEYPOINT])
    columns = {name: table[name].astype(np.float64) for name, _ in _KEYPOINT}
    xy = np.column_stack((columns["x"], columns["y"]))
    keypoints = Keypoints(xy, columns["scale"], columns["angle"], columns["response"], table["octave"].astype(np.int32))
    descriptors = None
    if "descriptor" in (table.dtype.names or ()):
        column = table["descriptor"]
        descriptors = np.ascontiguousarray(column if column.ndim == 2 else column[:, None])
    return keypoints, descriptors


def matches_message(make: MessageFactory, header: Header, results: Iterable[ReferenceResult]) -> Any:
    """Return the matches of every target as one PointCloud2 with the columns of `MATCH_DTYPE`, best first."""
    tables = [np.zeros(0, MATCH_DTYPE)]
    for target in results:
        if target.matches is None:
            continue
        table = np.zeros(len(target.matches.matches), MATCH_DTYPE)
        table["target"] = target.number
        table["template_x"], table["template_y"] = target.matches.template_xy.T
        table["image_x"], table["image_y"] = target.matches.image_xy.T
        table["distance"] = target.matches.matches.distance
        table["inlier"] = target.matches.inliers
        tables.append(table)
    return point_cloud_message(make, header, np.concatenate(tables))


def decode_matches(message: Any) -> Table:
    """Read a message of `matches_message`, a table with the columns of `MATCH_DTYPE`."""
    table = decode_point_cloud(message)
    _require(table, MATCH_DTYPE.names or ())
    return table


def decode_target_matches(message: Any) -> dict[int, ReferenceMatches]:
    """Read a message of `matches_message`: the matches of each target, in the order in which targets appear first.

    They name no keypoints: `index_src` and `index_dst` are -1.

    Raises
    ------
    EncodingError
        If a column is missing, a coordinate is not finite, or the message is not a readable PointCloud2.
    """
    table = decode_matches(message)
    numbers, first = np.unique(_column(table, "target"), return_index=True)
    return {int(number): _target_matches(table[table["target"] == number]) for number in numbers[np.argsort(first)]}


def homographies_message(
    make: MessageFactory, header: Header, results: Iterable[ReferenceResult], *, calibrated: bool
) -> Any:
    """Return the homographies as one PointCloud2 with the columns of `HOMOGRAPHY_DTYPE`: a row for each target seen.

    Parameters
    ----------
    calibrated : whether the frame has a camera, so that H leads to the ideal pixels of its lens
    """
    seen = [target for target in results if target.homography is not None]
    table = np.zeros(len(seen), HOMOGRAPHY_DTYPE)
    for row, target in zip(table, seen, strict=True):
        estimate = target.homography
        assert estimate is not None
        row["target"] = target.number
        row["h"] = estimate.H.ravel()
        row["covariance"] = estimate.covariance.ravel()
        row["n_inliers"] = np.count_nonzero(estimate.inliers)
        row["rms_px"] = estimate.rms_px
        row["calibrated"] = calibrated
        row["sharp"] = target.is_sharp
    return point_cloud_message(make, header, table)


def decode_homographies(message: Any) -> Table:
    """Read a message of `homographies_message`, a table with the columns of `HOMOGRAPHY_DTYPE`.

    `calibrated` and `sharp` may be missing.
    """
    table = decode_point_cloud(message)
    _require(table, _HOMOGRAPHY_NEEDS)
    return table


def decode_calibrated(message: Any) -> bool:
    """Return whether the homographies are those of a calibrated camera, by a message of `homographies_message`."""
    table = decode_homographies(message)
    return "calibrated" not in (table.dtype.names or ()) or bool(np.all(table["calibrated"]))


def decode_sharp(message: Any) -> set[int]:
    """Return the targets whose points were measured at full resolution, by a message of `homographies_message`."""
    table = decode_homographies(message)
    if "sharp" not in (table.dtype.names or ()):
        return set()
    return {int(index) for index in table["target"][_column(table, "sharp") != 0]}


def decode_estimates(message: Any, inliers: Mapping[int, int]) -> dict[int, HomographyEstimate]:
    """Read a message of `homographies_message`: the homography of each target, of points that all agree.

    Parameters
    ----------
    message : sensor_msgs/PointCloud2
    inliers : number of points of each target; targets without are left out

    Raises
    ------
    EncodingError
        If a column is missing or has another length, a number is not finite, a matrix is singular, or the message is
        not a readable PointCloud2.
    """
    table = decode_homographies(message)
    found = {}
    for row in table:
        index = int(row["target"])
        H, covariance = np.ravel(row["h"]), np.ravel(row["covariance"])
        if H.size != 9 or covariance.size != 81 or not (np.isfinite(H).all() and np.isfinite(covariance).all()):
            raise EncodingError(
                f"homography of target {index}: {H.size} + {covariance.size} values; need 9 + 81, finite"
            )
        matrix = np.array(H, np.float64).reshape(3, 3)
        if not np.linalg.det(matrix) > 0 or not float(row["rms_px"]) >= 0:
            raise EncodingError(
                f"homography of target {index}: determinant {np.linalg.det(matrix):g}, rms_px {row['rms_px']:g}; "
                "need > 0 and >= 0"
            )
        if index in inliers:
            agreeing = np.ones(inliers[index], bool)
            spread = np.array(covariance, np.float64).reshape(9, 9)
            found[index] = HomographyEstimate(matrix, spread, agreeing, float(row["rms_px"]), 0)
    return found


def _target_matches(table: Table) -> ReferenceMatches:
    none = np.full(len(table), -1, np.intp)
    columns = {name: _column(table, name).astype(np.float64) for name in _MATCH_NUMBERS}
    if not all(np.isfinite(column).all() for column in columns.values()):
        raise EncodingError("matches: a coordinate or distance is not finite; need finite numbers")
    return ReferenceMatches(
        Matches(none, none, columns["distance"]),
        np.column_stack((columns["template_x"], columns["template_y"])),
        np.column_stack((columns["image_x"], columns["image_y"])),
        _column(table, "inlier") != 0,
    )


def _column(table: Table, name: str) -> NDArray[Any]:
    """Return a column of single numbers."""
    column = table[name]
    if column.ndim != 1:
        raise EncodingError(f"point cloud: field {name}, {column.shape[1:]} values; need one")
    return column


def _require(table: Table, names: Sequence[str]) -> None:
    missing = [name for name in names if name not in (table.dtype.names or ())]
    if missing:
        raise EncodingError(f"point cloud: fields {', '.join(table.dtype.names or ())}; need {', '.join(missing)} too")
