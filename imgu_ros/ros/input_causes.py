# SPDX-License-Identifier: Apache-2.0
"""Causes in the input: no images, lost images, missing camera_info, odd headers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rclpy.node import Node

from imgu_ros.messages.header_checks import Oddity, what_becomes
from imgu_ros.ros.causes import Cause, CauseKind
from imgu_ros.ros.graph_checks import is_latched, why_not_offered
from imgu_ros.ros.image_input import ImageInput
from imgu_ros.ros.middleware import against_loss
from imgu_ros.ros.reach import NO_NAME, another_user, has_no_names
from imgu_ros.shown_text import shown

#: Nodes on one machine find each other within this time.
_DISCOVERY_S = 1.0
#: Without images for this long, or for so many times their usual interval, something is wrong.
_SILENCE_S = 1.5
_INTERVALS = 4
#: Share of images that may be lost without a warning.
_LOSS = 0.1
_FEWEST_LOST = 5
#: So many images in a row without a camera_info of their stamp are reported.
_UNPAIRED = 5
_SECOND_NS = 1e9
_MOST_NAMED = 4
_NAME_LENGTH = 100
#: No delay is as long.
_OTHER_CLOCK_S = 60.0


def image_causes(node: Node, source: ImageInput, now_s: float) -> Iterator[Cause]:
    """Yield why no or too few images arrive; nothing while the input is not subscribed or was subscribed just now."""
    if source.unreadable:
        yield Cause(CauseKind.REJECTED, source.unreadable)
        return
    silent_s = source.silent_s(now_s)
    if silent_s >= _DISCOVERY_S:
        cause = why_not_offered(node, source.wanted_images())
        if cause is not None:
            source.offered_since_s = None
            yield cause
            return
    # A publisher that has just appeared is not silent.
    source.offered_since_s = now_s if source.offered_since_s is None else source.offered_since_s
    silent_s = min(silent_s, now_s - source.offered_since_s)
    held_up = source.standstill.lately()
    if held_up:
        yield Cause(CauseKind.HELD_UP, held_up, is_logged=True)
        return
    lost = source.counters.lost_lately(now_s)
    if silent_s >= max(_SILENCE_S, _usual_silence_s(source, now_s)):
        yield _silence(node, source, silent_s, lost, now_s)
    elif lost >= _FEWEST_LOST and lost > _LOSS * (lost + source.arrivals.recent(now_s)):
        came = source.arrivals.recent(now_s)
        share = f"{lost} of the last {lost + came} images on {source.topics.image}"
        yield Cause(CauseKind.LOST, f"{share} got lost on the way; {against_loss()}")


def camera_info_causes(node: Node, source: ImageInput, now_s: float) -> Iterator[Cause]:
    """Yield why images have no camera_info, or not their own."""
    if not source.expects_camera_info or source.open_s(now_s) < _DISCOVERY_S or not source.arrivals.recent(now_s):
        return
    topic, pairing = source.topics.camera_info, source.pairing
    if pairing.last_info_ns is None:
        cause = why_not_offered(node, source.wanted_camera_info())
        text = cause.text if cause is not None else f"nothing comes on {topic}, although it has a publisher"
        if cause is None and is_latched(node, topic):
            kept = f"qos_overrides.{topic}.subscription"
            text += (
                f"; it is sent once and kept (transient_local): set {kept}.reliability to reliable and "
                f"{kept}.durability to transient_local"
            )
        yield Cause(CauseKind.UNCALIBRATED, f"no camera_info on {topic}: {text}")
    elif pairing.misses_in_a_row >= _UNPAIRED and source.infos.recent(now_s) > 1:
        image_s, info_s = (pairing.last_image_ns or 0) / _SECOND_NS, pairing.last_info_ns / _SECOND_NS
        clocks = "" if abs(image_s - info_s) < _OTHER_CLOCK_S else ": of different clocks"
        yield Cause(
            CauseKind.UNPAIRED,
            f"stamps of {topic} and {source.topics.image} do not pair ({pairing.misses_in_a_row} images in a row; "
            f"latest {info_s:.3f} s and {image_s:.3f} s{clocks}): the nearest camera_info is used; need equal stamps",
        )


def publisher_causes(node: Node, source: ImageInput) -> Iterator[Cause]:
    """Yield that several nodes publish the image or the camera_info topic, or that images of several cameras come."""
    cameras = source.headers.cameras
    topics = [source.topics.image, *filter(None, [source.camera_info_topic])]
    shared: dict[str, list[str]] = {}
    for topic in topics:
        names = _publishing_nodes(node, topic)
        if len(names) > 1:
            shared.setdefault(f"{len(names)} nodes ({_named(names)})", []).append(topic)
    told = [f"{nodes} publish {' and '.join(of)}" for nodes, of in shared.items()]
    if cameras and not told:
        told = [f"{source.topics.image} carries images of several cameras"]
    if told:
        yield Cause(CauseKind.PUBLISHERS, f"{'; '.join(told)}: {what_becomes(cameras)}")


def _publishing_nodes(node: Node, topic: str) -> list[str]:
    # A node that was killed is in the graph for a while after it has started again.
    found = {f"{e.node_namespace.rstrip('/')}/{e.node_name}" for e in node.get_publishers_info_by_topic(topic)}
    return sorted(shown(name, _NAME_LENGTH) for name in found if NO_NAME not in name)


def _named(names: Sequence[str]) -> str:
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return ", ".join(names[:_MOST_NAMED]) + more


def header_causes(source: ImageInput, camera_frame: str) -> Iterator[Cause]:
    """Yield what is odd about the headers of the images that come; `camera_frame` is the parameter `frames.camera`."""
    for oddity, text in source.headers.told(camera_frame, lately=True).items():
        if oddity is Oddity.SHARED:
            continue  # `publisher_causes` names the publishers
        kind = CauseKind.FRAME_ID if oddity.is_about_frames else CauseKind.STAMPS
        yield Cause(kind, text, case=oddity.value)


def _usual_silence_s(source: ImageInput, now_s: float) -> float:
    """Return how long it may take until the next image comes, by those that came lately."""
    rate_hz = source.arrivals.rate_hz(now_s)
    return _INTERVALS / rate_hz if rate_hz else 0.0


def _silence(node: Node, source: ImageInput, silent_s: float, lost: int, now_s: float) -> Cause:
    said = f"no images on {source.topics.image} for {silent_s:.0f} s"
    # Images far too large for the shared memory never arrive, so that nothing else tells their size.
    if lost:
        return Cause(CauseKind.LOST, f"{said}: {lost} got lost on the way; {against_loss()}")
    infos_hz = source.infos.rate_hz(now_s)
    if infos_hz:
        there = f"{source.topics.camera_info} comes at {infos_hz:.0f} Hz"
        return Cause(CauseKind.LOST, f"{said}, while {there}: they may get lost on the way; {against_loss()}")
    publishers = node.get_publishers_info_by_topic(source.topics.image)
    nameless = has_no_names(publishers)
    # Images came before, so the processes can reach each other.
    why = another_user(nameless) if nameless or not source.arrivals.count else ""
    question = "" if nameless and why else "does the camera run?"
    return Cause(CauseKind.SILENT, f"{said}, although it has a publisher: {' '.join(filter(None, (question, why)))}")
