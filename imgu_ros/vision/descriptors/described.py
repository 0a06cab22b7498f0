"""What a descriptor returns for one picture."""

from __future__ import annotations

from dataclasses import dataclass

from imgu_ros.types import Image, Indices


@dataclass(frozen=True, slots=True, eq=False)
class Described:
    """Descriptors of some of the corners of one picture.

    Attributes
    ----------
    index : (N,) which corners they describe, ascending
    descriptors : (N, D), a row for each
    """

    index: Indices
    descriptors: Image
