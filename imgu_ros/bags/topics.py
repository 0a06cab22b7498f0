# SPDX-License-Identifier: Apache-2.0
"""Find the image topic of a bag and the camera_info beside it."""

from __future__ import annotations

from collections.abc import Sequence

from imgu_ros.bags.reading import BagTopic
from imgu_ros.errors import BagError, ParameterError, nearest_name

IMAGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
CAMERA_INFO_TYPE = "sensor_msgs/msg/CameraInfo"


def find_image_topic(topics: Sequence[BagTopic], name: str = "") -> BagTopic:
    """Return the topic with the images.

    Parameters
    ----------
    topics : the bag's
    name : the wanted one, the parameter `image_topic`; empty: the first of an image type that has messages, else the
        first of an image type

    Raises
    ------
    BagError
        If the bag has no image topic.
    ParameterError
        If the named topic is not in the bag, or is not of an image type.
    """
    if name:
        topic = _named(topics, name, "image_topic")
        if topic.type_name not in IMAGE_TYPES:
            raise ParameterError(f"image_topic: {name} is of type {topic.type_name}; need {' or '.join(IMAGE_TYPES)}")
        return topic
    images = image_topics(topics)
    if not images:
        raise BagError(f"bag: no image topic among {_listed(topics)}; need one of type {' or '.join(IMAGE_TYPES)}")
    return next((topic for topic in images if topic.count), images[0])


def image_topics(topics: Sequence[BagTopic]) -> tuple[BagTopic, ...]:
    """Return the topics of an image type, in the bag's order."""
    return tuple(topic for topic in topics if topic.type_name in IMAGE_TYPES)


def find_camera_info_topic(topics: Sequence[BagTopic], image_topic: str, name: str = "") -> BagTopic | None:
    """Return the topic with the camera_info of an image topic; None when the bag has none (not calibrated).

    Parameters
    ----------
    topics : the bag's
    image_topic : name of the image topic; a transport's name at its end ("/compressed") does not count
    name : the wanted one, the parameter `camera_info_topic`; empty: `camera_info` in the image topic's namespace

    Raises
    ------
    ParameterError
        If the named topic is not in the bag, or is not of type CameraInfo.
    """
    if name:
        topic = _named(topics, name, "camera_info_topic")
        if topic.type_name != CAMERA_INFO_TYPE:
            raise ParameterError(f"camera_info_topic: {name} is of type {topic.type_name}; need {CAMERA_INFO_TYPE}")
        return topic
    base = image_topic.removesuffix("/compressed")
    sibling = f"{base.rpartition('/')[0]}/camera_info"
    return next((t for t in topics if _same(t.name, sibling) and t.type_name == CAMERA_INFO_TYPE), None)


def _named(topics: Sequence[BagTopic], name: str, parameter: str) -> BagTopic:
    for topic in topics:
        if _same(topic.name, name):
            return topic
    if not topics:
        raise ParameterError(f"{parameter}: {name} is not in the bag; the bag has no topics")
    near = nearest_name(name, [topic.name for topic in topics])
    nearest = f"nearest: {near}; " if near else ""
    raise ParameterError(f"{parameter}: {name} is not in the bag; {nearest}topics: {_listed(topics)}")


def _same(one: str, other: str) -> bool:
    return one.lstrip("/") == other.lstrip("/")


def _listed(topics: Sequence[BagTopic]) -> str:
    shown = ", ".join(f"{topic.name} ({topic.type_name or 'unknown type'})" for topic in topics[:20])
    return (shown + (f" and {len(topics) - 20} others" if len(topics) > 20 else "")) or "its topics (it has none)"
