"""Image formation: lens, shutter, sensor, colour filters; from raw numbers to a picture.

Light passes a lens and a shutter, a sensor counts it under colour filters, a converter makes numbers of it. The
modules model each step, for the simulator, and undo what can be undone, for the chain.

| module | holds | use it when |
|---|---|---|
| `optics` | the thin lens: circle of confusion, depth of field; the defocused disc | choosing a lens |
| `shutter` | exposure value, kernel of motion blur, rows of a rolling shutter and their skew | choosing a shutter |
| `pixel_array` | size, aspect ratio and pitch of the sensor; focal length in pixels | from a data sheet to K |
| `sensor` | shot and read noise, amplification, the converter to 8, 10, 12, 14 or 16 bits | making honest raw data |
| `cfa`, `demosaic` | the Bayer pattern in four phases, and its inverse | a mosaic is to become a colour picture |
| `levels` | black and white level, gains; the step to 8 bits, known range or percentiles | raw or thermal data |
| `bands` | one grey image of N bands: mean, weighted, principal component, spectral angle | more bands than three |
| `layout` | what the numbers of a raw image mean | reading and handing on raw images |

Bands, and which way to take: `mean` when all bands show the scene alike; `weighted` when some are noisier;
`principal_component` when they differ, and it is not known how (a band may be the negative of another: the mean would
cancel); `spectral_angle` when a material is sought by its spectrum, whatever its brightness.

Demosaicking, in dB on the Kodak and the McMaster photographs (mean CPSNR): `bilinear` 30.3 and 32.3, for greys and for
speed; `edge_aware` 30.4 and 32.4; `malvar` 36.0 and 34.1, colour at video rate; `hamilton_adams` 37.4 and 34.4; `menon`
39.5 and 33.7, for the finest patterns of dull colours; `residual` 39.9 and 36.1, for all else when time matters less.

**In the chain**: `demosaic.method` (also `imgu demosaic --method`); `raw.black_level`, `raw.white_level`,
`raw.significant_bits` (0: automatic gain by percentiles, as for infrared pictures), `raw.gains`; `raw.bands`,
`raw.band_mode`, `raw.band_weights`, `raw.reference_spectrum`. **Simulated** by `imgu simulate --bits --full-well
--read-noise --black-level --exposure-ms --row-time-us --defocus-px --f-number --focus-m --ev`.

Sources: notes 1.1 to 1.3; Szeliski 2022, 2.2 and 2.3; EMVA Standard 1288; Kruse et al. 1993 (spectral angle).
"""
