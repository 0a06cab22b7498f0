# SPDX-License-Identifier: Apache-2.0
"""Two hundred camera_info messages and more, with images: a pose, a homography and why, or a rejection and why."""

from __future__ import annotations

import importlib.util
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imgu_ros.config.parameters import Parameters, RawParameters
from imgu_ros.errors import EncodingError
from imgu_ros.localizer import Localizer
from imgu_ros.messages.frame import decode_frame
from imgu_ros.messages.header import Header
from imgu_ros.messages.image import image_message
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.result import PoseStatus
from imgu_ros.simulate.texture import procedural_texture

_SPEC = importlib.util.spec_from_file_location("camera_info_cases", Path(__file__).with_name("camera_info_cases.py"))
assert _SPEC is not None and _SPEC.loader is not None
drawn = importlib.util.module_from_spec(_SPEC)
sys.modules["camera_info_cases"] = drawn
_SPEC.loader.exec_module(drawn)
CASES = drawn.cases()
WIDTH_M = drawn.WIDTH_M

#: Pixels of error that a pose may cause at the target's corners, and of the outline of a homography.
POSE_PX, OUTLINE_PX = 0.35, 3.0
#: Share of the distance.
POSITION = 0.006


@pytest.fixture(scope="module")
def texture() -> np.ndarray:
    return procedural_texture(*drawn.TEXTURE, seed=4)[..., 1].copy()


@pytest.fixture(scope="module")
def chain(texture: np.ndarray) -> Localizer:
    parameters = Parameters(raw=RawParameters(transfer="srgb"))
    return Localizer(parameters, prepare_references([TargetImage("poster", texture, WIDTH_M)], parameters))


def test_there_are_two_hundred() -> None:
    counts = Counter(case.outcome for case in CASES)
    assert sum(counts.values()) >= 200
    assert counts["pose"] >= 80
    assert counts["homography"] >= 80
    assert len({case.name for case in CASES if case.outcome != "rejected"}) == counts["pose"] + counts["homography"]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_message(case: Any, chain: Localizer, texture: np.ndarray) -> None:
    from imgu_ros.bags.messages import make_message

    require_outcome(make_message, case, chain, texture)


@pytest.mark.parametrize("case", CASES[::5], ids=lambda case: case.name)
def test_message_of_rclpy(case: Any, chain: Localizer, texture: np.ndarray) -> None:
    """Its classes differ in nothing but how they hold their fields: a part is enough."""
    pytest.importorskip("sensor_msgs.msg", reason="the `ros` extra is not installed")
    from imgu_ros.ros.messages import make_message

    require_outcome(make_message, case, chain, texture)


def require_outcome(make: Any, case: Any, chain: Localizer, texture: np.ndarray) -> None:
    pixels = drawn.rendered(case, texture)
    image = image_message(make, Header(1, "camera"), pixels, "mono8")
    for name, value in case.image.items():
        setattr(image, name, value)
    roi = make("sensor_msgs/msg/RegionOfInterest", **case.fields["roi"])
    info = make("sensor_msgs/msg/CameraInfo", **(case.fields | {"roi": roi}))

    if case.outcome == "rejected":
        with pytest.raises(EncodingError) as error:
            decode_frame(image, info, rectified=case.rectified)
        assert "camera_info" not in str(error.value)
        return
    frame = decode_frame(image, info, rectified=case.rectified)
    chain.reset()
    result = chain.process(frame)
    assert result.reason == ""
    (found,) = result
    assert found.status.found, found.reason
    assert found.homography is not None
    R, t = case.pose
    corners = np.array([(x * WIDTH_M / 2, y * WIDTH_M * 3 / 8, 0) for x, y in ((-1, 1), (1, 1), (1, -1), (-1, -1))])
    seen = case.truth.project(corners @ R.T + t)
    if case.outcome == "homography":
        assert (found.pose, found.pose_status) == (None, PoseStatus.UNCALIBRATED)
        assert found.reason == frame.camera_reason
        assert found.reason.startswith("camera_info: ")
        assert case.says in found.reason
        assert "\n" not in found.reason
        assert len(found.reason) < 500
        np.testing.assert_allclose(found.outline, seen, atol=OUTLINE_PX)
        return
    assert (found.pose_status, found.reason) == (PoseStatus.METRIC, "")
    assert found.pose is not None
    again = case.truth.project(corners @ found.pose.R.T + found.pose.t)
    np.testing.assert_allclose(again, seen, atol=POSE_PX)
    assert np.linalg.norm(found.pose.t - t) < POSITION * np.linalg.norm(t)
    remarks = " ".join(frame.camera_remarks)
    assert (case.remark in remarks) if case.remark else len(frame.camera_remarks) <= 1
