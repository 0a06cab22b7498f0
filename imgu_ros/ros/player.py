# SPDX-License-Identifier: Apache-2.0
"""Publishes a recorded bag on live topics, with its timing."""

from __future__ import annotations

import contextlib
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock

from imgu_ros.bags.prefetch import Prefetch
from imgu_ros.bags.reading import Bag, open_bag
from imgu_ros.bags.storage import RawMessage
from imgu_ros.config.parameters import DEFAULT_LIMITS, LimitsParameters
from imgu_ros.errors import BagError, ImguError
from imgu_ros.messages.header import clock_message
from imgu_ros.ros.messages import make_message, message_class
from imgu_ros.ros.middleware import large_message_warnings, profile_line
from imgu_ros.ros.playback_timing import PlaybackClock, PlayReport, Span
from imgu_ros.ros.process import init_ros, spare_collector
from imgu_ros.ros.qos import latched_qos, output_qos, overridable
from imgu_ros.ros.reach import domain_text, elsewhere
from imgu_ros.ros.stopping import StopRequested, StopSignal

IMAGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
CAMERA_INFO_TYPE = "sensor_msgs/msg/CameraInfo"

_POLL_S = 0.02
_REMIND_S = 5.0
_CLOCK_PERIOD_S = 0.025
#: A matched writer may still be unknown to the reader, which then drops its messages.
_SETTLE_S = 0.5
_DISCOVERY_S = 1.0
_ACKNOWLEDGE_S = 2.0
_LONGEST_SLEEP_S = 3600.0
_LINGER_S = 0.5


@dataclass(frozen=True, slots=True)
class PlayOptions:
    """How to play.

    Attributes
    ----------
    rate : times the recorded speed, > 0
    loop : start over at the end, until stopped
    start_s : seconds to leave out at the beginning
    duration_s : seconds of the recording to play; None: to the end
    wait_for : subscribers, over all image topics, to wait for; 0: start after at most a second
    timeout_s : longest wait for them; None: no bound
    limits : what reading the bag may cost
    """

    rate: float = 1.0
    loop: bool = False
    start_s: float = 0.0
    duration_s: float | None = None
    wait_for: int = 0
    timeout_s: float | None = None
    limits: LimitsParameters = DEFAULT_LIMITS


def play(
    paths: Sequence[Path],
    options: PlayOptions,
    ros_arguments: Sequence[str],
    stop: StopSignal,
    say: Callable[[str], None],
) -> PlayReport:
    """Publish the messages of a bag with the bag's timing, headers untouched, and `/clock` beside them.

    Parameters
    ----------
    paths : one bag, or the files of one
    ros_arguments : `--ros-args ...`, for remaps and QoS overrides
    stop : entered already
    say : takes lines for people

    Raises
    ------
    BagError
        If the bag cannot be read or has nothing to publish.
    ParameterError
        If the ROS arguments cannot be parsed.
    """
    with stop.interruptible():
        init_ros(ros_arguments)
    try:
        with open_bag(paths, limits=options.limits) as bag:
            player = _Player(bag, options, stop, say)
            try:
                return player.run()
            finally:
                player.close()
    finally:
        rclpy.try_shutdown()


