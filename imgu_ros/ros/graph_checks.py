# SPDX-License-Identifier: Apache-2.0
"""Checks of the graph: whether a subscription has a publisher of its type with a compatible quality of service."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSCompatibility, QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy, qos_check_compatible

from imgu_ros.ros.causes import Cause, CauseKind
from imgu_ros.ros.reach import domain_text, elsewhere

#: Number of topics on the graph that are examined, the most similar names first, and of those that are named.
_MOST_LOOKED_AT = 12
_MOST_NAMED = 3
#: Names at least so similar are named although their type differs.
_ALIKE = 0.6
_COMPRESSED = "sensor_msgs/msg/CompressedImage"
_IMAGES = ("sensor_msgs/msg/Image", _COMPRESSED)


@dataclass(frozen=True, slots=True)
class Wanted:
    """What a subscription asks for.

    Attributes
    ----------
    topic : resolved name
    type_name : "package/msg/Name"
    qos : as asked for, overrides included
    remapped : the name on the left of a remap rule that leads to the topic ("image_raw")
    """

    topic: str
    type_name: str
    qos: QoSProfile
    remapped: str


@dataclass(frozen=True, slots=True)
class Offer:
    """A topic that another node publishes, and its types."""

    topic: str
    types: tuple[str, ...]


def why_not_offered(node: Node, wanted: Wanted) -> Cause | None:
    """Return why no publisher can serve a subscription, and what to do; None when one can."""
    endpoints = node.get_publishers_info_by_topic(wanted.topic)
    if not endpoints:
        return Cause(CauseKind.NO_PUBLISHER, f"no publisher on {wanted.topic}; {_instead(node, wanted)}")
    of_type = [endpoint for endpoint in endpoints if endpoint.topic_type == wanted.type_name]
    if not of_type:
        types = sorted({endpoint.topic_type for endpoint in endpoints})
        need = f"need {wanted.type_name}{_hint_of_type(wanted, types)}"
        return Cause(CauseKind.WRONG_TYPE, f"only {', '.join(types)} on {wanted.topic}; {need}")
    if any(_fits(endpoint.qos_profile, wanted.qos) for endpoint in of_type):
        return None
    misfit = of_type[0]
    why = f"{_name(misfit)} {_misfits(misfit.qos_profile, wanted.qos, wanted.topic, 'subscription')}"
    return Cause(CauseKind.QOS, f"only publishers with incompatible QoS on {wanted.topic}: {why}")


def why_not_served(node: Node, publishers: Iterable[Any]) -> list[Cause]:
    """Return a cause for each publisher of this node that has subscribers with an incompatible quality of service."""
    causes = []
    for publisher in publishers:
        if node.count_subscribers(publisher.topic_name) <= publisher.get_subscription_count():
            continue
        for endpoint in node.get_subscriptions_info_by_topic(publisher.topic_name):
            if not _fits(publisher.qos_profile, endpoint.qos_profile):
                said = _misfits(publisher.qos_profile, endpoint.qos_profile, publisher.topic_name, "publisher")
                who = f"listener {_name(endpoint)} of {publisher.topic_name}"
                causes.append(Cause(CauseKind.LISTENER, f"{who} cannot be served: this node {said}"))
                break
    return causes


def is_latched(node: Node, topic: str) -> bool:
    """Return whether every publisher of a topic keeps its last messages for subscribers that ask for them."""
    endpoints = node.get_publishers_info_by_topic(topic)
    kept = [e.qos_profile.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL for e in endpoints]
    return bool(kept) and all(kept)


def similar_topics(node: Node, topic: str, type_name: str) -> list[Offer]:
    """Return the topics that others publish and that may be meant: those of the type first, the most alike first."""
    known = [Offer(name, tuple(types)) for name, types in node.get_topic_names_and_types() if name != topic]

    def likeness(offer: Offer) -> tuple[bool, float]:
        return type_name in offer.types, difflib.SequenceMatcher(None, offer.topic, topic).ratio()

    likely = [offer for offer in known if likeness(offer)[0] or likeness(offer)[1] >= _ALIKE]
    likely = sorted(likely, key=likeness, reverse=True)[:_MOST_LOOKED_AT]
    return [offer for offer in likely if _is_published_by_others(node, offer.topic)][:_MOST_NAMED]


def _instead(node: Node, wanted: Wanted) -> str:
    for transport, topic in _of_another_transport(wanted):
        if any(endpoint.topic_type in _IMAGES for endpoint in node.get_publishers_info_by_topic(topic)):
            return f"{topic} has one: set image_transport to {transport}"
    similar = similar_topics(node, wanted.topic, wanted.type_name)
    same = [offer.topic for offer in similar if wanted.type_name in offer.types]
    if same:
        return f"{wanted.type_name} is on {', '.join(same)}: remap with -r {wanted.remapped}:={same[0]}"
    unpublished = f"{wanted.type_name} has no publisher in {domain_text(node)}"
    if not similar:
        hint = elsewhere(node)
        return f"{unpublished}: is the camera's driver running?{f' {hint[0].upper()}{hint[1:]}' if hint else ''}"
    others = ", ".join(f"{offer.topic} ({', '.join(offer.types)})" for offer in similar)
    return (
        f"{unpublished}; similar names: {others}{_hint_of_type(wanted, [t for offer in similar for t in offer.types])}"
    )


def _of_another_transport(wanted: Wanted) -> Iterator[tuple[str, str]]:
    """Yield the other transport under which the same images may be there, and the topic that it has then."""
    if wanted.type_name == _COMPRESSED and wanted.topic.endswith("/compressed"):
        yield "raw", wanted.topic.removesuffix("/compressed")
    elif wanted.type_name in _IMAGES:
        yield "compressed", f"{wanted.topic}/compressed"


def _hint_of_type(wanted: Wanted, types: Sequence[str]) -> str:
    if wanted.type_name != _COMPRESSED and _COMPRESSED in types and wanted.type_name.endswith("Image"):
        return ": set image_transport to compressed"
    if wanted.type_name == _COMPRESSED and "sensor_msgs/msg/Image" in types:
        return ": set image_transport to raw"
    return ""


def _is_published_by_others(node: Node, topic: str) -> bool:
    own = (node.get_namespace(), node.get_name())
    return any((e.node_namespace, e.node_name) != own for e in node.get_publishers_info_by_topic(topic))


def _fits(offered: QoSProfile, asked: QoSProfile) -> bool:
    compatibility, _ = qos_check_compatible(offered, asked)
    return bool(compatibility != QoSCompatibility.ERROR)


def _misfits(offered: QoSProfile, asked: QoSProfile, topic: str, kind: str) -> str:
    """Return what is offered and what is asked for, and which of this node's parameters brings them together.

    `kind` is what this node has: it can only change its own side.
    """
    policies = (
        ("reliability", offered.reliability, asked.reliability, QoSReliabilityPolicy.BEST_EFFORT),
        ("durability", offered.durability, asked.durability, QoSDurabilityPolicy.VOLATILE),
    )
    parts, fixes = [], []
    for policy, given, wanted, weaker in policies:
        if given == weaker != wanted:
            parts.append(f"{given.name.lower()} {policy}, not {wanted.name.lower()}")
            value = given if kind == "subscription" else wanted
            fixes.append(f"qos_overrides.{topic}.{kind}.{policy} to {value.name.lower()}")
    if not parts:
        _, reason = qos_check_compatible(offered, asked)
        return f"does not fit ({' '.join(reason.split()).rstrip(';')})"
    return f"offers {' and '.join(parts)}; set {' and '.join(fixes)}"


def _name(endpoint: Any) -> str:
    # A participant that is just discovered has no name yet; rclpy then says so in capitals.
    name = f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"
    return "a node" if "_UNKNOWN_" in name else name
