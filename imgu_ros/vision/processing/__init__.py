# SPDX-License-Identifier: Apache-2.0
"""Operations on pixels: points, histograms, convolution, derivatives, edges and warps.

Everything here takes an image, `(H, W)` or `(H, W, 3)` in uint8, uint16 or float32 in [0, 1], and gives a new one.

| module | holds | use it when |
|---|---|---|
| `points` | brightness and contrast with clamping, gamma, grey from RGB by weights | too dark, too flat, in colour |
| `thresholding` | fixed threshold, Otsu's threshold | the picture is two things: ink and paper |
| `histograms` | histogram with any number of bins, equalisation, CLAHE | light differs between or within pictures |
| `borders` | what stands outside the picture: constant, periodic, reflected, mirrored, replicated | every filter |
| `convolution` | true convolution (flipped kernel) with any kernel, mean filter | a filter of your own |
| `separability` | rank-1 test, split of any kernel into rows and columns | to know why a kernel is fast or slow |
| `derivatives` | Sobel, Scharr and Gaussian derivatives in grey values per pixel | slopes, edge directions |
| `edges` | edge strength, its threshold, Canny | outlines |
| `quadrilaterals` | outlines of flat things by their sides, corners hidden or not | a sheet, a label, a screen |
| `interpolation` | values between pixels, resizing: nearest, linear, cubic, area | sub-pixel samples, scaling |
| `warping` | projective, affine, similarity warps; rotation about a point, of the whole picture | another view |
| `remapping` | warps by any map, given point by point | through a lens |

Smoothing by Gaussians is in the next chapter, `scale_space`.

**In the pipeline** the parameters `preprocess.*` reach brightness, contrast, gamma, equalisation, smoothing, edges
and thresholds: they change the picture on which keypoints are sought and described, of targets and frames alike, and
are off by default. Alignment (`refinement.*`, `tracking.*`) matches brightness and contrast itself and keeps to the
picture as it was: its precision lives in grey ramps that thresholds and clamping destroy. Canny's lines are not among
the edges there: one bit a pixel leaves descriptors too little, and a simulated target is not found by them.
`raw.grey_weights` are the weights of the colours in the grey picture.

**On files** `imgu filter` does convolution, smoothing, gradients and edges, Canny's too; `imgu warp` resizes, rotates
and maps; `imgu match --warp` draws a found target straight on.

Sources: IU 2.1 to 2.3; Otsu 1979; Canny 1986; Scharr 2000; Zuiderveld 1994 (CLAHE); Keys 1981 (cubic).
"""

from imgu_ros.vision.processing.borders import Border, border_values, padded, source_index
from imgu_ros.vision.processing.convolution import convolve, convolve_separable, mean_filtered
from imgu_ros.vision.processing.derivatives import Derivative, Gradient, gradient
from imgu_ros.vision.processing.edges import canny, edge_map, edge_strength
from imgu_ros.vision.processing.histograms import equalised, equalised_locally, histogram
from imgu_ros.vision.processing.interpolation import Interpolation, checked_size, resized, sampled
from imgu_ros.vision.processing.points import adjust, full_scale, gamma_corrected, grey_from_rgb, require_range
from imgu_ros.vision.processing.quadrilaterals import find_quadrilaterals
from imgu_ros.vision.processing.remapping import remapped
from imgu_ros.vision.processing.separability import SplitKernel, as_kernel, is_separable, split
from imgu_ros.vision.processing.thresholding import otsu_threshold, thresholded
from imgu_ros.vision.processing.warping import Canvas, rotated, rotation_about, warped, whole_picture

__all__ = [
    "Border",
    "Canvas",
    "Derivative",
    "Gradient",
    "Interpolation",
    "SplitKernel",
    "adjust",
    "as_kernel",
    "border_values",
    "canny",
    "checked_size",
    "convolve",
    "convolve_separable",
    "edge_map",
    "edge_strength",
    "equalised",
    "equalised_locally",
    "find_quadrilaterals",
    "full_scale",
    "gamma_corrected",
    "gradient",
    "grey_from_rgb",
    "histogram",
    "is_separable",
    "mean_filtered",
    "otsu_threshold",
    "padded",
    "remapped",
    "require_range",
    "resized",
    "rotated",
    "rotation_about",
    "sampled",
    "source_index",
    "split",
    "thresholded",
    "warped",
    "whole_picture",
]
