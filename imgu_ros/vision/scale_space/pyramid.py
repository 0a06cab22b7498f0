"""Gaussian pyramids (notes 3.2; Burt & Adelson 1983; Lindeberg 1994)."""

from __future__ import annotations

from dataclasses import dataclass

from imgu_ros.types import Image


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """One level of a pyramid.

    Attributes
    ----------
    image : (H, W)
    scale : full-resolution pixels in one pixel of this level, >= 1. Pixel areas, not centres, are aligned:
        x_full = (x_level + 0.5) * scale - 0.5
    """

    image: Image
    scale: float


@dataclass(frozen=True, slots=True, eq=False)
class Pyramid:
    """Levels from fine to coarse."""

    levels: tuple[Level, ...]
