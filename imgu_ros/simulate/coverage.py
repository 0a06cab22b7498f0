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
    reach_u, reach_v = np.abs(m.ux) + np.abs(m.uy), np.abs(m.vx) + np.abs(m.vy)
    du, dv = width / 2 - np.abs(m.u - (width - 1) / 2), height / 2 - np.abs(m.v - (height - 1) / 2)
    share = ((du > 0) & (dv > 0) & m.front).astype(np.float32)
    band = m.front & (du > -reach_u) & (dv > -reach_v) & ((du < reach_u) | (dv < reach_v))
    index = np.nonzero(band)
    if not len(index[0]):
        return share
    u, v, ux, uy, vx, vy = (a[index] for a in (m.u, m.v, m.ux, m.uy, m.vx, m.vy))
    inside = np.ones(len(u), np.float32)
    for distance, gx, gy in (
        (u + 0.5, ux, uy),
        (width - 0.5 - u, ux, uy),
        (v + 0.5, vx, vy),
        (height - 0.5 - v, vx, vy),
    ):
        inside *= _half_plane_share(distance, gx, gy)
    share[index] = inside
    return share


def _half_plane_share(value: Image, gx: Image, gy: Image) -> Image:
    """Return the share of the unit pixel where the linear function with this central value and gradient is positive."""
    length = np.hypot(gx, gy)
    long = np.maximum(np.abs(gx), np.abs(gy)) / length
    short = np.minimum(np.abs(gx), np.abs(gy)) / length
    d = value / length
    reach = (long + short) / 2
    away = np.abs(d)
    # The distance over the pixel is the sum of two uniform variables: its distribution is a trapezoid.
    tail = np.maximum(reach - away, 0) ** 2 / (2 * long * np.maximum(short, np.float32(1e-6)))
    share = np.where(away <= (long - short) / 2, 0.5 + away / long, 1 - tail)
    share = np.where(away >= reach, np.float32(1), share)
    return np.where(d >= 0, share, 1 - share).astype(np.float32)
