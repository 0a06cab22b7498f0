# SPDX-License-Identifier: Apache-2.0
"""Scale space: Gaussians of three kinds, and pyramids.

A picture at scale sigma is the picture smoothed by a Gaussian; smoothing again adds variances, sigma_t^2 = sigma_c^2 +
sigma_f^2. A pyramid keeps each octave at half the size of the one before.

| module | holds | use it when |
|---|---|---|
| `gaussian` | `smooth`: any kernel, any border, uint8, uint16, float32 | a picture is to be smoothed |
| `kernels` | the sampled Gaussian, and the discrete one, T(n, t) = exp(-t) I_n(t) | the numbers themselves are needed |
| `recursive` | an infinite response, at a time that does not depend on sigma | sigma is large |
| `pyramid` | `build_pyramid`: octaves, scales between, or bands; `PixelScaling` | features at many sizes |
| `laplacian` | bands that add up to the picture again, bit for bit | editing, fusing or coding by scales |

The kernels, and which to take:

- `sampled`: fastest up to sigma 5 to 10 px. Below 0.8 px its variance falls short of sigma^2.
- `discrete`: exact at any sigma; T(., s) * T(., t) = T(., s + t). For small steps of scale, as between fine levels.
- `recursive`: about as long for sigma 50 as for sigma 1; 0.03 % of its peak off the Gaussian. For sigma above 10 px.

**In the pipeline**: `pyramid.kind` (`coarse`, `fine`, `laplacian`), `pyramid.kernel` (`sampled`, `discrete`,
`recursive`), `pyramid.levels`, `pyramid.scales_per_octave`, `pyramid.max_side_px`;
`preprocess.smoothing_px` smooths beforehand.

Sources: IU 3.1 to 3.3; Burt & Adelson 1983; Lindeberg 1990, 1994; Deriche 1993; Farneback & Westin 2006.
"""

import imgu_ros.vision.processing  # noqa: F401  (its edges smooth with this room: it has to come first)
from imgu_ros.vision.scale_space.gaussian import GaussianKernel, smooth
from imgu_ros.vision.scale_space.kernels import discrete_gaussian, discrete_reach, sampled_gaussian
from imgu_ros.vision.scale_space.laplacian import LaplacianPyramid, laplacian_pyramid, reconstructed
from imgu_ros.vision.scale_space.pyramid import (
    AlignedPixels,
    Level,
    PixelScaling,
    Pyramid,
    PyramidKind,
    band_passed,
    build_pyramid,
    enlarged,
    reduced,
)
from imgu_ros.vision.scale_space.recursive import smooth_recursively

__all__ = [
    "AlignedPixels",
    "GaussianKernel",
    "LaplacianPyramid",
    "Level",
    "PixelScaling",
    "Pyramid",
    "PyramidKind",
    "band_passed",
    "build_pyramid",
    "discrete_gaussian",
    "discrete_reach",
    "enlarged",
    "laplacian_pyramid",
    "reconstructed",
    "reduced",
    "sampled_gaussian",
    "smooth",
    "smooth_recursively",
]
