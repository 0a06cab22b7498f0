# SPDX-License-Identifier: Apache-2.0
"""Focal length and angle of view, against numbers worked out by hand and rays."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import ShapeError
from imgu_ros.vision.camera.angle_of_view import angle_of_view, intrinsic_matrix, intrinsic_matrix_of_lens


@pytest.mark.parametrize(("focal_mm", "degrees"), [(24.0, 73.7), (50.0, 39.6), (200.0, 10.3)])
def test_full_frame_lenses(focal_mm: float, degrees: float) -> None:
    # As makers of lenses state them for 36 mm.
    view = angle_of_view(intrinsic_matrix_of_lens(3600, 2400, focal_mm * 1e-3, 10e-6), 3600, 2400)
    assert np.rad2deg(view.horizontal) == pytest.approx(degrees, abs=0.05)


def test_full_frame_lens_of_50_mm() -> None:
    # 36 x 24 mm: 39.6 x 27.0 degrees, 46.8 across the diagonal.
    K = intrinsic_matrix_of_lens(3600, 2400, 50e-3, 10e-6)
    view = angle_of_view(K, 3600, 2400)
    assert np.rad2deg([view.horizontal, view.vertical, view.diagonal]) == pytest.approx([39.60, 26.99, 46.79], abs=0.01)


@given(width=st.integers(2, 5000), height=st.integers(2, 5000), angle=st.floats(0.01, 3.1))
def test_angle_of_view_inverts(width: int, height: int, angle: float) -> None:
    view = angle_of_view(intrinsic_matrix(width, height, angle), width, height)
    assert view.horizontal == pytest.approx(angle, rel=1e-12)
    assert view.diagonal >= max(view.horizontal, view.vertical)


def test_axis_off_the_centre() -> None:
    # The axis through the left edge: 45 degrees to the right edge, none to the left.
    view = angle_of_view([[100, 0, -0.5], [0, 100, 49.5], [0, 0, 1]], 100, 100)
    assert np.rad2deg([view.horizontal, view.vertical]) == pytest.approx([45, 2 * np.rad2deg(np.arctan(0.5))])


def test_bad_input() -> None:
    for angle in (0.0, np.pi, np.nan, -1):
        with pytest.raises(ShapeError, match="angle_of_view_rad"):
            intrinsic_matrix(640, 480, angle)
    with pytest.raises(ShapeError, match="size"):
        intrinsic_matrix(0, 480, 1.0)
    with pytest.raises(ShapeError, match="pixel_m"):
        intrinsic_matrix_of_lens(640, 480, 4e-3, 0)
    with pytest.raises(ShapeError, match="focal length"):
        intrinsic_matrix_of_lens(640, 480, 1e300, 1e-300)
    with pytest.raises(ShapeError, match="of the size of a picture"):
        angle_of_view([[1e-320, 0, 1e300], [0, 1e-320, 1e300], [0, 0, 1]], 640, 480)
    with pytest.raises(ShapeError, match="fx > 0"):
        angle_of_view(np.diag([-1, 1, 1.0]), 640, 480)
