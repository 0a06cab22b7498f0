# SPDX-License-Identifier: Apache-2.0
"""Image formation: lens, shutter, sensor, colour filters; from raw numbers to a picture.

Light passes a lens and a shutter, a sensor counts it under colour filters, a converter makes numbers of it. The
modules model each step, for the simulator, and undo what can be undone, for the pipeline.

| module | holds | use it when |
|---|---|---|
| `optics` | the thin lens: circle of confusion, depth of field; the defocused disc | choosing a lens |
| `shutter` | exposure value, kernel of motion blur, rows of a rolling shutter and their skew | choosing a shutter |
| `pixel_array` | size, aspect ratio and pitch of the sensor; focal length in pixels | from a data sheet to K |
| `sensor` | shot and read noise, amplification, the converter to 8, 10, 12, 14 or 16 bits | making honest raw data |
| `cfa`, `demosaic` | the Bayer pattern in four phases, and its inverse | a mosaic is to become a colour picture |
| `transfer` | linear, sRGB and film curves and their inverses | light is to become values, or values light |
| `levels` | black and white level, gains; the step to 8 bits, known range or percentiles | raw or thermal data |
| `bands` | one grey image of N bands: mean, weighted, principal component, spectral angle | more bands than three |
| `layout` | what the numbers of a raw image mean | reading and handing on raw images |

Bands, and which way to take: `mean` when all bands show the scene alike; `weighted` when some are noisier;
`principal_component` when they differ, and it is not known how (a band may be the negative of another: the mean would
cancel); `spectral_angle` when a material is sought by its spectrum, whatever its brightness.

Demosaicking, in dB on the Kodak and the McMaster photographs (mean CPSNR): `bilinear` 30.3 and 32.3, for greys and for
speed; `edge_aware` 30.4 and 32.4; `malvar` 36.0 and 34.1, colour at video rate; `hamilton_adams` 37.4 and 34.4; `menon`
39.5 and 33.7, for the finest patterns of dull colours; `residual` 39.9 and 36.1, for all else when time matters less.

**In the pipeline**: `demosaic.method` (also `imgu demosaic --method`); `raw.black_level`, `raw.white_level`,
`raw.significant_bits` (0: automatic gain by percentiles, as for infrared pictures), `raw.gains`; `raw.bands`,
`raw.band_mode`, `raw.band_weights`, `raw.reference_spectrum`. **Simulated** by `imgu simulate --bits --full-well
--read-noise --black-level --sensitivities --transfer --exposure-ms --row-time-us --defocus-px --f-number --focus-m --ev
--saturated`.

Sources: IU 1.1 to 1.3; Szeliski 2022, 2.2 and 2.3; EMVA Standard 1288; Kruse et al. 1993 (spectral angle).
"""

from imgu_ros.vision.formation.bands import (
    BandMode,
    grey_from_bands,
    mean_of_bands,
    principal_component,
    spectral_angle,
)
from imgu_ros.vision.formation.cfa import BayerPattern, as_mosaic, mosaic, site_mask
from imgu_ros.vision.formation.demosaic import DemosaicMethod, demosaic, grey_from_mosaic
from imgu_ros.vision.formation.demosaicking.hamilton_adams import demosaic_hamilton_adams
from imgu_ros.vision.formation.demosaicking.malvar import demosaic_malvar
from imgu_ros.vision.formation.demosaicking.menon import demosaic_menon
from imgu_ros.vision.formation.demosaicking.opencv import demosaic_bilinear, demosaic_edge_aware
from imgu_ros.vision.formation.demosaicking.quads import Field, Missing, Quads
from imgu_ros.vision.formation.demosaicking.residual import demosaic_residual
from imgu_ros.vision.formation.demosaicking.strips import StripMethod, demosaic_in_strips
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage
from imgu_ros.vision.formation.levels import stretched_to_8_bit, with_levels
from imgu_ros.vision.formation.optics import (
    DepthOfField,
    ThinLens,
    circle_of_confusion,
    depth_of_field,
    disc_kernel,
    hyperfocal_distance,
)
from imgu_ros.vision.formation.pixel_array import PixelArray
from imgu_ros.vision.formation.sensor import Sensor, expose, quantise
from imgu_ros.vision.formation.shutter import Exposure, motion_kernel, rolling_shutter_points, row_times
from imgu_ros.vision.formation.transfer import (
    TransferFunction,
    decode_light,
    encode_light,
    light_of_srgb,
    linear_from_srgb,
    srgb_from_linear,
)

__all__ = [
    "BandMode",
    "BayerPattern",
    "ColorModel",
    "DemosaicMethod",
    "DepthOfField",
    "Exposure",
    "Field",
    "Missing",
    "PixelArray",
    "PixelLayout",
    "Quads",
    "RawImage",
    "Sensor",
    "StripMethod",
    "ThinLens",
    "TransferFunction",
    "as_mosaic",
    "circle_of_confusion",
    "decode_light",
    "demosaic",
    "demosaic_bilinear",
    "demosaic_edge_aware",
    "demosaic_hamilton_adams",
    "demosaic_in_strips",
    "demosaic_malvar",
    "demosaic_menon",
    "demosaic_residual",
    "depth_of_field",
    "disc_kernel",
    "encode_light",
    "expose",
    "grey_from_bands",
    "grey_from_mosaic",
    "hyperfocal_distance",
    "light_of_srgb",
    "linear_from_srgb",
    "mean_of_bands",
    "mosaic",
    "motion_kernel",
    "principal_component",
    "quantise",
    "rolling_shutter_points",
    "row_times",
    "site_mask",
    "spectral_angle",
    "srgb_from_linear",
    "stretched_to_8_bit",
    "with_levels",
]
