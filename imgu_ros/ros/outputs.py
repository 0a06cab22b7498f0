"""Output topics of a node: a publisher for each, and nothing made for those that nobody listens to."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher

from imgu_ros.codec.compressed_image import compressed_image_message
from imgu_ros.codec.geometry import PathHistory, odometry_message, tf_message
from imgu_ros.codec.results import (
    FRAME_OUTPUTS,
    TARGET_OUTPUTS,
    level_message,
    needs_keypoints,
    picture_message,
    result_header,
    target_transforms,
)
from imgu_ros.errors import EstimationError
from imgu_ros.params import Parameters
from imgu_ros.perception.map_pose import camera_in_map
from imgu_ros.perception.result import Result, TargetResult
from imgu_ros.report.overlay import draw_result
from imgu_ros.ros.map_tie import TF_TOPIC, TF_TYPE, MapTie
from imgu_ros.ros.messages import make_message, message_class
from imgu_ros.ros.qos import no_events, output_qos, overridable, override_names
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.camera.rigid import rigid_transforms

_IMAGE = "sensor_msgs/msg/Image"
_COMPRESSED = "sensor_msgs/msg/CompressedImage"
_ODOMETRY = "nav_msgs/msg/Odometry"
_PATH = "nav_msgs/msg/Path"
#: A queue of large pictures only makes slow subscribers slower.
_IMAGE_DEPTH = 2
#: Squared distances over their degrees of freedom, 1 on average: far beyond chance.
_CONTRADICTION = 25.0
_THROTTLE_S = 5.0
_STEADY = Clock(clock_type=ClockType.STEADY_TIME)


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """The topics of a node that has a part of `perception`'s, and others.

    Attributes
    ----------
    includes : tells whether the node has one of `perception`'s topics
    beside : its other topics, for `Outputs.offer`, and their types
    """

    includes: Callable[[str], bool]
    beside: Mapping[str, str]


class Outputs:
    """The publishers of a node, its topics relative to the node's namespace.

    Made and destroyed in the executor's thread, published to from the worker's, never at the same time.

    Parameters
    ----------
    node : creates the publishers
    target_names : in the order of `targets.images`
    parameters : `pyramid.levels`, `publish_tf`, `frames`, `tf`, `path` and `targets.poses` are used
    choice : which topics; None: all of the node `perception`

    Raises
    ------
    ImguError
        If `publish_tf` is set and tf2_msgs is not installed, or `targets.poses` holds no poses.
    """

    def __init__(
        self, node: Node, target_names: Sequence[str], parameters: Parameters, choice: Choice | None = None
    ) -> None:
        self._node = node
        self._parameters = parameters
        self._serves = _served(target_names, parameters)
        self._publishers: dict[str, Publisher] = {}
        self._problem = ""
        self._of_keypoints: list[str] = []
        self._paths = {
            name: PathHistory(make_message, parameters.frames.target_prefix + name, parameters.path.max_length)
            for name in target_names
        }
        # Made first: seven numbers that are no pose are to be refused before anything exists.
        self._map_from_target = rigid_transforms(parameters.targets.poses, "targets.poses")
        self._map_path = PathHistory(make_message, parameters.frames.map, parameters.path.max_length)
        self._tie: MapTie | None = None
        self._choice = choice
        self._always = parameters.publish_tf and self._is_chosen(TF_TOPIC)
        try:
            self._create(target_names)
        except BaseException:
            self.destroy()
            raise

    def serves(self, target_names: Sequence[str], parameters: Parameters) -> bool:
        """Return whether these publishers are the ones for other parameters too."""
        return self._serves == _served(target_names, parameters)

    def wanted(self) -> bool:
        """Return whether anybody listens to any output; `publish_tf` counts as a listener."""
        return self._always or any(self.listened(topic) for topic in self._publishers)

    def listened(self, topic: str) -> bool:
        """Return whether somebody listens to one topic."""
        publisher = self._publishers.get(topic)
        return publisher is not None and publisher.get_subscription_count() > 0

    def needs_keypoints(self) -> bool:
        """Return whether somebody listens to keypoints or pyramid, which tracking does without."""
        return any(self.listened(topic) for topic in self._of_keypoints)

    def unmatched(self) -> int:
        """Return how many subscribers cannot be served, for their QoS does not fit."""
        publishers = self._publishers.values()
        return sum(max(0, self._node.count_subscribers(p.topic_name) - p.get_subscription_count()) for p in publishers)

    def publish(self, result: Result) -> None:
        """Publish what a frame has for each topic that somebody listens to."""
        for topic, output in FRAME_OUTPUTS.items():
            self._publish(topic, partial(output.message, make_message, result))
        for level in range(self._parameters.pyramid.levels):
            self._publish(f"pyramid/level_{level}", partial(level_message, make_message, result, level))
        self._publish_debug_image(result)
        for position, target in enumerate(result.targets):
            self._publish_target(result, target, [f"targets/{target.name}/"] + ([""] if position == 0 else []))
        in_map = self._in_map(result)
        if in_map is not None:
            self._publish_in_map(result, in_map)
        if self._always:
            self._publish_tf(result, in_map)

    def publish_rejected(self, result: Result) -> None:
        """Publish what is to be said about a frame that could not be read: its status."""
        self._publish("status", partial(FRAME_OUTPUTS["status"].message, make_message, result))

    def offer(self, topic: str, make: Callable[[], Any]) -> None:
        """Publish on one topic what `make` makes, when somebody listens."""
        self._publish(topic, make)

    def qos_override_names(self) -> list[str]:
        """Return the parameters that override the QoS of the outputs."""
        topics = [self._node.resolve_topic_name(topic) for topic in self._publishers]
        return [name for topic in topics for name in override_names(topic, "publisher")]

    def reset(self) -> None:
        """Forget where the camera has been: paths begin anew, and robot's transforms are awaited again."""
        for path in (self._map_path, *self._paths.values()):
            path.clear()
        if self._tie is not None:
            self._tie.forget()

    @property
    def problem(self) -> str:
        """What keeps the node from publishing map -> root; empty when nothing does."""
        return self._problem or ("" if self._tie is None else self._tie.problem)

    def destroy(self) -> None:
        """Destroy the publishers."""
        if self._tie is not None:
            self._tie.destroy()
            self._tie = None
        for publisher in self._publishers.values():
            self._node.destroy_publisher(publisher)
        self._publishers.clear()

    def _create(self, target_names: Sequence[str]) -> None:
        for topic, frame_output in FRAME_OUTPUTS.items():
            self._add(topic, frame_output.type_name)
        for level in range(self._parameters.pyramid.levels):
            self._add(f"pyramid/level_{level}", _IMAGE)
        self._add("debug_image", _IMAGE)
        self._add("debug_image/compressed", _COMPRESSED)
        for prefix in ["", *(f"targets/{name}/" for name in target_names)]:
            for topic, target_output in TARGET_OUTPUTS.items():
                self._add(prefix + topic, target_output.type_name)
            self._add(prefix + "path", _PATH)
        if self._map_from_target:
            self._add("map/odom", _ODOMETRY)
            self._add("map/path", _PATH)
        if self._always:
            self._add(TF_TOPIC, TF_TYPE, depth=100)
            if self._map_from_target:
                frames, tf = self._parameters.frames, self._parameters.tf
                self._tie = MapTie(self._node, frames.map, tf.root_frame)
        for topic, type_name in (self._choice.beside if self._choice else {}).items():
            self._add(topic, type_name)
        self._of_keypoints = [topic for topic in self._publishers if needs_keypoints([topic])]

    def _is_chosen(self, topic: str) -> bool:
        return self._choice is None or self._choice.includes(topic) or topic in self._choice.beside

    def _add(self, topic: str, type_name: str, depth: int | None = None) -> None:
        if not self._is_chosen(topic):
            return
        depth = depth or (_IMAGE_DEPTH if type_name in (_IMAGE, _COMPRESSED) else 10)
        self._publishers[topic] = self._node.create_publisher(
            message_class(type_name),
            topic,
            output_qos(depth),
            event_callbacks=no_events(),
            qos_overriding_options=overridable(),
        )

    def _publish(self, topic: str, make: Callable[[], Any]) -> None:
        if self.listened(topic):
            self._send(topic, make())

    def _send(self, topic: str, message: Any) -> None:
        if message is not None:
            self._publishers[topic].publish(message)

    def _publish_debug_image(self, result: Result) -> None:
        topics = [topic for topic in ("debug_image", "debug_image/compressed") if self.listened(topic)]
        if not topics:
            return
        picture = draw_result(result)
        if "debug_image" in topics:
            self._send("debug_image", picture_message(make_message, result, picture))
        if "debug_image/compressed" in topics:
            message = compressed_image_message(make_message, result_header(result), picture, "rgb8")
            self._send("debug_image/compressed", message)

    def _publish_target(self, result: Result, target: TargetResult, prefixes: Sequence[str]) -> None:
        frame = self._parameters.frames.target_prefix + target.name
        for topic, output in TARGET_OUTPUTS.items():
            listened = [prefix + topic for prefix in prefixes if self.listened(prefix + topic)]
            message = output.message(make_message, result, target, frame) if listened else None
            for name in listened:
                self._send(name, message)
        listened = [prefix + "path" for prefix in prefixes if self.listened(prefix + "path")]
        if listened and target.pose is not None:
            path = self._paths[target.name].add(result.frame.stamp_ns, target.pose)
            for name in listened:
                self._send(name, path)

    def _in_map(self, result: Result) -> Pose | None:
        """Return the camera in the map, when its targets' places there are known and somebody wants to know."""
        self._problem = ""
        wanted = self._always or self.listened("map/odom") or self.listened("map/path")
        if not self._map_from_target or not wanted:
            return None
        try:
            fused = camera_in_map(result, self._map_from_target, self._parameters.targets.widths_m)
        except EstimationError as error:
            self._problem = f"targets.poses: {error}"
            self._say(self._problem)
            return None
        if fused is not None and fused.disagreement > _CONTRADICTION:
            names = ", ".join(target.name for target in result.targets if target.pose is not None)
            # Once: where the targets were measured by hand, nothing better may be had; the covariance takes account of it.
            self._node.get_logger().warning(
                f"targets.poses: {names} put the camera {fused.disagreement**0.5:.0f} times farther apart than their "
                "covariances allow; need more exact poses and widths",
                once=True,
            )
        return None if fused is None else fused.pose

    def _publish_in_map(self, result: Result, map_from_camera: Pose) -> None:
        name, camera_from_map = self._parameters.frames.map, map_from_camera.inverse()
        self._publish("map/odom", partial(odometry_message, make_message, result_header(result), name, camera_from_map))
        if self.listened("map/path"):
            self._send("map/path", self._map_path.add(result.frame.stamp_ns, camera_from_map))

    def _publish_tf(self, result: Result, map_from_camera: Pose | None) -> None:
        if not result.frame.frame_id:
            self._problem = "tf: the images' frame_id is empty; need the name of the camera's optical frame"
            self._say(self._problem)
            return
        transforms = target_transforms(result, self._parameters.frames.target_prefix)
        if self._tie is not None:
            if map_from_camera is not None:
                self._tie.add(result.frame.stamp_ns, result.frame.frame_id, map_from_camera.transform)
            transforms += self._tie.take()
            if self._tie.problem:
                self._say(self._tie.problem)
        if transforms:
            self._send(TF_TOPIC, tf_message(make_message, transforms))

    def _say(self, line: str) -> None:
        self._node.get_logger().warning(line, throttle_duration_sec=_THROTTLE_S, throttle_time_source_type=_STEADY)


def _served(names: Sequence[str], parameters: Parameters) -> tuple[object, ...]:
    """Everything that the publishers depend on."""
    p = parameters
    return (tuple(names), p.pyramid.levels, p.publish_tf, p.frames, p.tf, p.path, p.targets.poses)
