# SPDX-License-Identifier: Apache-2.0
"""Mapping points, local derivative, sign and orientation of homographies."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.vision.projective.homography import normalised_homography
from imgu_ros.vision.projective.transform import area_factor, faces_camera, inverse3, local_jacobian, transform

H = np.array([[2.0, 0, 10], [0, 3, -4], [0, 0.01, 1]])


def test_transform_by_hand() -> None:
    # (1, 100) -> (12, 296) / 2
    assert_allclose(transform(H, [[0, 0], [1, 100]]), [[10, -4], [6, 148]])


def test_transform_of_no_points() -> None:
    assert transform(H, np.zeros((0, 2))).shape == (0, 2)


def test_point_mapped_to_infinity() -> None:
    with pytest.raises(DegenerateConfiguration, match="infinity"):
        transform(H, [[0, -100.0]])


def test_local_jacobian_is_the_derivative() -> None:
    points = np.random.default_rng(0).uniform(0, 200, (10, 2))
    step = 1e-5
    for axis in (0, 1):
        moved = np.eye(2)[axis] * step
        numeric = (transform(H, points + moved) - transform(H, points - moved)) / (2 * step)
        assert_allclose(local_jacobian(H, points)[:, :, axis], numeric, rtol=1e-6)


def test_area_factor_is_the_determinant_of_the_jacobian() -> None:
    rng = np.random.default_rng(8)
    H, points = rng.normal(size=(3, 3)), rng.uniform(-1, 1, (20, 2))
    for point, jacobian in zip(points, local_jacobian(H, points), strict=True):
        assert area_factor(H, point) == pytest.approx(abs(np.linalg.det(jacobian)), rel=1e-9)
        assert area_factor(-3 * H, point) == pytest.approx(area_factor(H, point))
    with pytest.raises(DegenerateConfiguration, match="infinity"):
        area_factor([[1, 0, 0], [0, 1, 0], [1, 0, 0]], (0, 5))


def test_normalised_homography() -> None:
    for scale in (-7.0, 0.001, 1e6):
        out = normalised_homography(H * scale)
        assert np.linalg.norm(out) == pytest.approx(1)
        assert np.linalg.det(out) > 0
        assert_allclose(out, H / np.linalg.norm(H), atol=1e-15)
    with pytest.raises(DegenerateConfiguration):
        normalised_homography(np.zeros((3, 3)))
    with pytest.raises(ShapeError):
        normalised_homography(np.eye(2))


def test_faces_camera() -> None:
    points = np.array([[0.0, 0], [50, 50]])
    assert faces_camera(H, points)
    assert faces_camera(-5 * H, points)  # the sign of a matrix means nothing
    assert not faces_camera(H @ np.diag([-1.0, 1.0, 1.0]), points)  # mirrored
    assert not faces_camera(H, [[0, 0], [0, -200.0]])  # across the vanishing line


def test_inverse3() -> None:
    rng = np.random.default_rng(9)
    for _ in range(20):
        M = rng.normal(size=(3, 3))
        assert_allclose(inverse3(M), np.linalg.inv(M), rtol=1e-9)
    for singular in (np.zeros((3, 3)), np.ones((3, 3))):
        with pytest.raises(DegenerateConfiguration, match="M: singular"):
            inverse3(singular, "M")
