# SPDX-License-Identifier: Apache-2.0
"""Of a target that is mostly covered, patches must agree: a part alone does not tell where the rest is."""

from __future__ import annotations

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from imgu_ros.config.values import parameters_from
from imgu_ros.detect import robust_fit
from imgu_ros.errors import NotConfirmed
from imgu_ros.frame import Frame
from imgu_ros.localizer import Localizer
from imgu_ros.pose.planar_pose import Located
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.simulate.sequence import default_camera
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.track.sample_refinement import PatchAlignment
from imgu_ros.types import Matrix3
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage
from imgu_ros.vision.projective.homography import HomographyEstimate
from imgu_ros.vision.projective.transform import transform

SIZE = (480, 360)
COVERED, LESS_COVERED = SimpleNamespace(share=0.4), SimpleNamespace(share=0.6)


def place() -> Matrix3:
    corners = np.array([[0, 0], [480, 0], [480, 360], [0, 360]], np.float32)
    return cv2.getPerspectiveTransform(corners, np.array([[130, 90], [520, 70], [540, 380], [110, 400]], np.float32))


def shown(picture: np.ndarray, visible: float) -> Frame:
    """A frame of a picture whose left part alone is visible; the rest is behind something dark and smooth."""
    covered = picture.copy()
    covered[:, round(visible * SIZE[0]) :] = 40
    scene = cv2.warpPerspective(covered, place(), (640, 480), flags=cv2.INTER_AREA, borderValue=(128, 128, 128))
    noise = np.random.default_rng(3).normal(0, 1.5, scene.shape)
    pixels = np.clip(np.rint(cv2.GaussianBlur(scene, (0, 0), 0.6) + noise), 0, 255).astype(np.uint8)
    return Frame(RawImage(pixels, PixelLayout(ColorModel.RGB)), 10**9, "camera", default_camera(640, 480))


@pytest.fixture(scope="module")
def picture() -> np.ndarray:
    return procedural_texture(*SIZE, 21)


@pytest.mark.parametrize(("visible", "is_found"), [(1.0, True), (0.6, True), (0.33, False), (0.1, False)])
def test_how_much_is_visible_decides(picture: np.ndarray, visible: float, is_found: bool) -> None:
    parameters = parameters_from({"tracking.enabled": False})
    localizer = Localizer(parameters, prepare_references([TargetImage("poster", picture, 0.3)], parameters))
    result = localizer.process(shown(picture, visible)).first
    assert result.status.found == is_found, result.reason
    if is_found:
        corners = [[-0.5, -0.5], [479.5, -0.5], [479.5, 359.5], [-0.5, 359.5]]
        away = transform(result.homography.H, corners) - transform(place(), corners)
        assert np.hypot(*away.T).max() < 3


def test_keypoints_alone_do_not_tell_where_a_covered_target_is() -> None:
    keypoints = Located.__new__(Located)
    with pytest.raises(NotConfirmed, match="40% of what is in view looks as it should, and 0% of the patches agree"):
        robust_fit._require_agreeing(keypoints, COVERED)


def aligned(agreeing: float, rms_px: float) -> PatchAlignment:
    estimate = HomographyEstimate(np.eye(3), np.eye(9), np.ones(8, bool), rms_px, 0)
    xy = np.zeros((8, 2))
    return PatchAlignment(xy, xy, estimate, sought=20, agreeing_share=agreeing)


@pytest.mark.parametrize(
    ("agreeing", "rms_px", "words"),
    [(0.34, 0.02, "34% of the patches agree"), (0.38, 0.02, ""), (0.9, 0.14, ""), (0.9, 0.19, "agree to 0.19 px")],
)
def test_patches_that_agree(agreeing: float, rms_px: float, words: str) -> None:
    if not words:
        robust_fit._require_agreeing(aligned(agreeing, rms_px), COVERED)
        return
    with pytest.raises(NotConfirmed, match=words) as caught:
        robust_fit._require_agreeing(aligned(agreeing, rms_px), COVERED)
    assert caught.value.share == 0.4


def test_patches_of_what_is_mostly_in_view_may_agree_less_well() -> None:
    robust_fit._require_agreeing(aligned(0.5, 0.3), LESS_COVERED)
