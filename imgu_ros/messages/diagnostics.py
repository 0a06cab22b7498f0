# SPDX-License-Identifier: Apache-2.0
"""The health of a node -> diagnostic_msgs/DiagnosticArray."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from imgu_ros.messages.factory import MessageFactory
from imgu_ros.messages.header import Header, header_message
from imgu_ros.shown_text import shown


class HealthLevel(IntEnum):
    """Levels of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True, slots=True, eq=False)
class HealthEntry:
    """One entry of a node's health: subject, level, message and figures."""

    name: str
    level: HealthLevel
    message: str
    values: Mapping[str, object]


def diagnostics_message(make: MessageFactory, stamp_ns: int, entries: Sequence[HealthEntry]) -> Any:
    """Return a diagnostic_msgs/DiagnosticArray; figures that are floats get three decimals, text is `shown`."""
    return make(
        "diagnostic_msgs/msg/DiagnosticArray",
        header=header_message(make, Header(stamp_ns, "")),
        status=[
            make(
                "diagnostic_msgs/msg/DiagnosticStatus",
                level=int(entry.level),
                name=entry.name,
                message=shown(entry.message),
                values=[
                    make("diagnostic_msgs/msg/KeyValue", key=key, value=_text(value))
                    for key, value in entry.values.items()
                ],
            )
            for entry in entries
        ],
    )


def _text(value: object) -> str:
    return f"{value:.3f}" if isinstance(value, float) else shown(str(value))
