# SPDX-License-Identifier: Apache-2.0
"""The results bag: the camera in the map, when the targets' places in it are given."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from imgu_ros.config.components import OutputParameters
from imgu_ros.config.values import parameters_from
from imgu_ros.frame import Frame
from imgu_ros.image.frame_image import develop
from imgu_ros.replay.results_bag import ResultsBag
from imgu_ros.result import PoseStatus, ReferenceResult, Result, Status, by_name
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage

SECOND = 1_000_000_000
PLACE = RigidTransform(Rotation.random(random_state=1).as_matrix(), np.array([2.0, 1.0, 0.5]))
CAMERA = RigidTransform(Rotation.random(random_state=2).as_matrix(), np.array([0.3, -0.2, 1.0]))


def test_the_camera_in_the_map(tmp_path: Path) -> None:
    parameters = parameters_from({
        "targets.images": ["a.png"], "targets.widths_m": [0.5], "frames.map": "hall", "frames.camera": "lens",
        "targets.poses": [float(value) for value in PLACE.numbers()],
    })  # fmt: skip
    image = RawImage(np.zeros((4, 6), np.uint8), PixelLayout(ColorModel.MONO))
    seen = CAMERA.inverse().after(PLACE)
    pose = Pose(seen.R, seen.t, np.eye(6) * 1e-6, 0.1)
    with closing(ResultsBag(tmp_path / "results", OutputParameters.of(parameters), ["a"], ["path"])) as bag:
        for n, status in enumerate((Status.DETECTED, Status.LOST, Status.TRACKED)):
            given = pose if status.found else None
            target = ReferenceResult("a", 0, status, PoseStatus.METRIC if given else PoseStatus.NONE, pose=given)
            frame = Frame(image, (n + 1) * SECOND, "", None)
            developed = develop(image, parameters.raw, parameters.demosaic)
            bag.write(Result(frame, by_name((target,)), developed=developed, times_ns={}), frame.stamp_ns)
    with AnyReader([tmp_path / "results"], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        found = [(c.topic, time, reader.deserialize(data, c.msgtype)) for c, time, data in reader.messages()]
    odometry = [(time, message) for topic, time, message in found if topic == "/map/odom"]
    assert [time for time, _ in odometry] == [SECOND, 3 * SECOND]
    message = odometry[0][1]
    assert (message.header.frame_id, message.child_frame_id) == ("hall", "lens")
    position, turn = message.pose.pose.position, message.pose.pose.orientation
    np.testing.assert_allclose([position.x, position.y, position.z], CAMERA.t, atol=1e-9)
    np.testing.assert_allclose(Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix(), CAMERA.R, atol=1e-9)
    assert [len(m.poses) for topic, _, m in found if topic == "/map/path"] == [1, 2]
    assert {m.header.frame_id for topic, _, m in found if topic == "/pose"} == {"lens"}
