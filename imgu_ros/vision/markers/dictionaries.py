# SPDX-License-Identifier: Apache-2.0
"""Families of fiducial markers: AprilTag's (Olson 2011; Wang & Olson 2016) and ArUco's (Garrido-Jurado et al. 2014).

The codes are those of OpenCV's aruco module, which Debian's and Ubuntu's OpenCV has, and the pip packages from 4.7 on
(before that `opencv-contrib-python`). Its interface changed in 4.7; both are used here.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from imgu_ros.arguments import as_integer, require_type
from imgu_ros.errors import ShapeError, nearest_name
from imgu_ros.types import Mask, as_plain

_SIZES = (4, 5, 6, 7)
_COUNTS = (50, 100, 250, 1000)
#: Names of families, and of the dictionaries of OpenCV's aruco module.
MARKER_FAMILIES: dict[str, str] = {
    "tag16h5": "DICT_APRILTAG_16h5",
    "tag25h9": "DICT_APRILTAG_25h9",
    "tag36h10": "DICT_APRILTAG_36h10",
    "tag36h11": "DICT_APRILTAG_36h11",
    **{f"aruco_{n}x{n}_{count}": f"DICT_{n}X{n}_{count}" for n in _SIZES for count in _COUNTS},
    "aruco_original": "DICT_ARUCO_ORIGINAL",
    "aruco_mip_36h12": "DICT_ARUCO_MIP_36h12",
}
#: Cells of the black border.
BORDER = 1


def require_marker_family(family: str) -> None:
    """Raise unless markers of a family can be found.

    Raises
    ------
    ShapeError
        If there is no such family, OpenCV has no aruco module, or that module lacks the family.
    """
    require_type(family, str, "family")
    marker_dictionary(family)


def marker_count(family: str) -> int:
    """Return the number of markers of a family; ids are 0 to one less. Errors as `require_marker_family`."""
    require_marker_family(family)
    return len(marker_dictionary(family).bytesList)


def nearest_marker(family: str, number: int, cells: Mask) -> int:
    """Return in how many cells what was read differs from the nearest marker of a family that is not `number`, upright.

    Parameters
    ----------
    family, number : of a marker
    cells : (n, n) inner cells, bool, turned as `marker_cells` has the marker

    Raises
    ------
    ShapeError
        If there is no such marker, or the cells are not as many bools.
    """
    require_marker_family(family)
    number, codes = as_integer(number, "number"), marker_codes(family)
    if not 0 <= number < len(codes):
        raise ShapeError(f"number: {number}; need 0 to {len(codes) - 1}")
    cells = as_plain(cells, "cells")
    if cells.dtype != np.bool_ or cells.shape != codes.shape[1:]:
        raise ShapeError(f"cells: shape {cells.shape}, data type {cells.dtype}; need {codes.shape[1:]} bool")
    least = cells.size
    for turn in range(4):
        differing = np.count_nonzero(codes ^ np.rot90(cells, turn), axis=(1, 2))
        if turn == 0:
            differing[number] = cells.size
        least = min(least, int(differing.min()))
    return least


@lru_cache(maxsize=1024)
def marker_distance(family: str, number: int) -> int:
    """Return in how many cells a marker differs from the nearest of its family, itself turned included.

    0: it cannot be told from another one, or how it is turned, as of some of `aruco_original`.
    """
    return nearest_marker(family, number, marker_cells(family, number)[BORDER:-BORDER, BORDER:-BORDER])


@lru_cache(maxsize=1024)
def marker_cells(family: str, number: int) -> Mask:
    """Return which cells of a marker are white: (N, N) with the black border, as it is printed upright.

    Upright is for ArUco's as OpenCV draws them, for AprilTag's as the AprilTag library does: half a turn apart.

    Parameters
    ----------
    family : a key of `MARKER_FAMILIES`
    number : the id

    Raises
    ------
    ShapeError
        If the family is unknown, or has no such id.
    """
    dictionary, count = marker_dictionary(family), marker_count(family)
    if not 0 <= number < count:
        raise ShapeError(f"{family}:{number}: no such id; need 0 to {count - 1}")
    side = int(dictionary.markerSize) + 2 * BORDER
    aruco: Any = cv2.aruco
    draw = aruco.generateImageMarker if has_new_interface() else aruco.drawMarker
    cells: Mask = np.asarray(draw(dictionary, number, side), np.uint8) > 127
    if is_turned(family):
        cells = cells[::-1, ::-1]
    cells = np.ascontiguousarray(cells)
    cells.flags.writeable = False
    return cells


@lru_cache(maxsize=64)
def marker_codes(family: str) -> NDArray[np.bool_]:
    """Return the inner cells of all markers of a family, upright, (count, N, N)."""
    codes = np.stack([marker_cells(family, number) for number in range(marker_count(family))])
    codes = np.ascontiguousarray(codes[:, BORDER:-BORDER, BORDER:-BORDER])
    codes.flags.writeable = False
    return codes


def has_new_interface() -> bool:
    """Whether the aruco module has the interface of OpenCV 4.7 and later."""
    return hasattr(getattr(cv2, "aruco", None), "ArucoDetector")


def is_turned(family: str) -> bool:
    """Whether OpenCV draws a family upside down."""
    require_type(family, str, "family")
    return family.startswith("tag")


@lru_cache(maxsize=64)
def marker_dictionary(family: str) -> Any:
    """Return the aruco module's dictionary of a family; errors as `require_marker_family`."""
    if family not in MARKER_FAMILIES:
        near = nearest_name(family, MARKER_FAMILIES)
        hint = f"did you mean {near}?" if near else f"need one of {', '.join(MARKER_FAMILIES)}"
        raise ShapeError(f"{family}: no family of markers; {hint}")
    if not hasattr(cv2, "aruco"):
        raise ShapeError(
            f"{family}: this OpenCV ({cv2.__version__}) has no aruco module; need opencv-python-headless 4.7 or newer, "
            "opencv-contrib-python-headless, or Ubuntu's python3-opencv"
        )
    name = MARKER_FAMILIES[family]
    number = getattr(cv2.aruco, name, None)
    if number is None:
        number = getattr(cv2.aruco, name.replace("h", "H"), None)
    if number is None:
        raise ShapeError(
            f"{family}: the aruco module of this OpenCV ({cv2.__version__}) lacks {name}; need a newer one"
        )
    aruco: Any = cv2.aruco
    return aruco.getPredefinedDictionary(number) if has_new_interface() else aruco.Dictionary_get(number)
