# SPDX-License-Identifier: Apache-2.0
"""Functions of rosbags that its documentation does not name and that `bags/` calls: a change of theirs fails here."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import pytest
from rosbags.interfaces import Nodetype
from rosbags.serde.cdr import generate_deserialize_cdr
from rosbags.serde.ros1 import generate_deserialize_ros1
from rosbags.typesys import get_types_from_msg
from rosbags.typesys.base import make_typesdict, normalize_fieldname
from rosbags.typesys.idl import IDLParser
from rosbags.typesys.msg import normalize_msgtype
from rosbags.typesys.store import Typestore

_DEFINITION = "std_msgs/Header header\nstring[2] names\nuint8[] data\n"


@pytest.mark.parametrize(
    ("function", "parameters"),
    [
        (generate_deserialize_cdr, ["fields", "typestore", "endianness"]),
        (generate_deserialize_ros1, ["fields", "typestore"]),
        (make_typesdict, ["msgs"]),
        (normalize_fieldname, ["name"]),
        (normalize_msgtype, ["name"]),
        (IDLParser.regex, ["self", "pos", "pattern", "flags"]),
        (Typestore.get_msgdef, ["self", "typename"]),
        (Typestore.deserialize_cdr, ["self", "rawdata", "typename"]),
        (Typestore.deserialize_ros1, ["self", "rawdata", "typename"]),
    ],
)
def test_parameters_of_what_is_called_or_overridden(function: Callable[..., Any], parameters: list[str]) -> None:
    assert list(inspect.signature(function).parameters) == parameters


def test_fields_are_described_by_a_node_and_its_detail() -> None:
    """What `definitions.py` counts, and `messages.py` converts by."""
    ((_, fields),) = get_types_from_msg(_DEFINITION, "a/msg/B").values()
    assert fields == [
        ("header", (Nodetype.NAME, "std_msgs/msg/Header")),
        ("names", (Nodetype.ARRAY, ((Nodetype.BASE, ("string", 0)), 2))),
        ("data", (Nodetype.SEQUENCE, ((Nodetype.BASE, ("uint8", 0)), 0))),
    ]


def test_a_store_reads_with_what_get_msgdef_returns() -> None:
    """`MessageReader` gives another object in its place, with fields, cls and deserialisers made on demand."""
    asked: list[str] = []

    class Store(Typestore):
        def get_msgdef(self, typename: str) -> Any:
            asked.append(typename)
            return super().get_msgdef(typename)

    store = Store()
    store.register(get_types_from_msg("string data", "a/msg/B"))
    assert {"fielddefs", "types", "cache"} <= vars(store).keys()
    message: Any = store.deserialize_cdr(b"\0\1\0\0\x03\0\0\0ab\0", "a/msg/B")
    assert message.data == "ab"
    assert asked
    known = store.get_msgdef("a/msg/B")
    assert callable(known.deserialize_cdr_le)
    assert callable(known.deserialize_cdr_be)
    assert callable(known.deserialize_ros1)


def test_the_parser_of_idl_goes_through_regex() -> None:
    """`_BoundedIdlParser` counts its steps there."""
    steps = 0

    class Parser(IDLParser):
        def regex(self, pos: int, pattern: str, flags: int = 0) -> Any:
            nonlocal steps
            steps += 1
            return super().regex(pos, pattern, flags)

    types = make_typesdict(Parser("module a { module msg { struct B { octet c; }; }; };").specification())
    assert steps > 10
    assert types == {"a/msg/B": ([], [("c", (Nodetype.BASE, ("byte", 0)))])}
