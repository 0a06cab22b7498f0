# SPDX-License-Identifier: Apache-2.0
"""Output topics of a node: a publisher for each; messages are made for topics with subscribers only."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher

from imgu_ros.config.components import OutputParameters
from imgu_ros.messages.geometry import tf_message
from imgu_ros.messages.header import Header
from imgu_ros.messages.output_topic import ConvertedFrame, OutputTopic
from imgu_ros.messages.result_converter import ResultConverter
from imgu_ros.messages.results import needs_keypoints, target_transforms
from imgu_ros.report.overlay import draw_result
from imgu_ros.result import Result
from imgu_ros.ros.map_to_root import TF_TOPIC, TF_TYPE, MapToRootPublisher
from imgu_ros.ros.messages import is_installed, make_message, message_class
from imgu_ros.ros.qos import no_events, output_qos, overridable, override_names
from imgu_ros.vision.camera.pose_fusion import FusedPose

_COMPRESSED_SUFFIX = "/compressed"
#: A long queue of large images only makes slow subscribers slower.
_DEPTHS = {"sensor_msgs/msg/Image": 2, "sensor_msgs/msg/CompressedImage": 2}
_DEPTH, _TF_DEPTH = 10, 100
#: Squared distance over its degrees of freedom (1 on average) from which targets contradict each other.
_CONTRADICTION = 25.0
_THROTTLE_S = 5.0
_STEADY = Clock(clock_type=ClockType.STEADY_TIME)


@dataclass(frozen=True, slots=True)
class PublishedTopic:
    """A topic's type, "package/msg/Name", and how many messages wait for a slow subscriber."""

    type_name: str
    depth: int = 10


class Publishers:
    """The publishers of a node, its topics relative to the node's namespace.

    Parameters
    ----------
    node : creates the publishers
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._topics: dict[str, PublishedTopic] = {}
        self._publishers: dict[str, Publisher] = {}

    def adapt(self, topics: Mapping[str, PublishedTopic]) -> None:
        """Have publishers for these topics and no others; those that stay the same keep their subscribers.

        Raises
        ------
        ImguError
            If a message's package is not installed; then nothing changes.
        """
        for topic in topics.values():
            message_class(topic.type_name)
        for name in [name for name, topic in self._topics.items() if topics.get(name) != topic]:
            del self._topics[name]
            self._node.destroy_publisher(self._publishers.pop(name))
        for name, topic in topics.items():
            if name not in self._topics:
                self._publishers[name] = self._create(name, topic)
                self._topics[name] = topic

    def destroy(self) -> None:
        """Destroy all publishers."""
        self.adapt({})

    def listened(self, topic: str) -> bool:
        """Return whether a topic has a subscriber; False when there is none of that name."""
        publisher = self._publishers.get(topic)
        return publisher is not None and publisher.get_subscription_count() > 0

    def any_listened(self) -> bool:
        """Return whether any topic has a subscriber."""
        return any(self.listened(topic) for topic in self._publishers)

    def offer(self, topic: str, make: Callable[[], Any | None]) -> None:
        """Publish the message that `make` returns, unless it is None, when the topic has a subscriber."""
        if self.listened(topic):
            self.send(topic, make())

    def send(self, topic: str, message: Any | None) -> None:
        """Publish a message, unless it is None."""
        if message is not None:
            self._publishers[topic].publish(message)

    def unmatched(self) -> int:
        """Return how many subscribers cannot be served because their QoS is incompatible."""
        publishers = self._publishers.values()
        return sum(max(0, self._node.count_subscribers(p.topic_name) - p.get_subscription_count()) for p in publishers)

    def qos_override_names(self) -> list[str]:
        """Return the parameters that override the QoS of the topics."""
        topics = [self._node.resolve_topic_name(topic) for topic in self._publishers]
        return [name for topic in topics for name in override_names(topic, "publisher")]

    def _create(self, name: str, topic: PublishedTopic) -> Publisher:
        return self._node.create_publisher(
            message_class(topic.type_name),
            name,
            output_qos(topic.depth),
            event_callbacks=no_events(),
            qos_overriding_options=overridable(),
        )


@dataclass(frozen=True, slots=True, eq=False)
class TopicSelection:
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
    selection : which topics; None: all of the node `perception`
    taken : topics, by their full names, that others publish for the node: it publishes none of them

    Raises
    ------
    ImguError
        If `publish_tf` is set and tf2_msgs is not installed, or `targets.poses` holds no poses.
    """

    def __init__(
        self,
        node: Node,
        target_names: Sequence[str],
        parameters: OutputParameters,
        selection: TopicSelection | None = None,
        taken: Collection[str] = (),
    ) -> None:
        self._node = node
        self._selection, self._taken = selection, frozenset(taken)
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
        self._published(result, lambda topic: topic == "status" and self.listened(topic))

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
        """Forget earlier frames: paths restart, and the robot's transforms are awaited again."""
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

    def _topics(self, converter: ResultConverter, parameters: OutputParameters) -> dict[str, PublishedTopic]:
        types = {topic: row.type_name for topic, row in converter.topics().items() if self._is_possible(topic, row)}
        types |= {TF_TOPIC: TF_TYPE} if parameters.publish_tf else {}
        types = {name: kind for name, kind in types.items() if self._is_chosen(name.removesuffix(_COMPRESSED_SUFFIX))}
        types |= self._selection.beside if self._selection else {}
        depths = _DEPTHS | {TF_TYPE: _TF_DEPTH}
        own = set(self._selection.beside if self._selection else ())
        return {
            name: PublishedTopic(kind, _DEPTH if name in own else depths.get(kind, _DEPTH))
            for name, kind in types.items()
        }

    def _is_possible(self, topic: str, row: OutputTopic) -> bool:
        return not (row.is_optional and not is_installed(row.type_name)) and (
            self._node.resolve_topic_name(topic) not in self._taken
        )

    def _is_chosen(self, topic: str) -> bool:
        return self._selection is None or self._selection.includes(topic) or topic in self._selection.beside

    def _published(self, result: Result, is_wanted: Callable[[str], bool] | None = None) -> ConvertedFrame:
        frame = self._converter.frame(result)
        for made in self._converter.messages(frame, is_wanted or self.listened):
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
