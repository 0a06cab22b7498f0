# SPDX-License-Identifier: Apache-2.0
"""Frames: what goes out on /tf and in the map, with a package tf2_msgs as ROS has it, and without DDS."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("rclpy", reason="needs the ros extra")

from imgu_ros.config.components import OutputParameters
from imgu_ros.config.parameters import declaration, declarations
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import ImguError, ParameterError
from imgu_ros.frame import Frame
from imgu_ros.messages.geometry import decode_tf_message, tf_message
from imgu_ros.pose.frame_tree import StampedTransform
from imgu_ros.result import PoseStatus, ReferenceResult, Result, Status, by_name
from imgu_ros.ros import map_to_root as map_tie
from imgu_ros.ros.messages import _fields, make_message, message_class
from imgu_ros.ros.outputs import Outputs
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage

SECOND = 1_000_000_000
PLACES = tuple(
    RigidTransform(Rotation.random(random_state=seed).as_matrix(), np.random.default_rng(seed).normal(size=3))
    for seed in (1, 2)
)
CAMERA = RigidTransform(Rotation.random(random_state=3).as_matrix(), np.array([0.3, -0.2, 1.0]))


class TFMessage:
    """As rosidl generates it, without what DDS needs."""

    @classmethod
    def get_fields_and_field_types(cls) -> dict[str, str]:
        return {"transforms": "sequence<geometry_msgs/TransformStamped>"}

    def __init__(self, *, transforms: list[Any]) -> None:
        self.transforms = transforms


@pytest.fixture
def tf2_msgs(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A package tf2_msgs, which pip does not have."""
    package, module = ModuleType("tf2_msgs"), ModuleType("tf2_msgs.msg")
    module.TFMessage = TFMessage  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "tf2_msgs", package)
    monkeypatch.setitem(sys.modules, "tf2_msgs.msg", module)
    message_class.cache_clear()
    _fields.cache_clear()
    yield
    message_class.cache_clear()
    _fields.cache_clear()


@dataclass
class Recorder:
    """A publisher that keeps what is published."""

    topic_name: str
    listeners: int = 0
    sent: list[Any] = field(default_factory=list)

    def get_subscription_count(self) -> int:
        return self.listeners

    def publish(self, message: Any) -> None:
        self.sent.append(message)


class FakeNode:
    """Creates publishers and subscriptions as a node does."""

    def __init__(self, *listened: str) -> None:
        self.listened = listened
        self.publishers: dict[str, Recorder] = {}
        self.callbacks: dict[str, Any] = {}
        self.lines: list[str] = []

    def create_publisher(self, _: Any, topic: str, *__: Any, **___: Any) -> Recorder:
        self.publishers[topic] = Recorder(topic, int(topic in self.listened))
        return self.publishers[topic]

    def create_subscription(self, _: Any, topic: str, callback: Any, *__: Any, **___: Any) -> str:
        self.callbacks[topic] = callback
        return topic

    def destroy_publisher(self, publisher: Recorder) -> None:
        del self.publishers[publisher.topic_name]

    def destroy_subscription(self, topic: str) -> None:
        del self.callbacks[topic]

    def resolve_topic_name(self, topic: str) -> str:
        return topic if topic.startswith("/") else f"/{topic}"

    def get_logger(self) -> FakeNode:
        return self

    def warning(self, line: str, **_: Any) -> None:
        self.lines.append(line)

    def tf(self) -> dict[tuple[str, str], StampedTransform]:
        """Return what was sent on /tf since the last call."""
        sent, self.publishers["/tf"].sent = self.publishers["/tf"].sent, []
        transforms = [one for message in sent for one in decode_tf_message(message)]
        children = [(one.stamp_ns, one.child) for one in transforms]
        assert len(children) == len(set(children)), "nobody has two parents"
        return {(one.parent, one.child): one for one in transforms}

    def hear(self, topic: str, *edges: tuple[int, str, str, RigidTransform]) -> None:
        """Let somebody else publish transforms."""
        self.callbacks[topic](tf_message(make_message, [StampedTransform(*edge) for edge in edges]))


