# SPDX-License-Identifier: Apache-2.0
"""Views as prescribed: size, tilt, what is cut off; and smooth."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imgu_ros.errors import ShapeError
from imgu_ros.reference.templates import TargetImage
from imgu_ros.simulate.geometry import image_from_template
from imgu_ros.simulate.path import CameraMotion, camera_from_scene_at
from imgu_ros.simulate.placing import Placing, camera_before_target, outside_share
from imgu_ros.simulate.scene import arrange_scene, template_matrix
from imgu_ros.simulate.sequence import default_camera

CAMERA = default_camera(1280, 720)
SCENE = arrange_scene([TargetImage("t", np.zeros((96, 128, 3), np.uint8), 0.5)])


def poses(placing: Placing, seed: int = 0, count: int = 13):
    return [camera_before_target(p, placing, CAMERA, SCENE, seed) for p in np.linspace(0, 1, count)]


def tilt_deg(pose) -> float:
    centre = pose.inverse().t
    return math.degrees(math.acos(centre[2] / np.linalg.norm(centre)))


def test_nothing_prescribed_is_the_path() -> None:
    for p in (0.0, 0.3, 1.0):
        a = camera_before_target(p, Placing(), CAMERA, SCENE, 7)
        b = camera_from_scene_at(p, CameraMotion(), CAMERA, SCENE.radius_m, 7)
        np.testing.assert_array_equal(a.R, b.R)
        np.testing.assert_array_equal(a.t, b.t)


@pytest.mark.parametrize("tilt", [0.0, 20.0, 70.0])
def test_tilt_is_kept(tilt: float) -> None:
    found = poses(Placing(tilt_rad=math.radians(tilt)))
    assert [tilt_deg(p) for p in found] == pytest.approx([tilt] * len(found), abs=1e-4)
    distances = [np.linalg.norm(p.t) for p in poses(Placing(tilt_rad=0.0), count=200)]
    assert max(distances) / min(distances) == pytest.approx(2.4, rel=0.01)


@pytest.mark.parametrize("share", [0.1, 1.0, 3.0])
def test_width_is_kept_and_the_target_stays_before_the_camera(share: float) -> None:
    for seed in range(4):
        for pose in poses(Placing(width_share=share), seed):
            distance = np.linalg.norm(pose.t)
            assert CAMERA.K[0, 0] * 0.5 / distance == pytest.approx(share * 1280)
            corners = np.array([[x, y, 0.0] for x in (-0.25, 0.25) for y in (-0.1875, 0.1875)])
            assert (pose.R @ corners.T)[2].min() + pose.t[2] > 0.2 * distance


@pytest.mark.parametrize("outside", [0.3, 0.5])
def test_share_is_outside_as_counted_in_a_picture(outside: float) -> None:
    for pose in poses(Placing(outside=outside), seed=2, count=6):
        assert outside_share(pose, CAMERA, SCENE) == pytest.approx(outside, abs=0.02)
        # Independently: every point of the target, projected.
        H = image_from_template(CAMERA.K, pose, template_matrix(SCENE.targets[0]))
        u, v = np.meshgrid(np.linspace(-0.5, 127.5, 301), np.linspace(-0.5, 95.5, 301))
        xyw = np.stack((u, v, np.ones_like(u)), -1) @ H.T
        x, y = xyw[..., 0] / xyw[..., 2], xyw[..., 1] / xyw[..., 2]
        shown = (xyw[..., 2] > 0) & (x > -0.5) & (x < 1279.5) & (y > -0.5) & (y < 719.5)
        assert 1 - shown.mean() == pytest.approx(outside, abs=0.03)


@pytest.mark.parametrize(
    "placing", [Placing(outside=0.4), Placing(tilt_rad=1.0), Placing(width_share=2.0)], ids=["outside", "tilt", "width"]
)
def test_paths_are_smooth(placing: Placing) -> None:
    found = poses(placing, seed=1, count=121)
    steps = [np.linalg.norm(a.R @ b.R.T - np.eye(3)) for a, b in zip(found[1:], found[:-1], strict=True)]
    assert max(steps) < 0.35
    assert max(np.linalg.norm(a.t - b.t) for a, b in zip(found[1:], found[:-1], strict=True)) < 0.08


def test_what_cannot_be_met_is_refused() -> None:
    with pytest.raises(ShapeError, match="outside"):
        camera_before_target(0.0, Placing(outside=0.05, width_share=3.0), CAMERA, SCENE, 0)
