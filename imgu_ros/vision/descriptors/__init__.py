# SPDX-License-Identifier: Apache-2.0
"""What a keypoint looks like, as a row of bits or numbers that another view of it resembles.

`describe` takes the keypoints of any detector and describes each on the level of the pyramid that fits its scale;
`descriptor.kind` chooses the kind in the pipeline:

| kind | a row | turns with the keypoint | scales with it | use it |
|---|---|---|---|---|
| `orb` | 256 bits | yes | by the pyramid | by default: the cheapest one for any view |
| `brief` | 256 bits | no | by the pyramid | where the camera stays upright: on rails, on wheels |
| `sift` | 128 numbers | yes | yes | for difficult light and steep views, at several times the cost |
| `rootsift` | 128 numbers | yes | yes | instead of `sift`: compares better at the same cost |
| `patch` | 169 pixels | yes | yes | to compare pixels themselves, by NCC or sums of squared differences |

Binary rows compare intensities in pairs: an offset changes nothing and a gain next to nothing. SIFT's are histograms
of gradient directions: an offset drops out in the derivatives and a gain by normalisation. Patches keep both; the
metric chooses what to forget (see the page on matching).

The orientation is the detector's: of the intensity centroid for corners, of the gradient histogram for `dog`.
Keypoints whose patch reaches beyond the image are left out by `orb`, `brief` and `patch`; SIFT's window may.

Single images are described by `describe_orb`, `describe_brief`, `describe_sift`, `describe_rootsift` and
`describe_patch`; `sample_patches` samples turned and scaled squares of an image.

Parameters: `descriptor.kind`. Sources: IU 4.2.4, 5.1, 5.2, 5.4, 5.5; the papers are named with each descriptor.
"""

from imgu_ros.vision.descriptors.brief import brief_pairs, describe_brief
from imgu_ros.vision.descriptors.describe import Descriptions, describe, empty_descriptors
from imgu_ros.vision.descriptors.described import Described, checked_corners
from imgu_ros.vision.descriptors.extractor import (
    DetectorDescriptor,
    ExtractorOptions,
    FeatureExtractor,
    make_extractor,
)
from imgu_ros.vision.descriptors.orb import describe_orb
from imgu_ros.vision.descriptors.patch import describe_patch, sample_patches
from imgu_ros.vision.descriptors.sift import describe_rootsift, describe_sift

__all__ = [
    "Described",
    "Descriptions",
    "DetectorDescriptor",
    "ExtractorOptions",
    "FeatureExtractor",
    "brief_pairs",
    "checked_corners",
    "describe",
    "describe_brief",
    "describe_orb",
    "describe_patch",
    "describe_rootsift",
    "describe_sift",
    "empty_descriptors",
    "make_extractor",
    "sample_patches",
]