def of_outputs(values: dict[str, Any]) -> OutputParameters:
    return OutputParameters.of(parameters_from(values))


GIVEN: dict[str, Any] = {
    "targets.images": ["a.png", "b.png"],
    "targets.widths_m": [0.5, 0.5],
    "targets.poses": [float(value) for place in PLACES for value in place.numbers()],
    "publish_tf": True,
}


def outputs(node: FakeNode, **values: Any) -> Outputs:
    return Outputs(node, ["a", "b"], of_outputs(GIVEN | values))  # type: ignore[arg-type]


@pytest.fixture
def settled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_tie, "_SETTLED_S", -1.0)


def result(
    stamp_ns: int = SECOND, frame_id: str = "eye", sigma: float = 1e-3, seen: tuple[int, ...] = (0, 1)
) -> Result:
    """Return what a camera at CAMERA in the map sees, without errors."""
    targets = []
    for index, name in enumerate("ab"):
        pose = CAMERA.inverse().after(PLACES[index])
        covariance = np.diag([sigma**2] * 6) * (index + 1)
        if index in seen:
            given = Pose(pose.R, pose.t, covariance, 0.1)
            targets.append(ReferenceResult(name, index, Status.TRACKED, PoseStatus.METRIC, pose=given))
        else:
            targets.append(ReferenceResult(name, index, Status.LOST))
    image = RawImage(np.zeros((1, 1), np.uint8), PixelLayout(ColorModel.MONO))
    return Result(Frame(image, stamp_ns, frame_id, None), by_name(targets))


def transform(seed: int) -> RigidTransform:
    return RigidTransform(Rotation.random(random_state=seed).as_matrix(), np.random.default_rng(seed).normal(size=3))


def test_targets_hang_from_the_camera(tf2_msgs: None) -> None:
    node = FakeNode()
    out = outputs(node, **{"targets.poses": [], "frames.target_prefix": "seen/"})
    assert out.wanted(), "publish_tf counts as a listener"
    out.publish(result())
    sent = node.tf()
    assert list(sent) == [("eye", "seen/a"), ("eye", "seen/b")]
    expected = CAMERA.inverse().after(PLACES[1])
    np.testing.assert_allclose(sent["eye", "seen/b"].parent_from_child.matrix, expected.matrix, atol=1e-12)
    assert sent["eye", "seen/b"].stamp_ns == SECOND
    assert "/tf_static" not in node.callbacks, "without a map nobody's transforms are needed"
    out.publish(result(seen=()))
    assert node.tf() == {}


def test_the_camera_itself_in_the_map(tf2_msgs: None, settled: None) -> None:
    node = FakeNode("map/odom", "map/path")
    out = outputs(node, **{"frames.map": "hall"})
    out.publish(result())
    sent = node.tf()
    assert list(sent) == [("eye", "a"), ("eye", "b"), ("hall", "eye")]
    np.testing.assert_allclose(sent["hall", "eye"].parent_from_child.matrix, CAMERA.matrix, atol=1e-9)
    odometry = node.publishers["map/odom"].sent[0]
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("hall", "eye")
    position = odometry.pose.pose.position
    np.testing.assert_allclose([position.x, position.y, position.z], CAMERA.t, atol=1e-9)
    path = node.publishers["map/path"].sent[0]
    assert path.header.frame_id == "hall"
    # Both targets: better than the better one.
    out.publish(result(2 * SECOND, seen=(0,)))
    alone = node.publishers["map/odom"].sent[1].pose.covariance
    assert np.trace(np.reshape(odometry.pose.covariance, (6, 6))) < np.trace(np.reshape(alone, (6, 6)))
    assert len(node.publishers["map/path"].sent[1].poses) == 2
    out.publish(result(3 * SECOND, seen=()))
    assert len(node.publishers["map/odom"].sent) == 2
    out.destroy()
    assert not node.callbacks
    assert not node.publishers


