# SPDX-License-Identifier: Apache-2.0
"""Topics of a replay's results bag: those that are always in it, and those on request."""

from __future__ import annotations

import re
from collections.abc import Sequence

from imgu_ros.errors import ParameterError, nearest_name
from imgu_ros.messages import results
from imgu_ros.messages.output_topic import OutputTopic, Recording, Scope

_LEVEL = re.compile(r"pyramid/level_\d{1,2}")


def checked_record(record: Sequence[str]) -> tuple[str, ...]:
    """Return the topics to record on request, relative and each once.

    Raises
    ------
    ParameterError
        If there is no such output; the message names the nearest.
    """
    rows = [row for row in results.OUTPUTS if row.scope in (Scope.FRAME, Scope.TARGET)]
    always = [row.name for row in rows if row.recording is Recording.ALWAYS]
    optional = [row.name for row in rows if row.recording is Recording.ON_REQUEST]
    names = tuple(dict.fromkeys(name.removeprefix("/") for name in record))
    for name in names:
        if name not in (*always, *optional) and not _LEVEL.fullmatch(name):
            near = nearest_name(name, optional)
            hint = f" (nearest: {near})" if near else ""
            raise ParameterError(
                f"--record: {name!r} is no output{hint}; need one of {', '.join(optional)}, pyramid/level_<k>"
            )
    return tuple(name for name in names if name not in always)


def is_recorded(topic: str, row: OutputTopic, record: Sequence[str]) -> bool:
    """Return whether the results bag has a topic: `path` asks for that of the map and of every target as well.

    Parameters
    ----------
    topic, row : of `ResultConverter.topics`
    record : of `checked_record`
    """
    asked = topic if row.scope is Scope.LEVEL else row.name.removeprefix("map/")
    return row.recording is Recording.ALWAYS or (row.recording is Recording.ON_REQUEST and asked in record)
