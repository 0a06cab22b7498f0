# SPDX-License-Identifier: Apache-2.0
"""How the codec makes messages without knowing whose they are: rclpy's or rosbags'."""

from __future__ import annotations

from typing import Any, Protocol


class MessageFactory(Protocol):
    """Makes a message of a named type.

    A factory and its messages keep these promises; `imgu_ros.ros.messages.make_message` and
    `imgu_ros.bags.messages.make_message` are the two of this package:

    - numbers, strings and bools are given as Python's own `int`, `float`, `str` and `bool`; a field of type `byte`
      (DiagnosticStatus.level) as an `int` too;
    - numeric arrays, of fixed length or not, are given as one-dimensional numpy arrays of the field's data type
      (uint8 for `data` fields). The factory copies them once or not at all, never element by element;
    - messages are given as messages of the same factory, sequences of messages as lists;
    - a field left out gets the type's default;
    - an unknown type or field is an `ImguError`.
    """

    def __call__(self, type_name: str, /, **fields: object) -> Any:
        """Return a message of `type_name`, "package/msg/Name", with the given fields."""

    def __hash__(self) -> int:
        """Return a number by which messages of this factory can be kept for the next time."""
