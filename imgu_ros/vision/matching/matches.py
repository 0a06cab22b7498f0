# SPDX-License-Identifier: Apache-2.0
"""Matches between two sets of descriptors."""

from __future__ import annotations

from dataclasses import dataclass

from imgu_ros.types import Floats, Indices


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """N tentative matches, best first.

    Attributes
    ----------
    index_src, index_dst : (N,) rows of the two sets
    distance : (N,) between the descriptors; smaller is better
    """

    index_src: Indices
    index_dst: Indices
    distance: Floats

    def __len__(self) -> int:
        return len(self.index_src)
