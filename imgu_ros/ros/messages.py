# SPDX-License-Identifier: Apache-2.0
"""Factory of rclpy's messages; needs the message packages, and neither rclpy nor DDS."""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from imgu_ros.errors import EncodingError, ImguError, nearest_name


def make_message(type_name: str, /, **fields: object) -> Any:
    """Return a message of the Python classes that rclpy uses; see `imgu_ros.messages.factory.MessageFactory`.

    Raises
    ------
    ImguError
        If the message's package is not installed, or has no such message.
    EncodingError
        If the message has no such field, or a number does not fit it.
    """
    known = _fields(type_name)
    for name in fields:
        # rclpy's constructors ignore unknown names, and its setters check nothing.
        if name not in known:
            near = nearest_name(name, known)
            hint = f"nearest known: {near}" if near else f"need one of {', '.join(known) or 'none'}"
            raise EncodingError(f"{type_name}: no field {name!r}; {hint}")
    values = {name: known[name](value) for name, value in fields.items()}
    arrays = {name: value for name, value in values.items() if isinstance(value, memoryview)}
    message = message_class(type_name)(**{name: value for name, value in values.items() if name not in arrays})
    for name, content in arrays.items():
        # The constructor and the setter would each copy once more.
        array = getattr(message, name)
        del array[:]
        array.frombytes(content)
    return message


@cache
def message_class(type_name: str) -> Any:
    """Return the class of a message, for publishers and subscriptions.

    Parameters
    ----------
    type_name : "package/msg/Name"

    Raises
    ------
    ImguError
        If the package is not installed, or has no such message.
    """
    package, _, name = type_name.partition("/msg/")
    if not _TYPE_NAME.fullmatch(type_name):
        raise ImguError(f"{type_name!r}: no name of a ROS 2 message; need package/msg/Name")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except ImportError as error:
        hint = _HINTS.get(package, "install imgu_ros with its `ros` extra, or source a ROS 2 setup file")
        raise ImguError(f"{type_name}: cannot import {package}.msg ({error}); {hint}") from None
    except AttributeError:
        raise ImguError(f"{type_name}: {package} has no message {name!r}; need an existing message") from None


def is_installed(type_name: str) -> bool:
    """Return whether a message, "package/msg/Name", can be published from here."""
    try:
        message_class(type_name)
    except ImguError:
        return False
    return True


_TYPE_NAME = re.compile(r"[a-zA-Z]\w*/msg/[A-Z]\w*", re.ASCII)
_HINTS = {
    "tf2_msgs": "pip does not have it: install it with ROS (apt install ros-jazzy-tf2-msgs) and source the setup file",
}

#: Type codes of `array.array`, which rclpy keeps variable-length numeric arrays in.
_TYPE_CODES = {
    "uint8": "B",
    "int8": "b",
    "uint16": "H",
    "int16": "h",
    "uint32": "I",
    "int32": "i",
    "uint64": "Q",
    "int64": "q",
    "float": "f",
    "double": "d",
}


@cache
def _fields(type_name: str) -> dict[str, Callable[[Any], Any]]:
    """Each field's converter from the factory's form of a value to the one that rclpy wants."""
    types: dict[str, str] = message_class(type_name).get_fields_and_field_types()
    return {name: _converter(f"{type_name}.{name}", field_type) for name, field_type in types.items()}


def _converter(name: str, field_type: str) -> Callable[[Any], Any]:
    if field_type == "octet":
        return lambda value: bytes((value,))
    if field_type.startswith("sequence<"):
        element = field_type.removeprefix("sequence<").removesuffix(">").partition(",")[0]
        code = _TYPE_CODES.get(element)
        return _same if code is None else lambda values: _to_bytes(name, values, code)
    element, bracket, length = field_type.partition("[")
    if bracket and element in _TYPE_CODES:
        return lambda values: _to_fixed(name, values, _TYPE_CODES[element], int(length.removesuffix("]")))
    return _same


def _same(value: Any) -> Any:
    return value


def _to_bytes(name: str, values: Any, code: str) -> memoryview:
    """Return the bytes of an array: assigning the array itself would copy it element by element."""
    content: memoryview = _checked(name, values, code).view(np.uint8).data
    return content


def _to_fixed(name: str, values: Any, code: str, length: int) -> Any:
    checked = _checked(name, values, code)
    if len(checked) != length:
        raise EncodingError(f"{name}: {len(checked)} values; need {length}")
    return checked


def _checked(name: str, values: Any, code: str) -> Any:
    values = np.asarray(values)
    if values.ndim != 1 or values.dtype != np.dtype(code):
        raise EncodingError(f"{name}: {values.dtype} of shape {values.shape}; need {np.dtype(code)} of shape (N,)")
    return np.ascontiguousarray(values)