class _Player:
    def __init__(self, bag: Bag, options: PlayOptions, stop: StopSignal, say: Callable[[str], None]) -> None:
        self._bag = bag
        self._options = options
        self._stop = stop
        self._say = say
        self._node = Node("player", start_parameter_services=False, enable_rosout=False)
        self._node.get_logger().debug(profile_line())
        self._types = {topic.name: topic.type_name for topic in bag.topics if topic.count != 0}
        self._publishers: dict[str, Publisher] = {}
        self._skipped: list[str] = []
        self._published: dict[str, int] = {}
        self._late_s: deque[float] = deque(maxlen=100_000)
        self._span = Span()
        self._clock = self._node.create_publisher(Clock, "/clock", output_qos(1))
        self._clock_due = 0.0

    def run(self) -> PlayReport:
        self._create_publishers()
        with contextlib.suppress(StopRequested):
            self._wait_for_subscribers()
            spare_collector()
            self._publish_all()
        self._finish()
        for warning in self._bag.warnings:
            self._say(f"imgu: warning: {warning}")
        late = np.percentile(self._late_s, (99, 100)) * 1e3 if self._late_s else (0.0, 0.0)
        return PlayReport(
            published=self._published,
            skipped_topics=tuple(self._skipped),
            recorded_s=self._span.recorded_s,
            took_s=self._span.took_s,
            late_p99_ms=float(late[0]),
            late_max_ms=float(late[1]),
        )

    def close(self) -> None:
        self._node.destroy_node()

    def _create_publishers(self) -> None:
        for topic, type_name in self._types.items():
            kind = self._class_of(topic, type_name)
            if kind is None:
                continue
            try:
                publisher = self._node.create_publisher(kind, topic, _qos(topic), qos_overriding_options=overridable())
            # A name that ROS 2 refuses, as other recorders write them, or a QoS override that it cannot read.
            except (NameValidationException, ValueError, RuntimeError) as error:
                self._skip(topic, " ".join(str(error).split()))
                continue
            self._publishers[topic] = publisher
            self._published[topic] = 0
        if not self._publishers:
            raise BagError("bag: no topic can be published; need messages whose types are installed")

    def _class_of(self, topic: str, type_name: str) -> Any:
        if topic == "/clock":
            self._skip(topic, "the player publishes its own")
            return None
        try:
            return message_class(type_name)
        except ImguError:
            self._skip(topic, f"{type_name} is not installed" if type_name else "its type is not known")
            return None

    def _skip(self, topic: str, reason: str) -> None:
        self._skipped.append(topic)
        self._say(f"skipping {topic}: {reason}")

    def _wait_for_subscribers(self) -> None:
        images = [t for t in self._publishers if self._types[t] in IMAGE_TYPES] or list(self._publishers)
        wanted = self._options.wait_for
        started = time.monotonic()
        bound = _DISCOVERY_S if wanted == 0 else self._options.timeout_s
        remind = started + _DISCOVERY_S
        while self._matched(images) < max(wanted, 1):
            now = time.monotonic()
            if bound is not None and now - started >= bound:
                if wanted:
                    raise BagError(
                        f"subscribers on {', '.join(images)}: {self._matched(images)} after {bound:g} s; need {wanted} "
                        f"({domain_text(self._node)}{self._elsewhere()})"
                    )
                return
            if wanted and now >= remind:
                have = f"{self._matched(images)} of {wanted} ({domain_text(self._node)}{self._elsewhere()})"
                hint = " (`imgu node` subscribes once one of its outputs has a subscriber)"
                self._say(f"waiting for subscribers on {', '.join(images)}: {have}{hint}")
                remind = now + _REMIND_S
            self._sleep(_POLL_S)
        # Who subscribes to images mostly wants their camera_info from the first one on.
        infos = [t for t in self._publishers if self._types[t] == CAMERA_INFO_TYPE]
        until = time.monotonic() + _DISCOVERY_S
        while infos and not self._matched(infos) and time.monotonic() < until:
            self._sleep(_POLL_S)
        self._sleep(_SETTLE_S)

    def _elsewhere(self) -> str:
        hint = elsewhere(self._node)
        return f"; {hint}" if hint else ""

    def _matched(self, topics: Sequence[str]) -> int:
        return sum(self._publishers[topic].get_subscription_count() for topic in topics)

    def _publish_all(self) -> None:
        while True:
            with contextlib.closing(Prefetch(self._selected(), lambda m: len(m.data))) as messages:
                messages.wait_filled(0.5)
                # A new one for each round: the gap between the rounds is not a delay.
                pace = PlaybackClock(self._options.rate)
                for message in messages:
                    self._sleep_until(pace.earliest(message.time_ns), message.time_ns)
                    self._late_s.append(pace.published(message.time_ns))
                    self._publish(message)
                    self._span.add(message.time_ns, time.monotonic())
            if not pace.has_begun:
                raise BagError("bag: no message in the chosen part; need a later end or an earlier start")
            if not self._options.loop:
                return
            self._span.next_round()

    def _selected(self) -> Iterator[RawMessage]:
        start_ns = self._bag.start_ns + round(self._options.start_s * 1e9)
        duration = self._options.duration_s
        for message in self._bag.cdr_messages(tuple(self._publishers)):
            if duration is not None and message.time_ns > start_ns + duration * 1e9:
                return
            if message.time_ns >= start_ns:
                yield message

    def _publish(self, message: RawMessage) -> None:
        topic = message.channel.topic
        self._publishers[topic].publish(message.data)
        self._published[topic] += 1
        # What a process sends must fit its own shared memory; a large message that comes later is not looked at.
        if self._published[topic] == 1 and self._types[topic] in IMAGE_TYPES:
            for line in large_message_warnings(len(message.data)):
                self._say(f"imgu: warning: {topic}: {line}")

    def _sleep_until(self, due: float, time_ns: int) -> None:
        """Sleep until a message of `time_ns` is due, and publish /clock meanwhile when it has subscribers."""
        while True:
            now = time.monotonic()
            listened = self._clock.get_subscription_count() > 0
            if listened and (now >= self._clock_due or now >= due):
                ahead = max(0.0, due - now) * self._options.rate
                self._clock.publish(clock_message(make_message, time_ns - round(ahead * 1e9)))
                self._clock_due = now + _CLOCK_PERIOD_S
            if now >= due:
                return
            self._sleep(min(due, self._clock_due) - now if listened else due - now)

    def _sleep(self, seconds: float) -> None:
        # A gap of years, or a rate near 0: no timer waits so long at once, and who called looks again.
        if self._stop.wait(min(max(0.0, seconds), _LONGEST_SLEEP_S)):
            raise StopRequested

    def _finish(self) -> None:
        """Let subscribers have the last messages before the publishers go."""
        until = time.monotonic() + (0.0 if self._stop.requested else _ACKNOWLEDGE_S)
        for publisher in self._publishers.values():
            while time.monotonic() < until and not publisher.wait_for_all_acked(Duration(seconds=0.05)):
                pass
        # Best-effort subscribers acknowledge nothing.
        self._stop.wait(_LINGER_S)


def _qos(topic: str) -> QoSProfile:
    return latched_qos() if topic.rpartition("/")[2] == "tf_static" else output_qos(30)
