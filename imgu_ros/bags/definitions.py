# SPDX-License-Identifier: Apache-2.0
"""Make deserialisers of the message definitions in a recording, at bounded cost.

rosbags makes a class and Python code of a definition: code for every element of a fixed array, thirteen functions for
every type, and its IDL parser takes exponential time for nested parentheses. So the text is reduced to the fields, they
are counted before any code is made, and only the function that is needed is made.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

from rosbags.interfaces import Nodetype
from rosbags.serde.cdr import generate_deserialize_cdr
from rosbags.serde.ros1 import generate_deserialize_ros1
from rosbags.typesys import get_types_from_msg
from rosbags.typesys.base import make_typesdict, normalize_fieldname
from rosbags.typesys.idl import IDLParser
from rosbags.typesys.store import Typestore

from imgu_ros.bags.messages import typestore
from imgu_ros.bags.storage import Channel
from imgu_ros.config.parameters import DEFAULT_LIMITS, LimitsParameters
from imgu_ros.errors import BagError

if TYPE_CHECKING:
    from rosbags.interfaces import Msgdef

#: Types within types; a type that contains itself has no end.
_DEEPEST = 100
_LONGEST_NAME = 500
#: Steps of the IDL parser for each field that is allowed; one takes 4 to 16 us, a declaration about 300.
_STEPS = 100
#: What Python takes, bytes: for an object, for a number or an entry of a list, for a text, for an array.
_OBJECT, _NUMBER, _TEXT, _ARRAY = 120, 40, 80, 160

_IDL_SEPARATOR = "=" * 80 + "\n"
#: A text or a comment of IDL; one that does not end goes to the end, so that no other begins in it.
_IDL_TEXT = re.compile(r'"(?:[^"\\]++|\\.)*+"?|//[^\n]*|/\*(?:.*?\*/|.*)', re.DOTALL)
_IDL_ANNOTATION = re.compile(r"@\s*[\w:]+\s*(\([^()]*\))?|^[ \t]*#[^\n]*", re.MULTILINE)


class MessageReader(Typestore):
    """Reads messages of the types of another store; what one message may become in memory is bounded.

    Parameters
    ----------
    types : knows the types
    limits : `message_mb`
    """

    def __init__(self, types: Typestore, limits: LimitsParameters = DEFAULT_LIMITS) -> None:
        super().__init__()
        self.fielddefs, self.types = types.fielddefs, types.types
        self._limits = limits
        self._costs: dict[str, int] = {}
        self._left = 0

    def get_msgdef(self, typename: str) -> Msgdef[object]:
        """Return what reads a type; its writers and converters, which rosbags makes too, are not there."""
        known: Any = self.cache.get(typename)
        if known is None:
            known = self.cache[typename] = _TypeReader(typename, self)  # type: ignore[assignment]
        return known  # type: ignore[no-any-return]

    def deserialize_cdr(self, rawdata: bytes | memoryview, typename: str) -> object:
        """As rosbags does it; BagError where it would take too much memory."""
        self._begin(len(rawdata), typename)
        return super().deserialize_cdr(rawdata, typename)

    def deserialize_ros1(self, rawdata: bytes | memoryview, typename: str) -> object:
        """As rosbags does it; BagError where it would take too much memory."""
        self._begin(len(rawdata), typename)
        return super().deserialize_ros1(rawdata, typename)

    def _begin(self, size: int, typename: str) -> None:
        """Begin a message of `size` bytes: lists of texts take ten times the memory of their bytes."""
        self._left = 1_000_000 * self._limits.message_mb
        most = self._limits.message_mb / 8
        if size > 1_000_000 * most and self._has_texts(typename, set()):
            raise BagError(
                f"{size / 1e6:.0f} MB with lists of texts; need at most {most:g} (an eighth of limits.message_mb)"
            )

    def charged(self, typename: str) -> Callable[..., Any]:
        """Return what makes an object of a type, and refuses to when those of one message would take too much."""
        make, cost = self.types[typename], self._cost(typename)

        def make_charged(*values: Any) -> Any:
            self._left -= cost
            if self._left < 0:
                most = self._limits.message_mb
                raise BagError(f"lists of {typename}: need more memory; need at most {most} MB (limits.message_mb)")
            return make(*values)

        return make_charged

    def _cost(self, typename: str) -> int:
        """Return what the objects of one element take, bytes, without what its own lists of messages hold."""
        if typename not in self._costs:
            self._costs[typename] = _OBJECT + sum(self._field_cost(*kind) for _, kind in self.fielddefs[typename][1])
        return self._costs[typename]

    def _field_cost(self, node: Any, detail: Any) -> int:
        if node == Nodetype.NAME:
            return self._cost(detail)
        if node == Nodetype.BASE:
            return _TEXT if detail[0] == "string" else _NUMBER
        if node == Nodetype.ARRAY and _is_made_singly(detail[0]):
            return int(detail[1]) * self._field_cost(*detail[0])
        return _ARRAY

    def _has_texts(self, typename: str, seen: set[str]) -> bool:
        seen.add(typename)
        fields: list[tuple[str, Any]] = list(self.fielddefs[typename][1])
        for _, (node, detail) in fields:
            element = detail[0] if node in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (node, detail)
            if element[0] == Nodetype.NAME:
                if element[1] not in seen and self._has_texts(element[1], seen):
                    return True
            elif node == Nodetype.SEQUENCE and element[1][0] == "string":
                return True
        return False


class _TypeReader:
    """What rosbags' generated code asks of a type; the code is generated when it is asked for."""

    def __init__(self, typename: str, reader: MessageReader) -> None:
        self._reader = reader
        self.fields = [(normalize_fieldname(name), kind) for name, kind in reader.fielddefs[typename][1]]
        self.cls = reader.charged(typename)

    @cached_property
    def deserialize_cdr_le(self) -> Any:
        return generate_deserialize_cdr(self.fields, self._reader, "le")

    @cached_property
    def deserialize_cdr_be(self) -> Any:
        return generate_deserialize_cdr(self.fields, self._reader, "be")

    @cached_property
    def deserialize_ros1(self) -> Any:
        return generate_deserialize_ros1(self.fields, self._reader)


