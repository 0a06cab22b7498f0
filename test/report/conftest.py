# SPDX-License-Identifier: Apache-2.0
"""Results with exactly known content, made without the estimator."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from imgu_ros.config.parameters import Parameters
from imgu_ros.frame import Frame
from imgu_ros.image.frame_image import develop
from imgu_ros.result import PoseStatus, ReferenceMatches, ReferenceResult, Result, Stage, Status, by_name
from imgu_ros.simulate.geometry import image_from_template, target_from_template
from imgu_ros.vision.camera.intrinsics import make_camera
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage
from imgu_ros.vision.keypoints.keypoints import Keypoints
from imgu_ros.vision.matching.matches import Matches
from imgu_ros.vision.projective.homography import HomographyEstimate

TEMPLATE_SIZE = (400, 300)
WIDTH_M = 0.4


def _result(
    index: int = 0,
    *,
    size: tuple[int, int] = (640, 480),
    status: Status = Status.DETECTED,
    pose_status: PoseStatus = PoseStatus.METRIC,
    distortion: tuple[float, ...] = (),
    dtype: str = "uint8",
    names: tuple[str, ...] = ("poster",),
    reason: str = "",
) -> Result:
    width, height = size
    camera = make_camera(
        [[0.8 * width, 0, width / 2], [0, 0.8 * width, height / 2], [0, 0, 1]], distortion, "plumb_bob", width, height
    )
    top = np.iinfo(dtype).max
    ramp = np.linspace(0.2 * top, 0.6 * top, width).astype(dtype)
    image = RawImage(np.broadcast_to(ramp, (height, width)), PixelLayout(ColorModel.MONO))
    frame = Frame(image, 10**18 + index * 50_000_000, "camera", camera)
    if status is Status.REJECTED:
        targets = tuple(ReferenceResult(name, i, status, reason=reason) for i, name in enumerate(names))
        return Result(frame, by_name(targets), reason=reason)
    targets = tuple(_target(name, i, index, frame, status, pose_status, reason) for i, name in enumerate(names))
    parameters = Parameters()
    none = np.zeros(7)
    return Result(
        frame,
        by_name(targets),
        developed=develop(image, parameters.raw, parameters.demosaic),
        keypoints=Keypoints(np.zeros((7, 2)), none, none, none, none.astype(np.int32)),
        times_ns={stage: 1_000_000 * (i + 1) + index for i, stage in enumerate(Stage)},
        total_ns=40_000_000 + index,
    )


def _target(
    name: str, place: int, index: int, frame: Frame, status: Status, pose_status: PoseStatus, reason: str
) -> ReferenceResult:
    if not status.found:
        return ReferenceResult(name, place, status, reason=reason)
    angle = 0.3 + 0.01 * index
    R = np.array([[1, 0, 0], [0, -1, 0], [0, 0, -1.0]])
    tilt = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    pose = Pose(tilt @ R, np.array([0.02 * index - 0.1, 0.01 + 0.1 * place, 0.9]), np.diag([1e-6] * 6), 0.3)
    assert frame.camera is not None
    template = target_from_template(TEMPLATE_SIZE, WIDTH_M)
    H = image_from_template(frame.camera.K, pose.transform, template)
    w, h = TEMPLATE_SIZE
    corners = np.array([[-0.5, -0.5], [w - 0.5, -0.5], [w - 0.5, h - 0.5], [-0.5, h - 0.5]])
    inside = np.random.default_rng(0).uniform((0, 0), TEMPLATE_SIZE, (40, 2))

    def raw(points: np.ndarray) -> np.ndarray:
        x = np.column_stack((points, np.ones(len(points)))) @ H.T
        return frame.camera.raw_pixels(x[:, :2] / x[:, 2:])

    matches = Matches(np.arange(40), np.arange(40), np.linspace(10, 60, 40))
    inliers = np.arange(40) < 30
    return ReferenceResult(
        name,
        place,
        status,
        pose_status,
        reason,
        ReferenceMatches(matches, inside, raw(inside), inliers),
        HomographyEstimate(H, np.eye(9) * 1e-9, inliers, 0.31, 100),
        raw(corners),
        pose if pose_status is PoseStatus.METRIC else None,
        (pose, pose),
        0.25,
    )


@pytest.fixture(scope="session")
def make_result() -> Callable[..., Result]:
    return _result
