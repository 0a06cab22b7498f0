# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from imgu_ros.report.accuracy import TruthComparison, camera_position
from imgu_ros.simulate.geometry import image_from_template, rotation_about, target_from_template
from imgu_ros.simulate.truth import Truth
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.camera.rotation import quaternion

K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
POSE = RigidTransform(np.diag([1.0, -1, -1]), np.array([0.0, 0, 2]))
H = image_from_template(K, POSE, target_from_template((400, 300), 0.4))


def compare(R: np.ndarray, t: np.ndarray, covariance: np.ndarray, H_estimate: np.ndarray = H):
    comparison = TruthComparison([Truth(5, "poster", H, POSE)], {"poster": (400, 300)}, (640, 480), None)
    return comparison.errors(5, "poster", H_estimate, np.concatenate((t, quaternion(R))), covariance)


def test_no_error() -> None:
    errors = compare(POSE.R, POSE.t, np.eye(6))
    assert errors.corner_px == 0
    assert errors.rotation_deg == pytest.approx(0, abs=1e-9)
    assert errors.translation_percent == 0
    assert errors.nees == pytest.approx(0, abs=1e-20)
    assert np.allclose(errors.true_position, [0, 0, 2])


def test_known_errors() -> None:
    R = rotation_about(np.array([0, 0, 1.0]), np.deg2rad(3)) @ POSE.R
    shift = np.array([[1.0, 0, 3], [0, 1, 4], [0, 0, 1]])
    covariance = np.diag([0.01, 1, 1, 1, 1, np.deg2rad(1)]) ** 2
    errors = compare(R, POSE.t + [0.02, 0, 0], covariance, shift @ H)
    assert errors.corner_px == pytest.approx(5)
    assert errors.rotation_deg == pytest.approx(3)
    assert errors.translation_percent == pytest.approx(1)
    # Two standard deviations in x, three about z.
    assert errors.nees == pytest.approx(13)


def test_no_truth_for_this_stamp_or_target() -> None:
    comparison = TruthComparison([Truth(5, "poster", H, POSE)], {"poster": (400, 300)}, (640, 480), None)
    for stamp, name in ((6, "poster"), (5, "other")):
        errors = comparison.errors(stamp, name, H, None, None)
        assert errors.corner_px is errors.true_position is None
    assert comparison.compared == 0


def test_lost_target_keeps_the_true_position() -> None:
    comparison = TruthComparison([Truth(5, "poster", H, POSE)], {"poster": (400, 300)}, (640, 480), None)
    errors = comparison.errors(5, "poster", None, None, None)
    assert errors.corner_px is errors.rotation_deg is errors.nees is None
    assert np.allclose(errors.true_position, [0, 0, 2])


def test_beyond_the_horizon_is_bounded_and_a_useless_covariance_has_no_nees() -> None:
    errors = compare(POSE.R, POSE.t, np.zeros((6, 6)), H @ np.array([[1, 0, 0], [0, 1, 0], [-0.01, 0, 1.0]]))
    assert errors.corner_px == 1e4
    assert errors.nees is None


def test_camera_position_inverts_the_pose() -> None:
    R = rotation_about(np.array([1.0, 2, 3]), 1.0)
    camera = np.array([0.3, -0.2, 1.5])
    assert np.allclose(camera_position(np.concatenate((-R @ camera, quaternion(R)))), camera)
