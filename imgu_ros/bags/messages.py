"""Messages of the ROS 2 Jazzy interfaces, without ROS: the bag side's `MessageFactory`."""

from __future__ import annotations

import difflib
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from imgu_ros.errors import BagError, ShapeError

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

#: Defaults other than zero that the interfaces give to their fields; rosbags' definitions do not carry them.
_NONZERO_DEFAULTS: dict[str, dict[str, object]] = {"geometry_msgs/msg/Quaternion": {"w": 1.0}}

_SCALAR_DEFAULTS: dict[str, object] = {"bool": False, "string": "", "float32": 0.0, "float64": 0.0}
_DTYPES: dict[str, str] = {"bool": "bool", "byte": "uint8", "char": "uint8"}


def make_message(type_name: str, /, **fields: object) -> Any:
    """Return a message of `type_name` that rosbags can serialise; a `MessageFactory` (see `imgu_ros.codec.factory`).

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
    layout = message_layout(type_name)
    unknown = fields.keys() - layout.keys()
    if unknown:
        raise BagError(f"{type_name}: no field {sorted(unknown)[0]!r}; need one of {', '.join(layout)}")
    values: dict[str, Any] = {
        name: _converted(f"{type_name}.{name}", kind, fields[name]) if name in fields else _default(kind)
        for name, kind in layout.items()
    }
    for name, value in _NONZERO_DEFAULTS.get(type_name, {}).items():
        if name not in fields:
            values[name] = value
    return typestore().types[type_name](**values)


@cache
def typestore() -> Typestore:
    """Return rosbags' definitions of the ROS 2 Jazzy interfaces, loaded once."""
    return get_typestore(Stores.ROS2_JAZZY)


@cache
def message_layout(type_name: str) -> dict[str, Any]:
    """Return the fields of a type, name -> rosbags' description."""
    known = typestore().fielddefs
    if type_name not in known:
        near = difflib.get_close_matches(type_name, known, n=1, cutoff=0.0)
        raise BagError(f"{type_name}: unknown message type; nearest known: {near[0]}")
    return dict(known[type_name][1])


def _default(kind: Any) -> object:
    node, detail = kind
    if node == Nodetype.NAME:
        return make_message(detail)
    if node == Nodetype.BASE:
        return _SCALAR_DEFAULTS.get(detail[0], 0)
    element, length = detail if node == Nodetype.ARRAY else (detail[0], 0)
    dtype = _dtype(element)
    return np.zeros(length, dtype) if dtype else [_default(element) for _ in range(length)]


def _converted(name: str, kind: Any, value: Any) -> object:
    node, detail = kind
    if node not in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        return value
    element, length = detail
    dtype = _dtype(element)
    if not dtype:
        if node == Nodetype.ARRAY and len(value) != length:
            raise ShapeError(f"{name}: {len(value)} elements; need {length}")
        return list(value)
    array = np.frombuffer(value, dtype) if isinstance(value, bytes | bytearray | memoryview) else np.asarray(value)
    if array.ndim != 1 or (node == Nodetype.ARRAY and len(array) != length):
        raise ShapeError(f"{name}: shape {array.shape}; need ({length if node == Nodetype.ARRAY else 'N'},)")
    if not np.can_cast(array.dtype, dtype, "same_kind") and array.size:
        raise ShapeError(f"{name}: data type {array.dtype}; need {dtype}")
    return np.ascontiguousarray(array, dtype)


def _dtype(element: Any) -> np.dtype[Any] | None:
    """Return the data type of a numeric array's elements; None for strings and messages."""
    node, detail = element
    if node != Nodetype.BASE or detail[0] == "string":
        return None
    name: str = detail[0]
    return np.dtype(_DTYPES.get(name, name))
