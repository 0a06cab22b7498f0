# SPDX-License-Identifier: Apache-2.0
"""A new output topic that keeps state from frame to frame and has a parameter: one function and one row.

The example is the camera's position in a target's frame, smoothed over time. CONTRIBUTING.md describes the steps.
"""

from __future__ import annotations

import math
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from imgu_ros.config.components import OutputParameters
from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.frame import Frame
from imgu_ros.messages import results
from imgu_ros.messages.factory import MessageFactory
from imgu_ros.messages.header import Header, header_message
from imgu_ros.messages.output_topic import OutputContext, OutputTopic, Scope
from imgu_ros.replay.results_bag import ResultsBag, checked_record
from imgu_ros.result import PoseStatus, ReferenceResult, Result, Status, by_name
from imgu_ros.types import Floats
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage

SECOND = 1_000_000_000


# ---- What a contributor writes -------------------------------------------------------------------------------------


class SmoothedPosition:
    """A position, low-pass filtered over the frames' stamps."""

    def __init__(self, make: MessageFactory) -> None:
        self._position: Floats | None = None
        self._last_ns = 0

    def add(self, stamp_ns: int, position: Floats, time_constant_s: float) -> Floats:
        """Return the filtered position, (3,) m, after one more measurement of it."""
        passed_s = (stamp_ns - self._last_ns) / SECOND
        weight = 1.0 if self._position is None else -math.expm1(-passed_s / time_constant_s)
        before = position if self._position is None else self._position
        self._position, self._last_ns = before + weight * (position - before), stamp_ns
        return self._position


def smoothed_position(context: OutputContext) -> Any | None:
    """Return the camera's smoothed position in the target's frame."""
    frame, pose = context.frame, context.found.pose
    if pose is None:
        return None
    # A parameter in force is read here; an output of the package would declare its own in config/parameters.py.
    time_constant_s = frame.parameters.path.max_length / 1000
    position = context.state.add(frame.header.stamp_ns, pose.inverse().t, time_constant_s)
    x, y, z = (float(value) for value in position)
    header = header_message(frame.make, Header(frame.header.stamp_ns, context.target_frame))
    point = frame.make("geometry_msgs/msg/Point", x=x, y=y, z=z)
    return frame.make("geometry_msgs/msg/PointStamped", header=header, point=point)


ROW = OutputTopic(
    "smoothed_position", "geometry_msgs/msg/PointStamped", smoothed_position, Scope.TARGET, state=SmoothedPosition
)


# ---- The live node and replay publish it, each target with its own state --------------------------------------------


@pytest.fixture(autouse=True)
def _extended_table(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results, "OUTPUTS", (*results.OUTPUTS, ROW))


def frame_at(second: int, *positions: float) -> Result:
    """Return a frame in which the camera has this x in the frame of each target."""
    targets = [
        ReferenceResult(
            name, index, Status.TRACKED, PoseStatus.METRIC,
            pose=Pose(np.eye(3), np.array([-x, 0.0, 0.0]), np.eye(6) * 1e-6, 0.1),
        )
        for index, (name, x) in enumerate(zip("ab", positions, strict=False))
    ]  # fmt: skip
    image = RawImage(np.zeros((1, 1), np.uint8), PixelLayout(ColorModel.MONO))
    return Result(Frame(image, second * SECOND, "eye", None), by_name(targets))


FRAMES = [frame_at(1, 1.0, 5.0), frame_at(2, 2.0, 5.0), frame_at(3, 2.0, 5.0)]
#: With a time constant of 1 s, exp(-1) of a step is left after one second and exp(-2) after two.
SMOOTHED = [1.0, 2.0 - math.exp(-1), 2.0 - math.exp(-2)]
PARAMETERS = {"targets.images": ["a.png", "b.png"], "path.max_length": 1000}


def recorded(folder: Path, parameters: Parameters, record: list[str]) -> dict[str, list[Any]]:
    with closing(
        ResultsBag(folder / "results", OutputParameters.of(parameters), ["a", "b"], checked_record(record))
    ) as bag:
        for frame in FRAMES:
            bag.write(frame, frame.frame.stamp_ns)
    found: dict[str, list[Any]] = {}
    with AnyReader([folder / "results"], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, _, data in reader.messages():
            found.setdefault(connection.topic, []).append(reader.deserialize(data, connection.msgtype))
    return found


def test_replay_records_the_new_output_on_request(tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    found = recorded(tmp_path, parameters_from(PARAMETERS), ["smoothed_position"])
    assert [message.point.x for message in found["/smoothed_position"]] == pytest.approx(SMOOTHED)
    assert [message.point.x for message in found["/targets/a/smoothed_position"]] == pytest.approx(SMOOTHED)
    assert [message.point.x for message in found["/targets/b/smoothed_position"]] == pytest.approx([5.0] * 3)
    assert found["/smoothed_position"][0].header.frame_id == "a"
    assert "/smoothed_position" not in recorded(other, parameters_from(PARAMETERS), [])


def test_the_live_node_publishes_the_new_output() -> None:
    pytest.importorskip("rclpy", reason="needs the ros extra")
    from imgu_ros.ros.outputs import Outputs
    from test.ros.test_outputs import FakeNode

    topics = ("smoothed_position", "targets/b/smoothed_position")
    node = FakeNode(*topics)
    outputs = Outputs(node, ["a", "b"], OutputParameters.of(parameters_from(PARAMETERS)))  # type: ignore[arg-type]

    def published(topic: str) -> list[float]:
        return [message.point.x for message in node.publishers[topic].sent]

    for frame in FRAMES:
        outputs.publish(frame)
    assert published(topics[0]) == pytest.approx(SMOOTHED)
    assert published(topics[1]) == pytest.approx([5.0] * 3)
    assert not node.publishers["targets/a/smoothed_position"].sent, "nobody subscribes to it"
    # A reset drops the state; a parameter that changes acts on the next frame, and the state stays.
    outputs.reset()
    outputs.publish(frame_at(4, 3.0, 5.0))
    outputs.adapt(["a", "b"], OutputParameters.of(parameters_from(PARAMETERS | {"path.max_length": 500})))
    outputs.publish(frame_at(5, 4.0, 5.0))
    assert published(topics[0])[3:] == pytest.approx([3.0, 4.0 - math.exp(-2)])
