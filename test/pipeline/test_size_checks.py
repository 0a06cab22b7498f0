# SPDX-License-Identifier: Apache-2.0
"""Widths of another unit are told from wide and near things that there are."""

from __future__ import annotations

import pytest

from imgu_ros.reference.size_checks import size_warning


@pytest.mark.parametrize(
    ("width_m", "distance_m", "likely"),
    [
        (59.4, 80.0, "0.594 (59.4 cm) or 0.0594 (59.4 mm)"),  # A1 in centimetres
        (21.0, 30.0, "0.21 (21 cm)"),  # A4
        (29.7, 12.0, "0.297 (29.7 cm)"),
        (210.0, 300.0, "0.21 (210 mm)"),
        (297.0, 400.0, "0.297 (297 mm)"),
        (594.0, 800.0, "0.594 (594 mm)"),
        (100.0, 120.0, "1 (100 cm) or 0.1 (100 mm)"),
        (0.000594, 0.0008, "0.594"),  # kilometres
        (0.0005, 0.0007, "0.5"),
    ],
)
def test_another_unit(width_m: float, distance_m: float, likely: str) -> None:
    said = size_warning("poster", width_m, distance_m)
    assert said.startswith(f"targets.widths_m {width_m:g}: poster would be ")
    assert f"did you mean {likely}" in said


@pytest.mark.parametrize(
    ("width_m", "distance_m"),
    [
        (5.0, 80.0),  # a landing pad
        (8.0, 120.0),
        (12.0, 3.0),  # a floor, seen from a robot
        (0.03, 0.05),  # a marker before a macro lens
        (0.594, 0.8),
        (0.16, 0.2),
        (2.4, 40.0),  # a billboard
        (0.02, 0.011),  # an endoscope's
    ],
)
def test_what_there_is(width_m: float, distance_m: float) -> None:
    assert size_warning("thing", width_m, distance_m) == ""


def test_a_length_without_a_likely_unit_is_told_all_the_same() -> None:
    said = size_warning("map", 5000.0, 2000.0)
    assert said.endswith("widths are in metres")
