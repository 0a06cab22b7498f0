# SPDX-License-Identifier: Apache-2.0
"""The images of a recording: the choice of the image topic when none is named, and the decoded images of a topic."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

from imgu_ros.bags.frame_files import UnreadableFrame
from imgu_ros.bags.reading import Bag, BagTopic
from imgu_ros.bags.topics import find_camera_info_topic, find_image_topic, image_topics
from imgu_ros.config.parameters import DEFAULT_LIMITS, LimitsParameters
from imgu_ros.errors import EncodingError
from imgu_ros.messages.frame import decode_frame
from imgu_ros.messages.header import decode_header
from imgu_ros.messages.image import described_encoding
from imgu_ros.remarks import Remarks
from imgu_ros.vision.formation.layout import ColorModel, RawImage


@dataclass(frozen=True, slots=True)
class ImageChoice:
    """The image topic to read.

    Attributes
    ----------
    topic : its name, type and number of messages
    remark : the chosen topic and the others, when it was chosen among several; else empty
    """

    topic: BagTopic
    remark: str = ""


def choose_image_topic(
    bag: Bag, name: str = "", encoding: str = "", *, limits: LimitsParameters = DEFAULT_LIMITS
) -> ImageChoice:
    """Choose the image topic of a bag by its name, else by the first messages of each topic.

    Images of a scene (mosaics, colour, grey) come before generic 8-bit ones, before depth and other measurements, and
    before what cannot be read; then ordinary names before those of thermal cameras, masks and drawings; then topics
    with a camera_info beside them; raw before rectified images; mosaics and colour before grey; uncompressed ones
    first; at last the name decides.

    Parameters
    ----------
    bag : open
    name : the wanted one, the parameter `image_topic`; empty: choose
    encoding : what the pixels are, instead of what messages say: topics whose pixels cannot be that count as unreadable
    limits : bounds of decoding an image

    Raises
    ------
    BagError, ParameterError
        If there is no such topic; see `find_image_topic`.
    """
    first = find_image_topic(bag.topics, name)
    candidates = [topic for topic in image_topics(bag.topics) if topic.count]
    if name or len(candidates) < 2:
        return ImageChoice(first)
    ranked = sorted((_candidate(bag, topic, encoding, limits) for topic in candidates), key=lambda one: one.rank)
    chosen, *others = ranked
    listed = ", ".join(f"{candidate.topic.name} ({candidate.content})" for candidate in others[:_MOST_LISTED])
    more = f" and {len(others) - _MOST_LISTED} more" if len(others) > _MOST_LISTED else ""
    return ImageChoice(
        chosen.topic,
        f"several image topics: reading {chosen.topic.name} ({chosen.content}), not {listed}{more}; "
        "set -p image_topic:=NAME",
    )


@dataclass(frozen=True, slots=True, eq=False)
class RecordedImage:
    """One recorded image.

    Attributes
    ----------
    stamp_ns : its header's stamp
    image : decoded; None when it could not be
    reason : why it could not be decoded; empty when it was
    remarks : new remarks for the user on the choice of the topic and on the image
    """

    stamp_ns: int
    image: RawImage | None
    reason: str
    remarks: tuple[str, ...] = ()


def recorded_images(
    bag: Bag, topic: str = "", encoding: str = "", *, limits: LimitsParameters = DEFAULT_LIMITS
) -> Iterator[RecordedImage]:
    """Yield the images of a topic, in the bag's order.

    Parameters
    ----------
    bag : open
    topic : its name; empty: see `choose_image_topic`
    encoding : what the pixels are, instead of what messages say; empty: what they say
    limits : bounds of decoding an image

    Raises
    ------
    BagError, ParameterError
        If there is no such topic; see `choose_image_topic`.
    """
    choice = choose_image_topic(bag, topic, encoding, limits=limits)
    remarks = Remarks()
    for message in bag.messages([choice.topic.name]):
        stamp_ns = decode_header(message.message).stamp_ns
        try:
            if isinstance(message.message, UnreadableFrame):
                raise EncodingError(message.message.reason)
            frame = decode_frame(message.message, None, rectified=False, encoding=encoding, limits=limits)
        except EncodingError as error:
            yield RecordedImage(stamp_ns, None, str(error), tuple(remarks.news([choice.remark])))
        else:
            news = tuple(remarks.news((choice.remark, frame.image.remark)))
            yield RecordedImage(stamp_ns, frame.image, "", news)


#: Messages of a topic that are tried: the first may be damaged.
_TRIED = 3
_MOST_LISTED = 8

#: Words in names of topics that hold no image of the scene, or an unusual one.
_MEASURED = frozenset("depth disparity confidence flow points pointcloud distance costmap".split())
_DRAWN = frozenset(
    "mask masks segmentation segmented semantic label labels instance debug annotated annotation overlay heatmap "
    "detection detections result results visualization visualisation rendered".split()
)
_INFRARED = frozenset(
    "thermal ir infra infrared lwir nir nearir range intensity reflectivity reflec signal amplitude".split()
)
_WORD = re.compile(r"[a-z]+")
_PICTURES = {
    **dict.fromkeys((ColorModel.BAYER, ColorModel.RGB, ColorModel.BGR, ColorModel.RGBA, ColorModel.BGRA), 0),
    **dict.fromkeys((ColorModel.ARGB, ColorModel.UYVY, ColorModel.YUYV, ColorModel.LUMA), 0),
    ColorModel.MONO: 1,
}


@dataclass(frozen=True, slots=True)
class _Candidate:
    """A topic, a word for its content, and its rank: the lowest is read."""

    topic: BagTopic
    content: str
    rank: tuple[object, ...]


def _candidate(bag: Bag, topic: BagTopic, encoding: str, limits: LimitsParameters) -> _Candidate:
    image: RawImage | None = None
    content = "unreadable"
    for message in islice(bag.messages([topic.name]), _TRIED):
        content = described_encoding(message.message) or "no encoding"
        try:
            image = decode_frame(message.message, None, rectified=False, encoding=encoding, limits=limits).image
        except EncodingError:
            content = f"{content}: unreadable"
        else:
            break
    words = set(_WORD.findall(topic.name.lower()))
    info = find_camera_info_topic(bag.topics, topic.name)
    rectified = any(word.startswith("rect") for word in words)
    rank = (
        _kind(image, words),
        2 if words & _DRAWN else 1 if words & _INFRARED else 0,
        info is None or not info.count,
        rectified,
        0 if image is None else _PICTURES.get(image.layout.color, 2),
        topic.type_name.endswith("CompressedImage"),
        topic.name,
    )
    return _Candidate(topic, content, rank)


def _kind(image: RawImage | None, words: set[str]) -> int:
    """Return 0 for an image of a scene, 1 for generic 8-bit values, 2 for depth by name, 3 by type, 4 for none."""
    if image is None:
        return 4
    is_generic = image.layout.color is ColorModel.BANDS
    if is_generic and image.pixels.dtype.itemsize > 1:
        return 3
    if words & _MEASURED:
        return 2
    return 1 if is_generic else 0
