"""Targets: the known flat pictures, and what the chain prepares of them once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from imgu_ros.types import Image


@dataclass(frozen=True, slots=True, eq=False)
class TargetImage:
    """A known flat picture.

    Attributes
    ----------
    name : in topics, files and frames
    pixels : (H, W) or (H, W, 3) RGB, uint8
    width_m : printed width, outer edge to outer edge; 0: unknown
    """

    name: str
    pixels: Image
    width_m: float
