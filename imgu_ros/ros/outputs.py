# SPDX-License-Identifier: Apache-2.0
"""Output topics of a node: a publisher for each, and nothing made for those that nobody listens to."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from imgu_ros.config.parameters import Parameters
from imgu_ros.errors import EstimationError
from imgu_ros.messages.geometry import PathHistory, odometry_message, tf_message
from imgu_ros.messages.header import Header
from imgu_ros.messages.results import (
    FRAME_OUTPUTS,
    TARGET_OUTPUTS,
    compressed_picture_message,
    level_message,
    needs_keypoints,
    picture_message,
    result_header,
    target_transforms,
)
from imgu_ros.messages.status import held_up_message
from imgu_ros.pose.map_pose import camera_in_map
from imgu_ros.report.overlay import draw_result
from imgu_ros.result import ReferenceResult, Result
from imgu_ros.ros.map_to_root import TF_TOPIC, TF_TYPE, MapToRootPublisher
from imgu_ros.ros.messages import make_message
from imgu_ros.ros.publishers import Publishers, Topic
from imgu_ros.types import Image
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.camera.rigid import rigid_transforms

_IMAGE = "sensor_msgs/msg/Image"
_COMPRESSED = "sensor_msgs/msg/CompressedImage"
_ODOMETRY = "nav_msgs/msg/Odometry"
_PATH = "nav_msgs/msg/Path"
#: Those pictures that have a compressed twin, as image_transport names it.
_COMPRESSED_TWINS = ("image_color", "image_mono", "debug_image")
_TWIN = "/compressed"
#: A queue of large pictures only makes slow subscribers slower.
_IMAGE_DEPTH = 2
_TF_DEPTH = 100
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

    Made, adapted and destroyed in the executor's thread, published to from the worker's, never at the same time.

    Parameters
    ----------
    node : creates the publishers
    target_names : in the order of `targets.images`
    parameters : all parameters
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
        self._choice = choice
        self._publishers = Publishers(node)
        self._paths: dict[str, PathHistory] = {}
        self._map_path: PathHistory | None = None
        self._tie: MapToRootPublisher | None = None
        self._problem = ""
        try:
            self.adapt(target_names, parameters)
        except BaseException:
            self.destroy()
            raise

    def serves(self, target_names: Sequence[str], parameters: Parameters) -> bool:
        """Return whether these outputs are adapted to these targets and parameters."""
        return (tuple(target_names), parameters) == (self._names, self._parameters)

    def adapt(self, target_names: Sequence[str], parameters: Parameters) -> None:
        """Change to other targets or parameters; topics that stay keep their subscribers, paths their poses.

        Raises
        ------
        ImguError
            As at construction; then nothing changes.
        """
        map_from_target = rigid_transforms(parameters.targets.poses, "targets.poses")
        self._publishers.adapt(self._topics(target_names, parameters))
        self._names, self._parameters = tuple(target_names), parameters
        self._map_from_target = map_from_target
        frames, length = parameters.frames, parameters.path.max_length
        self._map_path = self._path(self._map_path, frames.map, length)
        paths = {name: self._path(self._paths.get(name), frames.target_prefix + name, length) for name in target_names}
        self._paths |= paths
        wanted = (frames.map, parameters.tf.root_frame) if map_from_target and self._always else None
        if self._tie is not None and self._tie.frames != wanted:
            self._tie.destroy()
            self._tie = None
        if self._tie is None and wanted is not None:
            self._tie = MapToRootPublisher(self._node, *wanted)

    def wanted(self) -> bool:
        """Return whether anybody listens to any output; `publish_tf` counts as a listener."""
        return self._always or self._publishers.any_listened()

    def needs_keypoints(self) -> bool:
        """Return whether somebody listens to keypoints or pyramid, which tracking does without."""
        levels = [f"pyramid/level_{level}" for level in range(self._parameters.pyramid.levels)]
        return any(self.listened(topic) for topic in ("keypoints", *levels) if needs_keypoints([topic]))

    def unmatched(self) -> int:
        """Return how many subscribers cannot be served, for their QoS does not fit."""
        return self._publishers.unmatched()

    def publish(self, result: Result) -> None:
        """Publish what a frame has for each topic that somebody listens to."""
        result = self._in_camera_frame(result)
        for topic, output in FRAME_OUTPUTS.items():
            self.offer(topic, partial(output.message, make_message, result))
        for level in range(self._parameters.pyramid.levels):
            self.offer(f"pyramid/level_{level}", partial(level_message, make_message, result, level))
        self._publish_compressed(result)
        self._publish_debug_image(result)
        for position, target in enumerate(result):
            self._publish_target(result, target, [f"targets/{target.name}/"] + ([""] if position == 0 else []))
        self._problem = ""
        in_map = self._in_map(result)
        if in_map is not None:
            self._publish_in_map(result, in_map)
        if self._always:
            self._publish_tf(result, in_map)

    def publish_rejected(self, result: Result) -> None:
        """Publish what is to be said about a frame that could not be read: its status."""
        result = self._in_camera_frame(result)
        self.offer("status", partial(FRAME_OUTPUTS["status"].message, make_message, result))

    def publish_held_up(self, header: Header, text: str) -> None:
        """Publish that a frame takes long: its status, from the executor's thread while the worker is at it."""
        header = replace(header, frame_id=self._parameters.frames.camera or header.frame_id)
        self.offer("status", partial(held_up_message, make_message, header, self._names, text))

    def listened(self, topic: str) -> bool:
        """Return whether anybody listens to a topic."""
        return self._publishers.listened(topic)

    def offer(self, topic: str, make: Callable[[], Any]) -> None:
        """Publish on one topic what `make` makes, when somebody listens."""
        self._publishers.offer(topic, make)

    def qos_override_names(self) -> list[str]:
        """Return the parameters that override the QoS of the outputs."""
        return self._publishers.qos_override_names()

    def reset(self) -> None:
        """Forget where the camera has been: paths begin anew, and the robot's transforms are awaited again."""
        for path in (self._map_path, *self._paths.values()):
            if path is not None:
                path.clear()
        if self._tie is not None:
            self._tie.forget()

    @property
    def problem(self) -> str:
        """What keeps the node from publishing the camera in the map or on /tf; empty when nothing does."""
        return self._problem or ("" if self._tie is None else self._tie.problem)

    def destroy(self) -> None:
        """Destroy the publishers."""
        if self._tie is not None:
            self._tie.destroy()
            self._tie = None
        self._publishers.destroy()

    @staticmethod
    def _path(before: PathHistory | None, frame: str, max_length: int) -> PathHistory:
        """Return the path that goes on, or a new one in another frame."""
        if before is None or before.target_frame != frame:
            return PathHistory(make_message, frame, max_length)
        before.resize(max_length)
        return before

    @property
    def _always(self) -> bool:
        return self._parameters.publish_tf and self._is_chosen(TF_TOPIC)

    def _topics(self, target_names: Sequence[str], parameters: Parameters) -> dict[str, Topic]:
        image, compressed = Topic(_IMAGE, _IMAGE_DEPTH), Topic(_COMPRESSED, _IMAGE_DEPTH)
        topics = {
            topic: image if output.type_name == _IMAGE else Topic(output.type_name)
            for topic, output in FRAME_OUTPUTS.items()
        }
        topics |= {f"pyramid/level_{level}": image for level in range(parameters.pyramid.levels)}
        topics["debug_image"] = image
        for prefix in ["", *(f"targets/{name}/" for name in target_names)]:
            topics |= {prefix + topic: Topic(output.type_name) for topic, output in TARGET_OUTPUTS.items()}
            topics[prefix + "path"] = Topic(_PATH)
        if parameters.targets.poses:
            topics |= {"map/odom": Topic(_ODOMETRY), "map/path": Topic(_PATH)}
        if parameters.publish_tf:
            topics[TF_TOPIC] = Topic(TF_TYPE, _TF_DEPTH)
        topics |= {name + _TWIN: compressed for name in _COMPRESSED_TWINS}
        chosen = {name: topic for name, topic in topics.items() if self._is_chosen(name.removesuffix(_TWIN))}
        beside = self._choice.beside if self._choice else {}
        return chosen | {name: Topic(type_name) for name, type_name in beside.items()}

    def _is_chosen(self, topic: str) -> bool:
        return self._choice is None or self._choice.includes(topic) or topic in self._choice.beside

    def _in_camera_frame(self, result: Result) -> Result:
        name = self._parameters.frames.camera
        return replace(result, frame=replace(result.frame, frame_id=name)) if name else result

    def _publish_compressed(self, result: Result) -> None:
        developed = result.developed
        if developed is not None:
            self.offer("image_color/compressed", lambda: self._compressed(result, developed.color()))
            self.offer("image_mono/compressed", lambda: self._compressed(result, developed.grey))

    def _compressed(self, result: Result, pixels: Image) -> Any:
        options = self._parameters.compressed
        return compressed_picture_message(
            make_message, result, pixels, options.format, options.jpeg_quality, options.png_level
        )

    def _publish_debug_image(self, result: Result) -> None:
        if not any(self.listened(topic) for topic in ("debug_image", "debug_image/compressed")):
            return
        picture = draw_result(result)
        self.offer("debug_image", lambda: picture_message(make_message, result, picture))
        self.offer("debug_image/compressed", lambda: self._compressed(result, picture))

    def _publish_target(self, result: Result, target: ReferenceResult, prefixes: Sequence[str]) -> None:
        frame = self._parameters.frames.target_prefix + target.name
        for topic, output in TARGET_OUTPUTS.items():
            listened = [prefix + topic for prefix in prefixes if self.listened(prefix + topic)]
            message = output.message(make_message, result, target, frame) if listened else None
            for name in listened:
                self._publishers.send(name, message)
        listened = [prefix + "path" for prefix in prefixes if self.listened(prefix + "path")]
        if listened and target.pose is not None:
            path = self._paths[target.name].add(result.frame.stamp_ns, target.pose)
            for name in listened:
                self._publishers.send(name, path)

    def _in_map(self, result: Result) -> Pose | None:
        """Return the camera in the map, when its targets' places there are known and somebody wants to know."""
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
            names = ", ".join(target.name for target in result if target.pose is not None)
            # Once: of targets measured by hand nothing better may be had, and the covariance takes account of it.
            self._node.get_logger().warning(
                f"targets.poses: {names} put the camera {fused.disagreement**0.5:.0f} times farther apart than their "
                "covariances allow; need more exact poses and widths",
                once=True,
            )
        return None if fused is None else fused.pose

    def _publish_in_map(self, result: Result, map_from_camera: Pose) -> None:
        name, camera_from_map = self._parameters.frames.map, map_from_camera.inverse()
        self.offer("map/odom", partial(odometry_message, make_message, result_header(result), name, camera_from_map))
        if self._map_path is not None and self.listened("map/path"):
            self._publishers.send("map/path", self._map_path.add(result.frame.stamp_ns, camera_from_map))

    def _publish_tf(self, result: Result, map_from_camera: Pose | None) -> None:
        if not result.frame.frame_id:
            self._problem = (
                "tf: the images' frame_id is empty; need frames.camera, the name of the camera's optical frame"
            )
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
            self._publishers.send(TF_TOPIC, tf_message(make_message, transforms))

    def _say(self, line: str) -> None:
        self._node.get_logger().warning(line, throttle_duration_sec=_THROTTLE_S, throttle_time_source_type=_STEADY)
