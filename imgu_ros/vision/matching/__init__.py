# SPDX-License-Identifier: Apache-2.0
"""Which descriptors of two sets belong together.

`match` finds the nearest row of one set for each of another, exactly, by comparing all. Whatever is ambiguous is
dropped: by the **ratio test** (the second nearest *at another place* must be clearly farther) and the **mutual check**
(each is the other's nearest). What is left comes least ambiguous first, as PROSAC wants it. A set that is matched to
again and again, as a target's, is prepared once: `prepare_gallery`, `match_to_gallery`.

`matching.metric` says what *near* means. Which metrics make sense is told by `metrics_of`, and checked by
`metric_for`; `auto` is the first one:

| descriptor | metrics | free of |
|---|---|---|
| `orb`, `brief` | `hamming`: differing bits | |
| `sift`, `rootsift` | `euclidean`; `cosine`: 1 - the cosine of their angle | `cosine`: gain |
| `patch` | `ncc`: 1 - normalised cross-correlation | offset and gain |
| | `zmssd`: squared differences less the means | offset |
| | `ssd`: squared differences | |

`ssd` and `zmssd` are squares: a ratio of 0.72 means for them what 0.85 means for distances. Single patches are compared
by `ssd`, `zmssd` and `ncc` of `matching.patches`.

`match_guided` matches only near the positions that a homography predicts, with few rivals and thus a looser ratio;
`guided_homography` repeats that and the fit until the matches stay the same. In the pipeline `matching.guided` does so
after the first homography: half as many matches again and more, for targets with repeating patterns; the alignment of
`refinement.enabled` gains accuracy at less cost.

Where it is nearly known how one image shows the other, patches need no descriptors: a `PatchBank` prepares each patch
once, and one small product of matrices measures its displacement in another image, whatever gain and offset of the
light (Lucas-Kanade, inverse compositional). A patch bridges about 3 px; `projective.plane_motion` fits the motion that
most displacements agree with. A `PatchAtlas` holds the squares of an image that matter, so that the rest need not be
developed.

Hamming distances come from one product of matrices that compares two rows at once, exactly: 1000 descriptors of a
frame with 3000 of a target in about 10 ms on two cores. How many matches of real images are correct, by
descriptor and beside OpenCV's: `docs/matching.md`.

Parameters: `matching.metric`, `matching.ratio`, `matching.mutual`, `matching.guided`.
Sources: IU 5.1, 5.3, 5.4.2, 7.5; Lowe 2004, section 7.1; HZ algorithm 4.6.
"""

from imgu_ros.vision.matching.gallery import Gallery, Neighbours, Places, find_places, prepare_gallery
from imgu_ros.vision.matching.guided import GuidedHomography, guided_homography, match_guided
from imgu_ros.vision.matching.hamming import BinaryRows, binary_rows, hamming_distance
from imgu_ros.vision.matching.index import DescriptorIndex, build_index
from imgu_ros.vision.matching.matches import Matches
from imgu_ros.vision.matching.metrics import (
    Metric,
    checked_rows,
    comparable_rows,
    metric_for,
    metric_of_rows,
    metrics_of,
    require_index,
)
from imgu_ros.vision.matching.near import NearPairs, near_pairs
from imgu_ros.vision.matching.nearest import match, match_to_gallery
from imgu_ros.vision.matching.numbers import NumberRows, number_rows
from imgu_ros.vision.matching.patch_atlas import PatchAtlas
from imgu_ros.vision.matching.patch_bank import Displacements, LocalDistortion, PatchBank, Patches, as_grey
from imgu_ros.vision.matching.patches import ncc, ssd, zmssd

__all__ = [
    "BinaryRows",
    "DescriptorIndex",
    "Displacements",
    "Gallery",
    "GuidedHomography",
    "LocalDistortion",
    "Matches",
    "Metric",
    "NearPairs",
    "Neighbours",
    "NumberRows",
    "PatchAtlas",
    "PatchBank",
    "Patches",
    "Places",
    "as_grey",
    "binary_rows",
    "build_index",
    "checked_rows",
    "comparable_rows",
    "find_places",
    "guided_homography",
    "hamming_distance",
    "match",
    "match_guided",
    "match_to_gallery",
    "metric_for",
    "metric_of_rows",
    "metrics_of",
    "ncc",
    "near_pairs",
    "number_rows",
    "prepare_gallery",
    "require_index",
    "ssd",
    "zmssd",
]
