# SPDX-License-Identifier: Apache-2.0
"""Keypoints: places that are found again in another view.

`detect` finds them on every level of a pyramid with any of six detectors; all give position, scale, orientation and
response, so that every descriptor of the pipeline can follow.

| detector | finds | sub-pixel | scales | when to use it |
|---|---|---|---|---|
| `orb` | FAST corners ranked by Harris | no | the pyramid's | the default: fast, repeats well |
| `fast` | arcs of 9 to 12 of 16 ring pixels | no | the pyramid's | sharp corners; `keypoints.fast_arc` |
| `harris` | two strong gradient directions | yes | the pyramid's | repeats best under zoom; exact positions |
| `moravec` | patches unlike their eight neighbours | yes | the pyramid's | for comparison: the first of its kind |
| `dog` | blobs, extrema in space and scale (SIFT) | yes | its own | large changes of scale; 1 s and 0.5 GB at 1080p |
| `mser` | regions that a threshold hardly changes | yes | its own | print, signs, flat shapes; few but distinctive |

Reached by `keypoints.detector`, `keypoints.max_count` and `keypoints.fast_arc`.

Every detector looks at all that it finds, then `spread` keeps the strongest half of the wanted number (`dog`: two
thirds) wherever it lies and takes the others cell by cell from a grid, so that one busy corner of the image does not
get them all. (`orb` spreads its strongest 2 `max_count`, as OpenCV stops there.) Orientation is the direction to the
intensity centroid (`centroid_orientation`; for regions of any size `scaled_orientation`), for `dog` the peaks of the
histogram of gradient directions (`dominant_orientations`).

How often keypoints are found again: `repeatability`; measured beside OpenCV's own detectors, with time and memory:
`docs/repeatability.md`.

IU 4.2.1 to 4.2.4 and 4.3.1; Harris & Stephens 1988, Moravec 1980, Rosten & Drummond 2006, Lowe 2004, Matas et al.
2002, Rublee et al. 2011. The angle is measured from x towards y, clockwise as seen.
"""

from imgu_ros.vision.keypoints.detect import detect, level_shares
from imgu_ros.vision.keypoints.dog import detect_dog
from imgu_ros.vision.keypoints.dog_centres import refined_centres
from imgu_ros.vision.keypoints.dominant import Orientations, dominant_orientations
from imgu_ros.vision.keypoints.fast import FastParameters, detect_fast, fast_detector
from imgu_ros.vision.keypoints.harris import detect_harris, harris_response
from imgu_ros.vision.keypoints.keypoints import Corners, Keypoints, on_level
from imgu_ros.vision.keypoints.moravec import detect_moravec, moravec_response
from imgu_ros.vision.keypoints.mser import Regions, detect_mser, find_regions
from imgu_ros.vision.keypoints.opencv import corners_from_opencv, opencv_keypoints, positions, require_describable
from imgu_ros.vision.keypoints.orb import detect_orb
from imgu_ros.vision.keypoints.orientation import centroid_orientation, scaled_orientation
from imgu_ros.vision.keypoints.peaks import Peaks, find_peaks
from imgu_ros.vision.keypoints.repeatability import Repeatability, repeatability
from imgu_ros.vision.keypoints.spreading import spread

__all__ = [
    "Corners",
    "FastParameters",
    "Keypoints",
    "Orientations",
    "Peaks",
    "Regions",
    "Repeatability",
    "centroid_orientation",
    "corners_from_opencv",
    "detect",
    "detect_dog",
    "detect_fast",
    "detect_harris",
    "detect_moravec",
    "detect_mser",
    "detect_orb",
    "dominant_orientations",
    "fast_detector",
    "find_peaks",
    "find_regions",
    "harris_response",
    "level_shares",
    "moravec_response",
    "on_level",
    "opencv_keypoints",
    "positions",
    "refined_centres",
    "repeatability",
    "require_describable",
    "scaled_orientation",
    "spread",
]
