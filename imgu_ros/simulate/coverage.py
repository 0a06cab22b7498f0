# SPDX-License-Identifier: Apache-2.0
"""How much of each pixel a rectangle on a plane covers."""

from __future__ import annotations

import numpy as np

from imgu_ros.simulate.optics import PlaneMap
from imgu_ros.types import Image


def rectangle_coverage(on_plane: PlaneMap, width: float, height: float) -> Image:
    """Return the share of each pixel, (rows, columns) float32 in [0, 1], that looks at the rectangle.

    The rectangle reaches from (-0.5, -0.5) to (width - 0.5, height - 0.5) in the plane's coordinates. Each edge cuts
    the unit pixel exactly, as a straight line; at a corner the product of two such shares is an approximation.
    """
    m = on_plane
    # No point of a pixel is further than this from its centre, in plane coordinates.
    reach_u = float(np.abs(m.ux).max() + np.abs(m.uy).max())
    reach_v = float(np.abs(m.vx).max() + np.abs(m.vy).max())
    du = np.float32(width / 2) - np.abs(m.u - np.float32((width - 1) / 2))
    dv = np.float32(height / 2) - np.abs(m.v - np.float32((height - 1) / 2))
    share = ((du > reach_u) & (dv > reach_v)).astype(np.float32)
    band = np.flatnonzero((du > -reach_u) & (dv > -reach_v) & (share == 0))
    if len(band):
        u, v, ux, uy, vx, vy = (a.ravel()[band] for a in (m.u, m.v, m.ux, m.uy, m.vx, m.vy))
        distances = np.stack((u + 0.5, width - 0.5 - u, v + 0.5, height - 0.5 - v)).astype(np.float32)
        shares = _half_plane_share(distances, np.stack((ux, ux, vx, vx)), np.stack((uy, uy, vy, vy)))
        share.ravel()[band] = shares.prod(axis=0)
    if not m.front.all():
        share[~m.front] = 0
    return share


def _half_plane_share(value: Image, gx: Image, gy: Image) -> Image:
    """Return the share of the unit pixel where the linear function with this central value and gradient is positive."""
    gx, gy = np.abs(gx), np.abs(gy)
    length = np.hypot(gx, gy)
    long, short = np.maximum(gx, gy) / length, np.minimum(gx, gy) / length
    d = value / length
    reach, away = (long + short) / 2, np.abs(d)
    # The distance over the pixel is the sum of two uniform variables: its distribution is a trapezoid.
    tail = np.maximum(reach - away, 0) ** 2 / (2 * long * np.maximum(short, np.float32(1e-6)))
    share = np.where(away <= (long - short) / 2, 0.5 + away / long, 1 - tail)
    share = np.where(away >= reach, np.float32(1), share)
    return np.where(d >= 0, share, 1 - share)
