# SPDX-License-Identifier: Apache-2.0
"""Both kinds of messages: every test that makes messages runs on rclpy's classes and on rosbags'."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imgu_ros.config.parameters import DemosaicParameters, RawParameters
from imgu_ros.frame import Frame
from imgu_ros.image.frame_image import develop
from imgu_ros.result import PoseStatus, ReferenceMatches, ReferenceResult, Result, Stage, Status, by_name
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage
from imgu_ros.vision.keypoints.keypoints import Keypoints
from imgu_ros.vision.matching.matches import Matches
from imgu_ros.vision.projective.homography import HomographyEstimate
from imgu_ros.vision.scale_space.pyramid import Level, Pyramid


def make_pose(seed: int, sigma: float = 0.01) -> Pose:
    root = np.random.default_rng(seed).normal(size=(6, 6)) * sigma
    return Pose(Rotation.random(random_state=seed).as_matrix(), np.array([0.1, -0.2, 1.5 + seed]), root @ root.T, 0.2)


@pytest.fixture
def result() -> Result:
    """A frame with three targets: poster with a pose, box lost with matches, floor detected without a size."""
    generator = np.random.default_rng(5)
    mosaic = generator.integers(0, 65536, (24, 32), np.uint16)
    image = RawImage(mosaic, PixelLayout(ColorModel.BAYER, BayerPattern.RGGB))
    keypoints = Keypoints(
        generator.uniform(0, 30, (6, 2)),
        generator.uniform(1, 4, 6),
        generator.uniform(-3, 3, 6),
        generator.uniform(0, 1, 6),
        np.arange(6, dtype=np.int32),
    )

    def matches(count: int) -> ReferenceMatches:
        rows = np.arange(count)
        xy = generator.uniform(0, 30, (2, count, 2))
        return ReferenceMatches(Matches(rows, rows, rows / 8.0), xy[0], xy[1], rows % 2 == 0)

    def homography(count: int) -> HomographyEstimate:
        H = generator.normal(size=(3, 3))
        return HomographyEstimate(H, generator.normal(size=(9, 9)), np.arange(count) > 1, 0.375, 10)

    outline = np.array([[1.5, 2.0], [20, 2], [20, 15], [1, 15]])
    poster = ReferenceResult(
        "poster", 0, Status.TRACKED, PoseStatus.METRIC, "", matches(5), homography(5), outline, make_pose(0), (), 0.25
    )
    box = ReferenceResult("box", 1, Status.LOST, reason="no consensus among 3 matches", matches=matches(3))
    floor = ReferenceResult(
        "floor", 2, Status.DETECTED, PoseStatus.NO_SIZE, matches=matches(4), homography=homography(4), outline=outline
    )
    return Result(
        frame=Frame(image, 10_250_000_000, "camera", None),
        references=by_name((poster, box, floor)),
        developed=develop(image, RawParameters(), DemosaicParameters()),
        pyramid=Pyramid((Level(mosaic.astype(np.float32), 1.0), Level(np.zeros((12, 16), np.uint8), 2.0))),
        keypoints=keypoints,
        descriptors=generator.integers(0, 256, (6, 32), np.uint8),
        times_ns={Stage.DEVELOP: 1_500_000, Stage.MATCH: 250_000},
        total_ns=2_000_000,
    )
