# SPDX-License-Identifier: Apache-2.0
"""Fiducial markers: the dictionaries of OpenCV's aruco module, and finding them in an image; calibration boards.

`MarkerFinder` finds the markers of one family, `zooms_for` says by how much to enlarge an image for small ones;
`marker_cells` draws one. Reached by entries of `targets.images` such as `tag36h11:7`. `find_chessboard` and `find_dots`
find calibration boards: board files with `chessboard` or `dots`.
"""

from imgu_ros.vision.markers.dictionaries import (
    has_new_interface,
    is_turned,
    marker_cells,
    marker_codes,
    marker_count,
    marker_dictionary,
    marker_distance,
    nearest_marker,
    require_marker_family,
)
from imgu_ros.vision.markers.finding import FoundMarker, MarkerFinder, distinct_markers, zooms_for
from imgu_ros.vision.markers.grids import find_chessboard, find_dots

__all__ = [
    "FoundMarker",
    "MarkerFinder",
    "distinct_markers",
    "find_chessboard",
    "find_dots",
    "has_new_interface",
    "is_turned",
    "marker_cells",
    "marker_codes",
    "marker_count",
    "marker_dictionary",
    "marker_distance",
    "nearest_marker",
    "require_marker_family",
    "zooms_for",
]
