# SPDX-License-Identifier: Apache-2.0
"""Decode recorded bytes to messages, by the definitions in the recording."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from imgu_ros.bags.definitions import MessageReader, defined_types
from imgu_ros.bags.messages import make_message, message_layout, typestore
from imgu_ros.bags.storage import Channel, RawMessage, Serialization
from imgu_ros.bags.text import ascii_patched
from imgu_ros.config.parameters import DEFAULT_LIMITS, LimitsParameters
from imgu_ros.errors import BagError

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

#: Texts of one message that may be something else than UTF-8; more of them are garbage.
_MOST_PATCHES = 20
#: Types whose fields are read by name.
_READ = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/CameraInfo")


class MessageDecoder:
    """Makes messages of what a bag holds; a channel's definition is parsed when its first message comes."""

    def __init__(self, limits: LimitsParameters = DEFAULT_LIMITS) -> None:
        self._limits = limits
        self._stores: dict[Channel, MessageReader | BagError] = {}

    def type_error(self, channel: Channel) -> str:
        """Return why no message of this channel can be read; empty when its type is known."""
        store = self._store(channel)
        return str(store) if isinstance(store, BagError) else ""

    def decoded(self, raw: RawMessage) -> Any:
        """Return the message, with ROS 2's field names, whatever it was recorded as.

        Raises
        ------
        BagError
            If its type is unknown, or its bytes do not fit the type.
        """
        channel = raw.channel
        store = self._store(channel)
        if isinstance(store, BagError):
            raise store
        data = raw.data
        if channel.serialization != Serialization.ROS1:
            return message_from_cdr(channel.type_name, data, store)
        with _as_bag_errors(channel.type_name):
            message = _deserialized(store.deserialize_ros1, data, channel.type_name)
            return _as_ros2(message, channel.type_name) if channel.type_name in typestore().fielddefs else message

    def cdr(self, raw: RawMessage) -> bytes:
        """Return the message as CDR with its encapsulation; one of CDR as recorded, one of ROS 1 converted.

        Raises
        ------
        BagError
            If it is damaged, of neither, or cannot be converted.
        """
        channel = raw.channel
        if raw.message is not None:
            return bytes(typestore().serialize_cdr(raw.message, channel.type_name))
        if channel.serialization == Serialization.CDR and self.type_error(channel):
            return bytes(raw.data)  # a type that the receiver may know
        message = self.decoded(raw)
        if channel.serialization == Serialization.CDR:
            return bytes(raw.data)
        try:
            return bytes(typestore().serialize_cdr(message, channel.type_name))
        except Exception as error:  # a type or a field that ROS 2 does not have, or has otherwise
            raise BagError(f"{channel.type_name}: not as in ROS 2 ({_one_line(error)}); need the same fields") from None

    def _store(self, channel: Channel) -> MessageReader | BagError:
        if channel not in self._stores:
            try:
                self._stores[channel] = _reader_of(channel, self._limits)
            except BagError as error:
                self._stores[channel] = error
        return self._stores[channel]


def message_from_cdr(type_name: str, data: bytes | memoryview, store: Typestore | None = None) -> Any:
    """Return the message that CDR with its encapsulation holds; its arrays are views of `data`.

    Parameters
    ----------
    type_name : "package/msg/Name"
    data : as recorded, or as it comes from the middleware
    store : that knows the type; None: the interfaces of ROS 2 Jazzy

    Raises
    ------
    BagError
        If the bytes are none of this type.
    """
    with _as_bag_errors(type_name):
        # A view, so that rosbags does not copy the message to strip the encapsulation.
        return _deserialized((store or typestore()).deserialize_cdr, memoryview(data), type_name)


def _deserialized(deserialize: Callable[[Any, str], Any], data: bytes | memoryview, type_name: str) -> Any:
    """Deserialise; text in a message that is not UTF-8 (a frame_id, a format) does not cost the message."""
    for _ in range(_MOST_PATCHES):
        try:
            return deserialize(data, type_name)
        except Exception as error:
            cause = error.__cause__
            if not isinstance(cause, UnicodeDecodeError):
                raise
            data = ascii_patched(data, cause.object)
    return deserialize(data, type_name)


@contextmanager
def _as_bag_errors(type_name: str) -> Iterator[None]:
    """Raise `BagError` for whatever damaged bytes provoke: the generated deserialisers let it through."""
    try:
        yield
        return
    except BagError:
        raise
    except Exception as error:
        reason = _one_line(error)
        error.__traceback__ = None  # it would hold the bytes of the message, in a circle
    raise BagError(f"{type_name}: {reason}; need bytes of this type")


@lru_cache(maxsize=64)  # parsing a definition takes longer than reading a frame
def _reader_of(channel: Channel, limits: LimitsParameters) -> MessageReader:
    if channel.serialization not in (Serialization.CDR, Serialization.ROS1):
        raise BagError(f"serialised as {channel.serialization!r}; need cdr or ros1")
    reason = "the bag carries no definition of it"
    try:
        types = defined_types(channel, limits)
        if types is not None:
            reader = MessageReader(types, limits)
            is_cdr = channel.serialization == Serialization.CDR
            if is_cdr and channel.type_name in _READ:
                _require_fields(types, channel.type_name)
            # Generates the code, which may be refused too.
            getattr(reader.get_msgdef(channel.type_name), "deserialize_cdr_le" if is_cdr else "deserialize_ros1")
            return reader
    except Exception as error:  # whatever a damaged or exotic definition provokes in the parser
        reason = f"its definition cannot be read ({_one_line(error)})"
    usual = typestore() if channel.serialization == Serialization.CDR else _ros1_typestore()
    if channel.type_name in usual.fielddefs:
        return MessageReader(usual, limits)
    raise BagError(f"type {channel.type_name or 'unknown'}: {reason}")


def _require_fields(types: Typestore, type_name: str) -> None:
    """Raise BagError unless a definition has all fields, of the same kind, that ROS 2 gives to a type of this name."""
    defined = dict(types.fielddefs[type_name][1])
    for name, kind in typestore().fielddefs[type_name][1]:
        if name not in defined or _kind(defined[name]) != _kind(kind):
            raise BagError(f"{type_name}: no field {name!r} as in ROS 2")
        node, detail = kind
        if node == Nodetype.NAME:
            _require_fields(types, str(detail))


def _kind(field: Any) -> tuple[Any, ...]:
    """Return whether a field is a message and which, a text, or a number, and whether it is a list of them."""
    node, detail = field
    if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        return ("list", *_kind(detail[0]))
    return (node, detail if node == Nodetype.NAME else detail[0] == "string")


@cache
def _ros1_typestore() -> Typestore:
    return get_typestore(Stores.ROS1_NOETIC)


def _as_ros2(message: Any, type_name: str) -> Any:
    """Return a ROS 1 message as ROS 2's of the same name: K becomes k, seq goes."""
    by_name = {field.name.lower(): getattr(message, field.name) for field in dataclasses.fields(message)}
    values: dict[str, object] = {}
    for name, (node, detail) in message_layout(type_name).items():
        if name not in by_name:
            continue
        value = by_name[name]
        if node == Nodetype.NAME:
            value = _as_ros2(value, detail)
        elif node != Nodetype.BASE and detail[0][0] == Nodetype.NAME:
            value = [_as_ros2(item, detail[0][1]) for item in value]
        values[name] = value
    return make_message(type_name, **values)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__