def defined_types(channel: Channel, limits: LimitsParameters = DEFAULT_LIMITS) -> Typestore | None:
    """Return the types that a channel's definition gives; None when it has none, or one of a format that none reads.

    Raises
    ------
    BagError
        If a type is missing or contains itself, or there is more than `limits` allow.
    Exception
        Whatever a damaged or exotic definition provokes in rosbags' parsers.
    """
    parse = _PARSERS.get(channel.schema_format)
    if not channel.schema or parse is None:
        return None
    if len(channel.schema) > 1_000_000 * limits.text_mb:
        raise BagError(f"{len(channel.schema) / 1e6:.1f} MB; need at most {limits.text_mb} (limits.text_mb)")
    store = Typestore()
    types = _with_dependencies(parse(channel, limits), store.fielddefs)
    if not types[channel.type_name][1] and channel.type_name in typestore().fielddefs:
        return None  # damaged, or as ROS has it anyway
    _check_size(types, channel.type_name, limits)
    store.register(types)
    return store


def _types_from_msg(channel: Channel, limits: LimitsParameters) -> dict[str, Any]:
    """Parse the fields of a .msg text: constants, defaults and comments say nothing of how messages are read."""
    lines: list[str] = []
    # Lines as editors of Windows end them, too.
    for line in channel.schema.replace("\r\n", "\n").replace("\r", "\n").split("\n"):
        words = line.split(maxsplit=3)
        if words and words[0].startswith("@"):
            words = line.split(maxsplit=3)[1:]
        if not words or words[0].startswith("#"):
            continue
        if words[0].startswith("=====") or words[0] == "MSG:":
            lines.append(line)
            continue
        kind, name = words[0], words[1].partition("#")[0] if len(words) > 1 else ""
        if "=" in name or (len(words) > 2 and words[2].startswith("=")):
            continue
        if len(kind) + len(name) > _LONGEST_NAME:
            raise BagError(f"a type and a name of {len(kind) + len(name)} characters; need at most {_LONGEST_NAME}")
        lines.append(f"{kind} {name}")
        _check_count(len(lines), limits)
    return dict(get_types_from_msg("".join(f"{line}\n" for line in lines), channel.type_name))


