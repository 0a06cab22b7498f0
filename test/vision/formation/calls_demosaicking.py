# SPDX-License-Identifier: Apache-2.0
"""A valid call of each public function of demosaicking (see test/vision/test_hostile.py)."""

from __future__ import annotations

import numpy as np

from imgu_ros.vision.formation.cfa import BayerPattern, as_mosaic, mosaic, site_mask
from imgu_ros.vision.formation.demosaic import demosaic, grey_from_mosaic
from imgu_ros.vision.formation.demosaicking.hamilton_adams import demosaic_hamilton_adams
from imgu_ros.vision.formation.demosaicking.malvar import demosaic_malvar
from imgu_ros.vision.formation.demosaicking.menon import demosaic_menon
from imgu_ros.vision.formation.demosaicking.opencv import demosaic_bilinear, demosaic_edge_aware
from imgu_ros.vision.formation.demosaicking.quads import Missing, Quads
from imgu_ros.vision.formation.demosaicking.residual import demosaic_residual
from imgu_ros.vision.formation.demosaicking.strips import StripMethod, demosaic_in_strips


def _raw(rng: np.random.Generator) -> np.ndarray:
    return rng.integers(0, 65535, (7, 10), np.uint16)


def _copied(q: Quads) -> Missing:
    return Missing(q.green_by_red, q.blue, q.red, q.blue, q.red, q.blue, q.red, q.green_by_blue)


RECIPE = StripMethod(_copied, reach=1, shift=1, scale=1, integer=False)

CALLS = {
    method: lambda rng: {"raw": _raw(rng), "pattern": BayerPattern.GBRG}
    for method in (
        demosaic_bilinear,
        demosaic_edge_aware,
        demosaic_malvar,
        demosaic_hamilton_adams,
        demosaic_menon,
        demosaic_residual,
        grey_from_mosaic,
    )
} | {
    demosaic: lambda rng: {"raw": _raw(rng), "pattern": BayerPattern.RGGB, "method": "malvar"},
    demosaic_in_strips: lambda rng: {"raw": _raw(rng), "pattern": BayerPattern.BGGR, "recipe": RECIPE},
    as_mosaic: lambda rng: {"raw": _raw(rng)},
    mosaic: lambda rng: {"rgb": rng.integers(0, 255, (5, 6, 3), np.uint8), "pattern": BayerPattern.RGGB},
    site_mask: lambda rng: {"shape": (3, 4), "pattern": BayerPattern.RGGB, "color": "g"},
}
