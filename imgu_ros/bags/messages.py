# SPDX-License-Identifier: Apache-2.0
"""Messages of the ROS 2 Jazzy interfaces, without ROS: the bag side's `MessageFactory`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from imgu_ros.bags.viewer_definitions import VIEWER_DEFINITIONS
from imgu_ros.errors import BagError, ShapeError, nearest_name
from imgu_ros.types import Image

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

#: Defaults other than zero that the interfaces give to their fields; rosbags' definitions do not carry them.
_NONZERO_DEFAULTS: dict[str, dict[str, object]] = {"geometry_msgs/msg/Quaternion": {"w": 1.0}}

_SCALAR_DEFAULTS: dict[str, object] = {"bool": False, "string": "", "float32": 0.0, "float64": 0.0}
_DTYPES: dict[str, str] = {"bool": "bool", "byte": "uint8", "char": "uint8"}


def make_message(type_name: str, /, **fields: object) -> Any:
    """Return a message of `type_name` that rosbags can serialise; a `MessageFactory` (see `imgu_ros.messages.factory`).

    Parameters
    ----------
    type_name : "package/msg/Name", one of the interfaces of ROS 2 Jazzy
    **fields : numeric arrays as one-dimensional numpy arrays, messages as messages, sequences of messages as lists;
        what is left out gets the type's default

    Raises
    ------
    BagError
        If the type or a field is unknown.
    ShapeError
        If an array has another length or data type than its field.
    """
    layout = _layout(type_name)
    for name in fields:
        if name not in layout.fields:
            raise BagError(f"{type_name}: no field {name!r}; need one of {', '.join(layout.fields)}")
    values = {
        name: field.convert(fields[name]) if name in fields else field.default()
        for name, field in layout.fields.items()
    }
    return layout.message_class(**values)


@cache
def typestore() -> Typestore:
    """Return rosbags' definitions of the ROS 2 Jazzy interfaces, and those that viewers know, loaded once."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in VIEWER_DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    return store


@cache
def message_layout(type_name: str) -> dict[str, Any]:
    """Return the fields of a type, name -> rosbags' description."""
    known = typestore().fielddefs
    if type_name not in known:
        near = nearest_name(type_name, known)
        hint = f"nearest known: {near}" if near else "need one of ROS 2 Jazzy"
        raise BagError(f"{type_name}: unknown message type; {hint}")
    return dict(known[type_name][1])


@dataclass(frozen=True, slots=True, eq=False)
class _FieldConversion:
    """How a field comes about: from what is given, and when nothing is."""

    convert: Callable[[Any], object]
    default: Callable[[], object]


@dataclass(frozen=True, slots=True, eq=False)
class _Layout:
    """A type's class and its fields: found once, for a frame's results are some fifty messages."""

    message_class: Callable[..., Any]
    fields: Mapping[str, _FieldConversion]


@cache
def _layout(type_name: str) -> _Layout:
    fields = {
        name: _FieldConversion(_converter(f"{type_name}.{name}", kind), _default(kind))
        for name, kind in message_layout(type_name).items()
    }
    for name, value in _NONZERO_DEFAULTS.get(type_name, {}).items():
        fields[name] = replace(fields[name], default=partial(_same, value))
    return _Layout(typestore().types[type_name], fields)


def _default(kind: Any) -> Callable[[], object]:
    """Return what makes a field's default: new arrays, lists and messages for each message."""
    node, detail = kind
    if node == Nodetype.NAME:
        return partial(make_message, detail)
    if node == Nodetype.BASE:
        return partial(_same, _SCALAR_DEFAULTS.get(detail[0], 0))
    element, length = detail if node == Nodetype.ARRAY else (detail[0], 0)
    dtype = _dtype(element)
    if dtype:
        return partial(np.zeros, length, dtype)
    make = _default(element)
    return lambda: [make() for _ in range(length)]


def _converter(name: str, kind: Any) -> Callable[[Any], object]:
    """Return what makes a field's value of what is given for it."""
    node, detail = kind
    if node not in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        return _same
    length = detail[1] if node == Nodetype.ARRAY else None
    dtype = _dtype(detail[0])
    if dtype is None:
        return partial(_converted_list, name, length)
    return partial(_converted_array, name, length, dtype)


def _same(value: object) -> object:
    return value


def _converted_list(name: str, length: int | None, value: Any) -> list[Any]:
    if length is not None and len(value) != length:
        raise ShapeError(f"{name}: {len(value)} elements; need {length}")
    return list(value)


def _converted_array(name: str, length: int | None, dtype: np.dtype[Any], value: Any) -> Image:
    array = np.frombuffer(value, dtype) if isinstance(value, bytes | bytearray | memoryview) else np.asarray(value)
    if array.ndim != 1 or (length is not None and len(array) != length):
        raise ShapeError(f"{name}: shape {array.shape}; need ({'N' if length is None else length},)")
    if array.dtype != dtype and array.size and not np.can_cast(array.dtype, dtype, "same_kind"):
        raise ShapeError(f"{name}: data type {array.dtype}; need {dtype}")
    return np.ascontiguousarray(array, dtype)


def _dtype(element: Any) -> np.dtype[Any] | None:
    """Return the data type of a numeric array's elements; None for strings and messages."""
    node, detail = element
    if node != Nodetype.BASE or detail[0] == "string":
        return None
    name: str = detail[0]
    return np.dtype(_DTYPES.get(name, name))
