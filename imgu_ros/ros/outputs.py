# SPDX-License-Identifier: Apache-2.0
"""Output topics of a node: a publisher for each, and nothing made for those that nobody listens to."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from imgu_ros.config.components import OutputParameters
from imgu_ros.messages.geometry import tf_message
from imgu_ros.messages.header import Header
from imgu_ros.messages.output_topic import ConvertedFrame
from imgu_ros.messages.result_converter import ResultConverter
from imgu_ros.messages.results import needs_keypoints, target_transforms
from imgu_ros.report.overlay import draw_result
from imgu_ros.result import Result
from imgu_ros.ros.map_to_root import TF_TOPIC, TF_TYPE, MapToRootPublisher
from imgu_ros.ros.messages import make_message
from imgu_ros.ros.publishers import Publishers, Topic
from imgu_ros.vision.camera.pose_fusion import FusedPose

_COMPRESSED_SUFFIX = "/compressed"
#: A long queue of large images only makes slow subscribers slower.
_DEPTHS = {"sensor_msgs/msg/Image": 2, "sensor_msgs/msg/CompressedImage": 2}
_DEPTH, _TF_DEPTH = 10, 100
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
    parameters : those of the outputs
    choice : which topics; None: all of the node `perception`

    Raises
    ------
    ImguError
        If `publish_tf` is set and tf2_msgs is not installed, or `targets.poses` holds no poses.
    """

    def __init__(
        self, node: Node, target_names: Sequence[str], parameters: OutputParameters, choice: Choice | None = None
    ) -> None:
        self._node = node
        self._choice = choice
        self._publishers = Publishers(node)
        self._converter = ResultConverter(make_message, draw_result, target_names, parameters)
        self._tie: MapToRootPublisher | None = None
        self._problem = ""
        try:
            self.adapt(target_names, parameters)
        except BaseException:
            self.destroy()
            raise

    def serves(self, target_names: Sequence[str], parameters: OutputParameters) -> bool:
        """Return whether these outputs are adapted to these targets and parameters."""
        return (tuple(target_names), parameters) == (self._names, self._parameters)

    def adapt(self, target_names: Sequence[str], parameters: OutputParameters) -> None:
        """Change to other targets or parameters; topics that stay keep their subscribers, paths their poses.

        Raises
        ------
        ImguError
            As at construction; then nothing changes.
        """
        adapted = ResultConverter(make_message, draw_result, target_names, parameters)
        self._publishers.adapt(self._topics(adapted, parameters))
        self._converter.adapt(target_names, parameters)
        self._names, self._parameters = tuple(target_names), parameters
        wanted = (parameters.frames.map, parameters.tf.root_frame) if adapted.has_map and self._always else None
        if self._tie is not None and self._tie.frames != wanted:
            self._tie.destroy()
            self._tie = None
        if self._tie is None and wanted is not None:
            self._tie = MapToRootPublisher(self._node, *wanted)

    def wanted(self) -> bool:
        """Return whether any output has a subscriber; `publish_tf` counts as one."""
        return self._always or self._publishers.any_listened()

    def needs_keypoints(self) -> bool:
        """Return whether keypoints or pyramid have a subscriber: tracking does without them."""
        return any(needs_keypoints([topic]) and self.listened(topic) for topic in self._converter.topics())

    def unmatched(self) -> int:
        """Return how many subscribers cannot be served because their QoS is incompatible."""
        return self._publishers.unmatched()

    def publish(self, result: Result) -> None:
        """Publish what a frame has for each topic that has a subscriber."""
        self._problem = ""
        frame = self._published(result)
        if self._always:
            self._publish_tf(frame)
        if frame.map_problem:
            self._problem = frame.map_problem
            self._warn(self._problem)
        elif "fused" in vars(frame):
            self._warn_of_contradiction(frame.result, frame.fused)

    def publish_rejected(self, result: Result) -> None:
        """Publish the status of a frame that could not be decoded: no other topic has anything for it."""
        self._published(result)

    def publish_held_up(self, header: Header, text: str) -> None:
        """Publish in `status` that a frame takes long, from the executor's thread while the worker processes it."""
        self.offer("status", partial(self._converter.held_up, header, text))

    def listened(self, topic: str) -> bool:
        """Return whether a topic has a subscriber."""
        return self._publishers.listened(topic)

    def offer(self, topic: str, make: Callable[[], Any]) -> None:
        """Publish on one topic the message that `make` returns, when the topic has a subscriber."""
        self._publishers.offer(topic, make)

    def qos_override_names(self) -> list[str]:
        """Return the parameters that override the QoS of the outputs."""
        return self._publishers.qos_override_names()

    def reset(self) -> None:
        """Forget earlier frames: paths start anew, and the robot's transforms are awaited again."""
        self._converter.reset()
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

    @property
    def _always(self) -> bool:
        return self._parameters.publish_tf and self._is_chosen(TF_TOPIC)

    def _topics(self, converter: ResultConverter, parameters: OutputParameters) -> dict[str, Topic]:
        types = {topic: row.type_name for topic, row in converter.topics().items()}
        types |= {TF_TOPIC: TF_TYPE} if parameters.publish_tf else {}
        types = {name: kind for name, kind in types.items() if self._is_chosen(name.removesuffix(_COMPRESSED_SUFFIX))}
        types |= self._choice.beside if self._choice else {}
        depths = _DEPTHS | {TF_TYPE: _TF_DEPTH}
        own = set(self._choice.beside if self._choice else ())
        return {name: Topic(kind, _DEPTH if name in own else depths.get(kind, _DEPTH)) for name, kind in types.items()}

    def _is_chosen(self, topic: str) -> bool:
        return self._choice is None or self._choice.includes(topic) or topic in self._choice.beside

    def _published(self, result: Result) -> ConvertedFrame:
        frame = self._converter.frame(result)
        for made in self._converter.messages(frame, self.listened):
            for topic in made.topics:
                self._publishers.send(topic, made.message)
        return frame

    def _warn_of_contradiction(self, result: Result, fused: FusedPose | None) -> None:
        if fused is not None and fused.disagreement > _CONTRADICTION:
            names = ", ".join(target.name for target in result if target.pose is not None)
            # Once: targets measured by hand may not get better, and the covariance accounts for the contradiction.
            self._node.get_logger().warning(
                f"targets.poses: {names} put the camera {fused.disagreement**0.5:.0f} times farther apart than their "
                "covariances allow; need more exact poses and widths",
                once=True,
            )

    def _publish_tf(self, frame: ConvertedFrame) -> None:
        result = frame.result
        if not result.frame.frame_id:
            self._problem = (
                "tf: the images' frame_id is empty; need frames.camera, the name of the camera's optical frame"
            )
            self._warn(self._problem)
            return
        transforms = target_transforms(result, self._parameters.frames.target_prefix)
        if self._tie is not None:
            if frame.fused is not None:
                self._tie.add(result.frame.stamp_ns, result.frame.frame_id, frame.fused.pose.transform)
            transforms += self._tie.take()
            if self._tie.problem:
                self._warn(self._tie.problem)
        if transforms:
            self._publishers.send(TF_TOPIC, tf_message(make_message, transforms))

    def _warn(self, line: str) -> None:
        self._node.get_logger().warning(line, throttle_duration_sec=_THROTTLE_S, throttle_time_source_type=_STEADY)
