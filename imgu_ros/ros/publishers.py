# SPDX-License-Identifier: Apache-2.0
"""The publishers of a node: who listens to which, and a set of topics that can change while others stay."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher

from imgu_ros.ros.messages import message_class
from imgu_ros.ros.qos import no_events, output_qos, overridable, override_names


@dataclass(frozen=True, slots=True)
class Topic:
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
        self._topics: dict[str, Topic] = {}
        self._publishers: dict[str, Publisher] = {}

    def adapt(self, topics: Mapping[str, Topic]) -> None:
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
        """Return whether anybody listens to a topic; False when there is none of that name."""
        publisher = self._publishers.get(topic)
        return publisher is not None and publisher.get_subscription_count() > 0

    def any_listened(self) -> bool:
        """Return whether anybody listens to any topic."""
        return any(self.listened(topic) for topic in self._publishers)

    def offer(self, topic: str, make: Callable[[], Any | None]) -> None:
        """Publish what `make` makes, if it makes something, when somebody listens."""
        if self.listened(topic):
            self.send(topic, make())

    def send(self, topic: str, message: Any | None) -> None:
        """Publish a message, if it is one."""
        if message is not None:
            self._publishers[topic].publish(message)

    def unmatched(self) -> int:
        """Return how many subscribers cannot be served, for their QoS does not fit."""
        publishers = self._publishers.values()
        return sum(max(0, self._node.count_subscribers(p.topic_name) - p.get_subscription_count()) for p in publishers)

    def qos_override_names(self) -> list[str]:
        """Return the parameters that override the QoS of the topics."""
        topics = [self._node.resolve_topic_name(topic) for topic in self._publishers]
        return [name for topic in topics for name in override_names(topic, "publisher")]

    def _create(self, name: str, topic: Topic) -> Publisher:
        return self._node.create_publisher(
            message_class(topic.type_name),
            name,
            output_qos(topic.depth),
            event_callbacks=no_events(),
            qos_overriding_options=overridable(),
        )