def _types_from_idl(channel: Channel, limits: LimitsParameters) -> dict[str, Any]:
    if not channel.schema.startswith(f"{_IDL_SEPARATOR}IDL: "):
        return _idl_types(channel.schema, limits)
    types: dict[str, Any] = {}
    for part in channel.schema.split(_IDL_SEPARATOR)[1:]:
        types.update(_idl_types(part.partition("\n")[2], limits))
    return types


def _idl_types(text: str, limits: LimitsParameters) -> dict[str, Any]:
    text = _IDL_TEXT.sub(lambda found: '""' if found[0].startswith('"') else " ", text)
    text = _IDL_ANNOTATION.sub(" ", text)
    _check_count(text.count(";"), limits)
    if re.search(r"<<|[*(]|sequence\s*<\s*sequence", text):
        raise BagError("an expression or a list of lists in IDL; need plain numbers and lists")
    return dict(make_typesdict(_BoundedIdlParser(text, _STEPS * limits.schema_fields).specification()))


class _BoundedIdlParser(IDLParser):
    def __init__(self, text: str, steps: int) -> None:
        super().__init__(text)
        self._steps = steps

    def regex(self, pos: int, pattern: str, flags: int = 0) -> Any:
        self._steps -= 1
        if self._steps < 0:
            raise BagError("IDL too intricate; need fewer declarations, less nested (limits.schema_fields)")
        return super().regex(pos, pattern, flags)


_PARSERS: dict[str, Callable[[Channel, LimitsParameters], dict[str, Any]]] = {
    "ros2msg": _types_from_msg,
    "ros1msg": _types_from_msg,
    "ros2idl": _types_from_idl,
    "omgidl": _types_from_idl,
}


def _check_count(count: int, limits: LimitsParameters) -> None:
    if count > limits.schema_fields:
        raise BagError(f"{count} fields or more; need at most {limits.schema_fields} (limits.schema_fields)")


def _check_size(types: Mapping[str, Any], name: str, limits: LimitsParameters) -> None:
    """Count the fields of a type with all that it contains, each element of a fixed array that is made singly."""
    counts: dict[str, int] = {}

    def count(name: str, depth: int) -> int:
        if depth > _DEEPEST:
            raise BagError(f"{name} is nested more than {_DEEPEST} deep, or in itself")
        if name not in counts:
            fields = types[name][1] if name in types else typestore().fielddefs[name][1]
            counts[name] = sum(field(kind, depth) for _, kind in fields)
            _check_count(counts[name], limits)
        return counts[name]

    def field(kind: Any, depth: int) -> int:
        node, detail = kind
        if node == Nodetype.NAME:
            return 1 + count(detail, depth + 1)
        if node == Nodetype.BASE:
            return 1
        element, length = detail
        if length < 0:
            raise BagError(f"an array of {length} elements")
        single = field(element, depth)
        return 1 + single * length if node == Nodetype.ARRAY and _is_made_singly(element) else 1 + single

    count(name, 0)


def _is_made_singly(element: Any) -> bool:
    """Return whether the elements of an array become an object each: texts and messages."""
    node, detail = element
    return bool(node == Nodetype.NAME or detail[0] == "string")


def _with_dependencies(types: dict[str, Any], known: Mapping[str, Any]) -> dict[str, Any]:
    """Add the types that the definitions mention and do not define, as Jazzy defines them."""
    complete = dict(types)
    open_names = list(types)
    while open_names:
        for _, kind in complete[open_names.pop()][1]:
            node, detail = kind
            while node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
                node, detail = detail[0]
            if node == Nodetype.NAME and detail not in complete and detail not in known:
                if detail not in typestore().fielddefs:
                    raise BagError(f"{detail} is not defined")
                complete[detail] = typestore().fielddefs[detail]
                open_names.append(detail)
    return complete
