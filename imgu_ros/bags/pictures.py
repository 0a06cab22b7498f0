# SPDX-License-Identifier: Apache-2.0
"""The pictures of a bag's image topic, without their camera_info: for those who are about to make one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from imgu_ros.bags.image_choice import choose_image_topic
from imgu_ros.bags.reading import Bag
from imgu_ros.config.parameters import DEFAULT_LIMITS, LimitsParameters
from imgu_ros.errors import EncodingError
from imgu_ros.messages.frame import decode_frame
from imgu_ros.messages.header import decode_header
from imgu_ros.remarks import Remarks
from imgu_ros.vision.formation.layout import RawImage


@dataclass(frozen=True, slots=True, eq=False)
class RecordedPicture:
    """One recorded image.

    Attributes
    ----------
    stamp_ns : its header's stamp
    image : decoded; None when it could not be
    reason : why it could not be decoded; empty when it was
    remarks : what people should know of the choice of the topic and of the image, and was not said before
    """

    stamp_ns: int
    image: RawImage | None
    reason: str
    remarks: tuple[str, ...] = ()


def recorded_pictures(
    bag: Bag, topic: str = "", encoding: str = "", *, limits: LimitsParameters = DEFAULT_LIMITS
) -> Iterator[RecordedPicture]:
    """Yield the images of a topic, in the bag's order.

    Parameters
    ----------
    bag : open
    topic : its name; empty: see `choose_image_topic`
    encoding : what the pixels are, instead of what messages say; empty: what they say
    limits : what decoding a picture may cost

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
            frame = decode_frame(message.message, None, rectified=False, encoding=encoding, limits=limits)
        except EncodingError as error:
            yield RecordedPicture(stamp_ns, None, str(error), tuple(remarks.news([choice.remark])))
        else:
            news = tuple(remarks.news((choice.remark, frame.image.remark)))
            yield RecordedPicture(stamp_ns, frame.image, "", news)
