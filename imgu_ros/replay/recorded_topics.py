# SPDX-License-Identifier: Apache-2.0
"""Topics of a replay's results bag: those that always are in it, and those on request."""

from __future__ import annotations

import re
from collections.abc import Sequence

from imgu_ros.errors import ParameterError
from imgu_ros.nearest_name import nearest_name

#: Always recorded.
FRAME_TOPICS = ("homography", "status")
TARGET_TOPICS = ("outline", "pose", "odom")
#: Recorded on request; beside them `pyramid/level_<k>`.
OPTIONAL_TOPICS = ("keypoints", "matches", "path", "image_color", "image_mono", "debug_image")

_LEVEL = re.compile(r"pyramid/level_(\d{1,2})")


def checked_record(record: Sequence[str]) -> tuple[str, ...]:
    """Return the topics to record, relative and each once.

    Raises
    ------
    ParameterError
        If there is no such output; the message names the nearest.
    """
    names = tuple(dict.fromkeys(name.removeprefix("/") for name in record))
    for name in names:
        if name not in OPTIONAL_TOPICS and pyramid_level(name) is None and name not in FRAME_TOPICS + TARGET_TOPICS:
            near = nearest_name(name, OPTIONAL_TOPICS)
            hint = f" (nearest: {near})" if near else ""
            raise ParameterError(
                f"--record: {name!r} is no output{hint}; need one of {', '.join(OPTIONAL_TOPICS)}, pyramid/level_<k>"
            )
    return tuple(name for name in names if name not in FRAME_TOPICS + TARGET_TOPICS)


def pyramid_level(topic: str) -> int | None:
    """Return the number of the level when the topic is `pyramid/level_<k>`."""
    level = _LEVEL.fullmatch(topic)
    return int(level[1]) if level else None
