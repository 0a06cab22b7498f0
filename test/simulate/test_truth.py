# SPDX-License-Identifier: Apache-2.0
"""Truth files, and the corner error against numbers worked out by hand."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from imgu_ros.errors import FileError, ShapeError
from imgu_ros.simulate.geometry import rotation_about
from imgu_ros.simulate.sequence import TYPICAL_LENSES, default_camera
from imgu_ros.simulate.truth import (
    COLUMNS,
    NEES_95,
    NEES_MEDIAN,
    Truth,
    corner_error,
    normalised_squared_error,
    read_truth,
    write_truth,
)
from imgu_ros.vision.camera.intrinsics import DistortionModel
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.camera.rotation import exp_so3

TEMPLATE, IMAGE = (100, 60), (640, 480)


def shift(x: float, y: float) -> np.ndarray:
    return np.array([[1.0, 0, x], [0, 1, y], [0, 0, 1]])


def test_same_homography_has_no_error() -> None:
    assert corner_error(shift(50, 40), shift(50, 40), TEMPLATE, IMAGE) == 0


def test_scale_of_the_matrix_does_not_matter() -> None:
    assert corner_error(shift(53, 44) * 0.01, shift(50, 40) * 7, TEMPLATE, IMAGE) == pytest.approx(5)


def test_scaling_about_the_first_corner() -> None:
    # Twice the size about (-0.5, -0.5): the corners move by 0, 100, hypot(100, 60) and 60 px.
    truth = shift(100, 100)
    estimate = truth @ np.array([[2, 0, 0.5], [0, 2, 0.5], [0, 0, 1]])
    assert corner_error(estimate, truth, TEMPLATE, IMAGE) == pytest.approx((100 + math.hypot(100, 60) + 60) / 4)


def test_partly_visible_target_is_judged_inside_the_image() -> None:
    # The truth starts 30 px left of the image: of the grid's columns, 12.5 px apart from -30.5, six lie at -0.5 or
    # beyond: the third is at -5.5, the fourth at 7. A stretch by 1 % along x about template x = -0.5.
    truth = shift(-30, 100)
    stretch = np.array([[1.01, 0, 0.005], [0, 1, 0], [0, 0, 1]])
    expected = np.mean([0.01 * 12.5 * k for k in range(3, 9)])
    assert corner_error(truth @ stretch, truth, TEMPLATE, IMAGE) == pytest.approx(expected)


def test_corner_exactly_on_the_image_border_is_inside() -> None:
    # Outer corner to outer corner: 100 x 60 template in a 100 x 60 image.
    estimate = np.array([[1.02, 0, 0.01], [0, 1, 0], [0, 0, 1]])
    assert corner_error(estimate, np.eye(3), TEMPLATE, (100, 60)) == pytest.approx((0 + 2 + 2 + 0) / 4)


def test_horizon_through_the_target_is_infinitely_wrong() -> None:
    estimate = np.array([[1.0, 0, 0], [0, 1, 0], [-0.05, 0, 1]])
    assert corner_error(estimate, shift(50, 40), TEMPLATE, IMAGE) == math.inf


def test_invisible_target_is_refused() -> None:
    with pytest.raises(ShapeError, match="no point inside"):
        corner_error(np.eye(3), shift(1000, 0), TEMPLATE, IMAGE)
    with pytest.raises(ShapeError, match="no point inside"):
        corner_error(np.eye(3), -shift(50, 40), TEMPLATE, IMAGE)


def test_matrices_of_another_shape_are_refused() -> None:
    with pytest.raises(ShapeError, match="H_estimate"):
        corner_error(np.eye(4), np.eye(3), TEMPLATE, IMAGE)
    with pytest.raises(ShapeError, match="H_truth"):
        corner_error(np.eye(3), np.full((3, 3), np.nan), TEMPLATE, IMAGE)


def test_distorted_camera_decides_what_is_visible() -> None:
    # Equidistant lenses pull the periphery in: ideal pixels outside the frame are seen.
    model = DistortionModel.EQUIDISTANT
    camera = default_camera(640, 480, model, TYPICAL_LENSES[model])
    truth = shift(-40, 200)
    first = camera.raw_pixels(np.array([[-40.5, 199.5]]))[0]
    assert first[0] > 0
    estimate = truth @ np.array([[1.1, 0, 0.05], [0, 1, 0], [0, 0, 1]])
    assert corner_error(estimate, truth, TEMPLATE, IMAGE, camera) == pytest.approx(5)
    assert corner_error(estimate, truth, TEMPLATE, IMAGE) > 5


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32), stamp=st.integers(0, 2**62))
def test_truth_file_round_trips(tmp_path_factory: pytest.TempPathFactory, seed: int, stamp: int) -> None:
    rng = np.random.default_rng(seed)
    H = rng.normal(size=(3, 3))
    R = rotation_about(rng.normal(size=3), rng.uniform(-math.pi, math.pi))
    truths = [
        Truth(stamp, "poster", H / np.linalg.norm(H), RigidTransform(R, rng.normal(size=3))),
        Truth(stamp + 1, "shelf_2", H, None),
    ]
    path = tmp_path_factory.mktemp("truth") / "truth.csv"
    write_truth(path, truths)
    got = read_truth(path)
    assert [(t.stamp_ns, t.target) for t in got] == [(stamp, "poster"), (stamp + 1, "shelf_2")]
    np.testing.assert_array_equal(got[0].H, truths[0].H)
    assert got[0].pose is not None
    assert got[1].pose is None
    np.testing.assert_array_equal(got[0].pose.t, truths[0].pose.t)  # type: ignore[union-attr]
    np.testing.assert_allclose(got[0].pose.R, R, atol=1e-14)
    assert float(path.read_text().splitlines()[1].split(",")[-1]) >= 0  # qw


def test_frames_csv_is_a_truth_file_too(tmp_path: Path) -> None:
    path = tmp_path / "frames.csv"
    columns = ["extra", *COLUMNS, "more"]
    found = ["x", "5", "a", *(["1.0"] * 9), *(["0.0"] * 6), "1.0", "y"]
    lost = ["x", "6", "a", *([""] * 16), "y"]
    path.write_text("\n".join(",".join(row) for row in (columns, found, lost)))
    (truth,) = read_truth(path)
    assert truth.stamp_ns == 5
    np.testing.assert_array_equal(truth.pose.R, np.eye(3))  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"a,b\n1,2\n", "no column stamp_ns"),
        (b"", "no column stamp_ns"),
        (b"\xff\xfe\x00", "need a readable truth file"),
        ((",".join(COLUMNS) + "\n1,a," + ",".join(["x"] * 16)).encode(), ":2: could not convert"),
        ((",".join(COLUMNS) + "\n1,a," + ",".join(["nan"] * 16)).encode(), "need finite numbers"),
        ((",".join(COLUMNS) + "\n1,a,1.0,2.0").encode(), "need finite numbers"),
        ((",".join(COLUMNS) + "\nz,a," + ",".join(["1"] * 16)).encode(), "need finite numbers"),
    ],
)
def test_bad_truth_files_are_refused(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "truth.csv"
    path.write_bytes(content)
    with pytest.raises(FileError, match=message) as caught:
        read_truth(path)
    assert "\n" not in str(caught.value)


def test_missing_truth_file_and_unwritable_place_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="need a readable truth file"):
        read_truth(tmp_path / "none.csv")
    with pytest.raises(FileError, match="need a file that can be written"):
        write_truth(tmp_path / "no" / "truth.csv", [])


def test_normalised_squared_errors_are_chi_squared() -> None:
    generator = np.random.default_rng(5)
    root = generator.normal(size=(6, 6)) * [1e-3, 1e-3, 5e-3, 1e-3, 2e-3, 1e-4]
    covariance = root @ root.T
    truth = RigidTransform(exp_so3([0.3, -0.2, 0.1]), np.array([0.1, 0.2, 1.5]))
    squared = []
    for _ in range(2000):
        delta = root @ generator.normal(size=6)
        estimate = RigidTransform(exp_so3(-delta[3:]) @ truth.R, truth.t - delta[:3])
        squared.append(normalised_squared_error(truth, estimate, covariance))
    assert np.mean(squared) == pytest.approx(6, abs=0.4)
    assert np.median(squared) == pytest.approx(NEES_MEDIAN, abs=0.4)
    assert np.mean(np.array(squared) < NEES_95) == pytest.approx(0.95, abs=0.02)
    assert chi2(6).ppf([0.5, 0.95]) == pytest.approx([NEES_MEDIAN, NEES_95], abs=0.005)
    assert normalised_squared_error(truth, truth, np.zeros((6, 6))) is None
