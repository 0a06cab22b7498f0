# SPDX-License-Identifier: Apache-2.0
"""Quality of service: profiles of inputs and outputs, and counters of the middleware's events."""

from __future__ import annotations

import time
from typing import Any

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSPolicyKind, QoSProfile, QoSReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from imgu_ros.ros.meters import RateMeter

#: Policies that `qos_overrides.<topic>.<publisher|subscription>.<policy>` can set.
OVERRIDABLE = (QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY)


class QosCounters:
    """Counts a subscription's lost messages and publishers with incompatible QoS, as the middleware reports them."""

    def __init__(self) -> None:
        self._losses = RateMeter()
        self._incompatible = 0

    @property
    def lost(self) -> int:
        """Messages that were published and never delivered."""
        return self._losses.count

    def lost_lately(self, now_s: float) -> int:
        """Return how many were lost in the last seconds, as many as a `RateMeter` looks back."""
        return self._losses.recent(now_s)

    @property
    def incompatible(self) -> int:
        """Number of times that a publisher with incompatible QoS was found."""
        return self._incompatible

    def subscription_callbacks(self) -> SubscriptionEventCallbacks:
        """Return event callbacks that count into this object."""
        return SubscriptionEventCallbacks(message_lost=self._on_lost, incompatible_qos=self._on_incompatible)

    def _on_lost(self, event: Any) -> None:
        self._losses.tick(time.monotonic(), event.total_count_change)

    def _on_incompatible(self, event: Any) -> None:
        self._incompatible += event.total_count_change  # called in the executor's thread alone


def no_events() -> PublisherEventCallbacks:
    """Return no callbacks, not even rclpy's own: each of them slows every turn of the executor."""
    return PublisherEventCallbacks(use_default_callbacks=False)


def image_qos() -> QoSProfile:
    """Return the profile of image inputs: sensor data."""
    return _profile(QoSReliabilityPolicy.BEST_EFFORT, 5)


def camera_info_qos() -> QoSProfile:
    """Return the profile of camera_info inputs: sensor data, small, kept longer than the images they belong to."""
    return _profile(QoSReliabilityPolicy.BEST_EFFORT, 20)


def output_qos(depth: int = 5) -> QoSProfile:
    """Return the profile of outputs and played topics: reliable, so that every kind of subscriber matches."""
    return _profile(QoSReliabilityPolicy.RELIABLE, depth)


def latched_qos(depth: int = 100) -> QoSProfile:
    """Return the profile of topics whose last messages late subscribers still get (/tf_static)."""
    return _profile(QoSReliabilityPolicy.RELIABLE, depth, QoSDurabilityPolicy.TRANSIENT_LOCAL)


def overridable() -> QoSOverridingOptions:
    """Return the option that lets users override the profile by parameters."""
    return QoSOverridingOptions(OVERRIDABLE)


def override_names(resolved_topic: str, kind: str) -> list[str]:
    """Return the parameters that override the QoS of a topic; `kind` is publisher or subscription."""
    return [f"qos_overrides.{resolved_topic}.{kind}.{policy.name.lower()}" for policy in OVERRIDABLE]


def _profile(
    reliability: QoSReliabilityPolicy, depth: int, durability: QoSDurabilityPolicy = QoSDurabilityPolicy.VOLATILE
) -> QoSProfile:
    return QoSProfile(history=QoSHistoryPolicy.KEEP_LAST, depth=depth, reliability=reliability, durability=durability)
