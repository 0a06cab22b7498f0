# SPDX-License-Identifier: Apache-2.0
"""A camera_info that does not fit what is seen, live: said once in the log, in /diagnostics, and the same numbers as
offline."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from imgu_ros.config.parameters import Parameters
from imgu_ros.frame import Frame
from imgu_ros.localizer import Localizer
from imgu_ros.messages.geometry import pose_message
from imgu_ros.messages.results import result_header
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.simulate.placing import Placing, camera_before_target
from imgu_ros.simulate.render import Renderer
from imgu_ros.simulate.scene import arrange_scene
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.vision.camera.intrinsics import make_camera as camera_of
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage
from imgu_ros.vision.formation.sensor import Sensor, expose

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
STATUS = "diagnostic_msgs/msg/DiagnosticArray"


@pytest.fixture(scope="module")
def oblique(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Frame]]:
    """A target's picture, and ten frames of it under 35 degrees by a camera whose focal length is said 4 % too long."""
    layout = PixelLayout(ColorModel.BAYER, BayerPattern.RGGB)
    camera = camera_of([[450, 0, 245], [0, 450, 176], [0, 0, 1]], (), "plumb_bob", 480, 360)
    target = TargetImage("poster", procedural_texture(640, 480, seed=21), 0.5)
    path = tmp_path_factory.mktemp("oblique") / "poster.png"
    cv2.imwrite(str(path), target.pixels[:, :, ::-1])
    renderer, frames = Renderer(arrange_scene([target]), camera, layout), []
    given = replace(camera, K=camera.K * [[1.04, 1, 1], [1, 1.04, 1], [1, 1, 1]])
    for index in range(10):
        placing = Placing(tilt_rad=math.radians(35), width_share=0.5)
        pose = camera_before_target(2 * index / 119, placing, camera, renderer.scene, 4)
        pixels = expose(renderer.radiance(pose) * np.float32(0.9), Sensor(), np.random.default_rng(index))
        frames.append(Frame(RawImage(pixels, layout), 1_000_000_000 + index * 33_333_333, "camera", given))
    return path, frames


def test_it_is_said_once_and_goes_into_the_covariance(oblique: Any, imgu: Any, peer: Any, make_camera: Any) -> None:
    path, frames = oblique
    parameters = Parameters()
    chain = Localizer(
        parameters, prepare_references([TargetImage("poster", cv2.imread(str(path))[:, :, ::-1], 0.5)], parameters)
    )
    results = [chain.process(frame) for frame in frames]
    assert results[-1].calibration is not None and results[-1].calibration.is_focal

    node = imgu(
        "node", "perception", "-p", f"targets.images:=[{path}]", "-p", "targets.widths_m:=[0.5]",
        "-r", "image_raw:=/cam/image_raw",
    )  # fmt: skip
    peer.hear("/pose", POSE)
    peer.hear("/diagnostics", STATUS)
    camera = make_camera(peer)
    camera.wait_for_node()
    from imgu_ros.ros.messages import make_message

    for count, (frame, result) in enumerate(zip(frames, results, strict=True), 1):
        camera.send(frame)
        peer.wait(lambda n=count: len(peer.heard["/pose"]) == n, f"pose {count}")
        assert peer.heard["/pose"][-1] == pose_message(make_message, result_header(result), result.first.pose)
    node.wait_for_line("camera_info does not fit what is seen (focal length about ")
    seen = len(peer.heard["/diagnostics"])
    peer.wait(lambda: len(peer.heard["/diagnostics"]) > seen + 1, "/diagnostics")
    entry = next(s for s in peer.heard["/diagnostics"][-1].status if s.name.endswith("camera"))
    assert entry.message.startswith("camera_info does not fit what is seen (focal length about ")
    values = {v.key: v.value for v in entry.values}
    assert float(values["focal_error_percent"]) == pytest.approx(4, abs=0.4)
    assert int(values["calibration_views"]) == results[-1].calibration.views
    assert node.text.count("camera_info does not fit what is seen") == 1