def test_the_map_needs_no_tf2_msgs_without_publish_tf(monkeypatch: pytest.MonkeyPatch) -> None:
    message_class.cache_clear()
    for name in ("tf2_msgs", "tf2_msgs.msg"):
        monkeypatch.setitem(sys.modules, name, None)
    node = FakeNode("map/odom")
    out = outputs(node, publish_tf=False)
    out.publish(result())
    assert len(node.publishers["map/odom"].sent) == 1
    with pytest.raises(ImguError, match=r"tf2_msgs.*apt install"):
        outputs(FakeNode())
    message_class.cache_clear()


def test_the_robots_root_hangs_from_the_map_at_the_images_stamp(tf2_msgs: None, settled: None) -> None:
    node = FakeNode()
    out = outputs(node, **{"tf.root_frame": "odom"})
    node.hear("/tf_static", (0, "base", "eye", transform(7)))
    node.hear("/tf", (SECOND - 50_000_000, "odom", "base", transform(8)))
    out.publish(result())
    assert ("map", "odom") not in node.tf(), "where the robot was at the image's stamp is not known yet"
    node.hear("/tf", (SECOND, "odom", "base", transform(9)))
    out.publish(result(SECOND + 30_000_000, seen=()))
    sent = node.tf()
    assert list(sent) == [("map", "odom")]
    assert sent["map", "odom"].stamp_ns == SECOND
    map_from_camera = sent["map", "odom"].parent_from_child.matrix @ transform(9).matrix @ transform(7).matrix
    np.testing.assert_allclose(map_from_camera, CAMERA.matrix, atol=1e-9)
    assert out.problem == ""
    # What comes back of our own is nobody else's.
    node.hear("/tf", (SECOND, "map", "odom", transform(1)), (2 * SECOND, "odom", "base", transform(9)))
    out.publish(result(2 * SECOND))
    assert ("map", "odom") in node.tf()


def test_transforms_that_never_come_are_told(tf2_msgs: None, settled: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_tie, "_PATIENCE_S", 0.0)
    node = FakeNode()
    out = outputs(node, **{"tf.root_frame": "odom"})
    out.publish(result())
    assert list(node.tf()) == [("eye", "a"), ("eye", "b")]
    assert out.problem == "tf: eye: has no parent; need it to hang from 'odom'"
    assert out.problem in node.lines
    node.hear("/tf_static", (0, "odom", "eye", transform(7)))
    out.publish(result(2 * SECOND))
    assert ("map", "odom") in node.tf()
    assert out.problem == ""


def test_never_a_second_parent(tf2_msgs: None, settled: None) -> None:
    node = FakeNode()
    out = outputs(node)
    node.hear("/tf_static", (0, "base", "eye", transform(7)))
    node.hear("/tf", (SECOND, "odom", "base", transform(7)))
    out.publish(result())
    assert list(node.tf()) == [("eye", "a"), ("eye", "b")]
    assert "eye: hangs from 'base' already; need a root of the robot's tree (tf.root_frame: 'odom')" in out.problem
    node.hear("/tf", (0, "elsewhere", "odom", transform(1)))
    other = FakeNode()
    out = outputs(other, **{"tf.root_frame": "odom"})
    other.hear("/tf_static", (0, "odom", "eye", transform(7)))
    other.hear("/tf", (SECOND, "map", "odom", transform(1)))
    out.publish(result())
    assert ("map", "odom") not in other.tf()
    assert "another node publishes map -> odom" in out.problem


def test_at_first_the_robots_transforms_are_awaited(tf2_msgs: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_tie, "_SETTLED_S", 0.3)
    node = FakeNode()
    out = outputs(node)
    out.publish(result())
    assert ("map", "eye") not in node.tf()
    time.sleep(0.35)
    out.publish(result(2 * SECOND))
    assert node.tf()["map", "eye"].stamp_ns == 2 * SECOND


