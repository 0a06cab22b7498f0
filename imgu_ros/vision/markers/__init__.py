# SPDX-License-Identifier: Apache-2.0
"""Fiducial markers: the dictionaries of OpenCV's aruco module, and finding them in an image.

`MarkerFinder` finds the markers of one family, `zooms_for` says by how much to enlarge an image for small ones;
`marker_cells` draws one. Reached by entries of `targets.images` such as `tag36h11:7`.
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

__all__ = [
    "FoundMarker",
    "MarkerFinder",
    "distinct_markers",
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
