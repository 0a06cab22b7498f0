# SPDX-License-Identifier: Apache-2.0
"""A valid call of each public function of the room, for `test_hostile.py`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from imgu_ros.vision.markers import dictionaries, finding

FAMILY = "aruco_4x4_50"


def _picture(rng: np.random.Generator) -> np.ndarray:
    cells = np.pad(dictionaries.marker_cells(FAMILY, int(rng.integers(50))), 2, constant_values=True)
    return np.kron(cells, np.ones((6, 6), np.uint8)) * np.uint8(255)


def _marker(side: float, number: int) -> finding.FoundMarker:
    return finding.FoundMarker(number, side * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]))


CALLS: dict[Callable, Callable[[np.random.Generator], dict[str, object]]] = {
    dictionaries.require_marker_family: lambda rng: {"family": FAMILY},
    dictionaries.marker_count: lambda rng: {"family": FAMILY},
    dictionaries.nearest_marker: lambda rng: {"family": FAMILY, "number": 3, "cells": rng.random((4, 4)) > 0.5},
    dictionaries.has_new_interface: lambda rng: {},
    dictionaries.is_turned: lambda rng: {"family": FAMILY},
    finding.zooms_for: lambda rng: {"shape": (480, 640)},
    finding.MarkerFinder.find: lambda rng: {
        "self": finding.MarkerFinder(FAMILY), "image": _picture(rng), "zoom": 1, "only": None,
    },
    finding.distinct_markers: lambda rng: {"found": [_marker(80.0, 7), _marker(100.0, 7), _marker(100.0, 8)]},
}  # fmt: skip