def test_a_frame_without_a_name_is_told(tf2_msgs: None, settled: None) -> None:
    node = FakeNode()
    out = outputs(node)
    out.publish(result(frame_id=""))
    assert node.tf() == {}
    assert "frame_id is empty; need frames.camera" in out.problem
    named = FakeNode("pose", "status")
    out = outputs(named, **{"frames.camera": "lens"})
    out.publish(result(frame_id=""))
    assert named.tf().keys() == {("lens", "a"), ("lens", "b"), ("map", "lens")}
    assert [named.publishers[topic].sent[0].header.frame_id for topic in ("pose", "status")] == ["lens", "lens"]


def test_targets_that_hang_elsewhere_are_told(tf2_msgs: None, settled: None) -> None:
    node = FakeNode()
    out = outputs(node)
    frame = result()
    pose = list(frame)[1].pose
    assert pose is not None
    moved = replace(list(frame)[1], pose=replace(pose, t=pose.t + [0.1, 0, 0]))
    out.publish(replace(frame, references=by_name((frame.first, moved))))
    assert ("map", "eye") in node.tf()
    (line,) = node.lines
    assert line.startswith("targets.poses: a, b put the camera ")


def test_a_reset_begins_paths_anew(tf2_msgs: None, settled: None) -> None:
    node = FakeNode("path", "map/path")
    out = outputs(node)
    out.publish(result(SECOND))
    out.publish(result(2 * SECOND))
    out.reset()
    out.publish(result(3 * SECOND))
    for topic in ("path", "map/path"):
        assert [len(path.poses) for path in node.publishers[topic].sent] == [1, 2, 1]


def test_outputs_adapt_and_keep_their_listeners(tf2_msgs: None, settled: None) -> None:
    node = FakeNode("pose", "path")
    out = outputs(node)
    kept = {topic: node.publishers[topic] for topic in ("pose", "path", "map/odom", "/tf", "image_color/compressed")}
    out.publish(result(SECOND))
    given = GIVEN | {"pyramid.levels": 2, "compressed.format": "png"}
    assert not out.serves(["a", "b"], of_outputs(given))
    out.adapt(["a", "b"], of_outputs(given))
    assert out.serves(["a", "b"], of_outputs(given))
    assert {topic: node.publishers[topic] for topic in kept} == kept
    assert "pyramid/level_2" not in node.publishers
    out.publish(result(3 * SECOND))
    assert [len(path.poses) for path in node.publishers["path"].sent] == [1, 2], "paths go on"

    # Without places there is no map; what cannot be changes nothing.
    out.adapt(["b"], of_outputs(given | {"targets.images": ["b.png"], "targets.widths_m": [0.5], "targets.poses": []}))
    assert "map/odom" not in node.publishers
    assert "targets/a/pose" not in node.publishers
    assert not node.callbacks
    before = dict(node.publishers)
    with pytest.raises(ImguError, match="quaternion"):
        out.adapt(
            ["b"],
            of_outputs(given | {"targets.images": ["b.png"], "targets.widths_m": [0.5], "targets.poses": [0.0] * 7}),
        )
    assert node.publishers == before


#: What the outputs make of a parameter: publishers, paths, and the tie of the robot's frames to the map.
DEPENDS: dict[str, set[str]] = {
    "pyramid.levels": {"topics"},
    "frames.map": {"map path", "tie"},
    "frames.target_prefix": {"path"},
    "tf.root_frame": {"tie"},
}


@pytest.mark.parametrize(
    "name", [known.name for known in declarations() if not known.read_only and not known.name.startswith("targets.")]
)
def test_a_change_makes_anew_what_depends_on_it(name: str, tf2_msgs: None, settled: None) -> None:
    known = declaration(name)
    if known.choices:
        values = [choice for choice in known.choices if choice != known.default]
    elif known.type_name == "string":
        values = ["x"]
    else:
        values = {"bool": [not known.default], "integer": [7, 10, 100], "double": [0.75]}.get(known.type_name, [])
    node = FakeNode("path", "map/path")
    out = outputs(node)
    changed = of_outputs(GIVEN)
    for value in values:
        with contextlib.suppress(ParameterError):
            changed = of_outputs(GIVEN | {name: value})
            break
    out.publish(result(SECOND))
    publishers, tie = dict(node.publishers), out._tie
    assert tie is not None
    assert out.serves(["a", "b"], changed) == (name not in OutputParameters.names())
    out.adapt(["a", "b"], changed)
    assert out.serves(["a", "b"], changed)
    out.publish(result(3 * SECOND))
    anew = set()
    if node.publishers != publishers:
        anew.add("topics")
    for topic, part in (("path", "path"), ("map/path", "map path")):
        if [len(path.poses) for path in node.publishers[topic].sent] != [1, 2]:
            anew.add(part)
    if out._tie is not tie:
        anew.add("tie")
    assert anew == DEPENDS.get(name, set())


def test_a_path_keeps_its_latest_poses_when_its_length_changes(tf2_msgs: None, settled: None) -> None:
    node = FakeNode("path")
    out = outputs(node)
    for second in range(1, 6):
        out.publish(result(second * SECOND))
    out.adapt(["a", "b"], of_outputs(GIVEN | {"path.max_length": 3}))
    out.publish(result(6 * SECOND))
    stamps = [pose.header.stamp.sec for pose in node.publishers["path"].sent[-1].poses]
    assert stamps == [4, 5, 6]


def test_topics_of_packages_that_are_not_installed_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    node = FakeNode()
    Outputs(node, ["poster"], OutputParameters.of(parameters_from({})))
    assert {"markers", "pose", "camera_info"} <= node.publishers.keys()
    assert not {"annotations", "detections"} & node.publishers.keys()


@pytest.mark.parametrize("timed", [False, True])
def test_annotations_go_out_where_their_package_is_installed(monkeypatch: pytest.MonkeyPatch, timed: bool) -> None:
    kinds = {
        "ImageAnnotations": dict.fromkeys(("circles", "points", "texts"), "sequence<x>")
        | ({"timestamp": "builtin_interfaces/Time"} if timed else {}),
        "Color": dict.fromkeys("rgba", "double"),
        "Point2": dict.fromkeys("xy", "double"),
    }
    module = ModuleType("foxglove_msgs.msg")
    for name, fields in kinds.items():
        setattr(module, name, _message_type(name, fields))
    monkeypatch.setitem(sys.modules, "foxglove_msgs", ModuleType("foxglove_msgs"))
    monkeypatch.setitem(sys.modules, "foxglove_msgs.msg", module)
    message_class.cache_clear()
    _fields.cache_clear()
    try:
        node = FakeNode("annotations")
        published = Outputs(node, ["poster"], OutputParameters.of(parameters_from({})))
        published.publish(result(seen=()))
        (message,) = node.publishers["annotations"].sent
        assert (message.points, message.texts) == ([], []), "what was drawn before goes"
        assert not timed or message.timestamp.sec == 1
    finally:
        message_class.cache_clear()
        _fields.cache_clear()


def _message_type(name: str, fields: dict[str, str]) -> type:
    def init(self: Any, **values: Any) -> None:
        vars(self).update(dict.fromkeys(fields) | values)

    return type(name, (), {"__init__": init, "get_fields_and_field_types": classmethod(lambda cls: fields)})


def test_camera_info_is_not_published_where_the_node_reads_it() -> None:
    parameters = OutputParameters.of(parameters_from({}))
    for taken, is_there in ((["/camera_info"], False), (["/cam/camera_info"], True)):
        node = FakeNode()
        Outputs(node, ["poster"], parameters, taken=taken)
        assert ("camera_info" in node.publishers) is is_there
