# SPDX-License-Identifier: Apache-2.0
"""Definitions of messages that a bag carries: their text decides neither the time nor the memory of reading."""

from __future__ import annotations

import struct
import time

import numpy as np
import pytest

from imgu_ros.bags.decoding import MessageDecoder
from imgu_ros.bags.storage import Channel, RawMessage
from imgu_ros.config.parameters import LimitsParameters
from imgu_ros.errors import BagError

CDR = b"\0\1\0\0"


def decoded(definition, data, form="ros2msg", limits=None, serialization="cdr", name="a/msg/B"):
    channel = Channel("/odd", name, serialization, form, definition)
    decoder = MessageDecoder(limits or LimitsParameters())
    return decoder.decoded(RawMessage(channel, 1, data))


def refused(definition, data=CDR, **more):
    began = time.monotonic()
    with pytest.raises(BagError) as error:
        decoded(definition, data, **more)
    assert time.monotonic() - began < 8
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 500
    return str(error.value)


def chain(length, count=2):
    """A type of `length` levels, each of which contains the next `count` times: count ** length fields."""
    levels = [f"a/C{i + 1}[{count}] x\n{'=' * 80}\nMSG: a/C{i + 1}\n" for i in range(length)]
    return "".join(levels) + "float64 x\n"


@pytest.mark.parametrize(
    ("definition", "need"),
    [
        ("C[100000000] c\n" + "=" * 80 + "\nMSG: a/C\nint32 x\n", "200000001 fields or more"),
        ("string[100000000] c\n", "100000001 fields or more; need at most 10000 (limits.schema_fields)"),
        ("\n".join(f"int32 f{i}" for i in range(150_000)), "10001 fields or more"),
        (chain(60), "need at most 10000 (limits.schema_fields)"),
        (chain(3, 1000), "need at most 10000 (limits.schema_fields)"),
        (chain(2000, 1), "nested more than 100 deep"),
        ("B b\nint32 x\n", "a/msg/B is nested more than 100 deep, or in itself"),
        ("C[] c\n" + "=" * 80 + "\nMSG: a/C\na/B[] b\n", "or in itself"),
        ("# " + "x" * 4_000_001, "4.0 MB; need at most 4 (limits.text_mb)"),
        ("x" * 600 + " y\n", "a type and a name of 601 characters"),
        ("int32[-1] x\n", "an array of -1 elements"),
        (f"int32[{'9' * 5000}] x\n", "its definition cannot be read"),
    ],
)
def test_definitions_that_no_message_has(definition, need):
    assert need in refused(definition)


def test_arrays_of_numbers_cost_what_the_message_has():
    """10^8 numbers are one field; a message that has not their bytes is refused, one that has is read."""
    assert "buffer" in refused("float64[100000000] x\n", CDR + bytes(800))
    assert "a/msg/B" in refused("uint8[] x\n", CDR + struct.pack("<I", 2**32 - 1) + bytes(50))
    values = np.arange(1000.0)
    np.testing.assert_array_equal(decoded("float64[1000] x\n", CDR + values.tobytes()).x, values)


def test_a_definition_of_as_many_fields_as_are_allowed():
    definition = "\n".join(f"int32 f{i}" for i in range(2000))
    limits = LimitsParameters(schema_fields=2000)
    message = decoded(definition, CDR + np.arange(2000, dtype="<i4").tobytes(), limits=limits)
    assert (message.f0, message.f1999) == (0, 1999)
    assert "2001 fields" in refused(definition + "\nint32 g", limits=limits)


@pytest.mark.parametrize(("serialization", "head"), [("cdr", CDR), ("ros1", b"")])
def test_lists_of_messages_without_content(serialization, head):
    """A byte, or in ROS 1 none at all, becomes an object of 200 bytes."""
    definition = f"std_msgs/Empty[] x\n{'=' * 80}\nMSG: std_msgs/Empty\n"
    form = "ros2msg" if serialization == "cdr" else "ros1msg"
    limits = LimitsParameters(message_mb=20)
    data = head + struct.pack("<I", 9_000_000) + bytes(9_000_000)
    text = refused(definition, data, form=form, serialization=serialization, limits=limits)
    assert "lists of std_msgs/msg/Empty: need more memory; need at most 20 MB (limits.message_mb)" in text
    if serialization == "ros1":
        assert "lists of" in refused(
            definition, struct.pack("<I", 2**32 - 1), form=form, serialization="ros1", limits=limits
        )
    few = head + struct.pack("<I", 1000) + bytes(0 if serialization == "ros1" else 1000)
    assert len(decoded(definition, few, form=form, serialization=serialization, limits=limits).x) == 1000


def test_the_budget_is_that_of_one_message():
    definition = f"C[] x\n{'=' * 80}\nMSG: a/C\nint32 x\n"
    data = CDR + struct.pack("<I", 4000) + bytes(16_000)
    channel = Channel("/odd", "a/msg/B", "cdr", "ros2msg", definition)
    decoder = MessageDecoder(LimitsParameters(message_mb=1))
    for _ in range(20):
        assert len(decoder.decoded(RawMessage(channel, 1, data)).x) == 4000


def test_lists_of_texts():
    """Texts of two letters take ten times their bytes."""
    one = struct.pack("<I", 3) + b"ab\0\0"
    data = CDR + struct.pack("<I", 50_000) + one * 50_000
    assert "0 MB with lists of texts; need at most 0.125" in refused(
        "string[] x\n", data, limits=LimitsParameters(message_mb=1)
    )
    assert decoded("string[] x\n", data).x == ["ab"] * 50_000


def test_constants_defaults_comments_and_annotations_are_no_fields():
    definition = (
        '# comment\n@verbatim\n\tstring  NAME = it\'s "here" # not a comment\nfloat64 X=1e400\n'
        "int32 a 5\nstring<=10 b \"c = 'd\nint8[<=3] c [1, 2]\n\nint16 d# no space\n@key float64 e\n"
    )
    data = CDR + struct.pack("<iI2s2xI2bhd", 7, 2, b"q\0", 2, 3, 4, 5, 2.5)
    # the last number is aligned to 8 bytes behind the encapsulation
    message = decoded(definition, data[:-8] + bytes(-(len(data) - 12) % 8) + struct.pack("<d", 2.5))
    assert (message.a, message.b, message.c.tolist(), message.d, message.e) == (7, "q", [3, 4], 5, 2.5)


IDL = """// generated from rosidl_adapter
#include "std_msgs/msg/Header.idl"
module a { module msg {
  typedef double double__3[3];
  module B_Constants { const uint8 N = 3; const string S = "(*"; };
  @verbatim (language="comment", text=
    "A struct (of a test), with \\"quotes\\"" "\\n" "and // no comment")
  struct B { /* three * numbers */
    @unit (value="m") double__3 x;
    @default (value=5)
    uint8 y;
    sequence<uint8, 4> z;
    string<5> s;
  };
}; };
"""


def test_idl_as_ros_writes_it():
    data = CDR + struct.pack("<3dBxxxI2B2xI3s", 1, 2, 3, 4, 2, 5, 6, 3, b"hi\0")
    message = decoded(IDL, data, "ros2idl")
    assert (message.x.tolist(), message.y, message.z.tolist(), message.s) == ([1, 2, 3], 4, [5, 6], "hi")
    together = f"{'=' * 80}\nIDL: a/msg/B\n{IDL}"
    assert decoded(together, data, "ros2idl").s == "hi"


@pytest.mark.parametrize(
    "fault",
    [
        "const long X = " + "(" * 30 + "1" + ")" * 30 + ";",
        "const long X = 1 << 90000000000;",
        "const long X = 99999999 * 99999999;",
        "struct C { " + "sequence<" * 40 + "long" + ">" * 40 + " x; };",
        "struct C { long x[100000000]; }; struct D { C x[100000000]; };",
        "typedef E F; typedef F E; struct C { E x; };",
        '"' * 100_001,
        "/*" * 100_000,
        "@a(" * 100_000,
        "struct C {" * 2000,
        "".join(f"const long X{i} = 1;" for i in range(10_001)),
        "const long X = " + "+".join("1" * 3000) + ";",
    ],
)
def test_idl_that_takes_for_ever(fault):
    refused(IDL.replace("struct B", f"{fault} struct B"), form="ros2idl")


@pytest.mark.parametrize("wrong", ["std_msgs/Header hder\nuint32 height", "std_msgs/Header header\nstring height"])
def test_a_definition_of_an_image_that_is_none_does_not_count(wrong):
    """Its bytes are an image's all the same; read by the damaged definition, it would lack what every image has."""
    from imgu_ros.bags.decoding import MessageDecoder
    from imgu_ros.bags.messages import make_message, typestore
    from imgu_ros.bags.storage import Channel, RawMessage

    schema = wrong + (
        "\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data\n"
        f"{'=' * 80}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
        f"{'=' * 80}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    )
    header = make_message(
        "std_msgs/msg/Header", stamp=make_message("builtin_interfaces/msg/Time", sec=7), frame_id="camera"
    )
    image = make_message("sensor_msgs/msg/Image", header=header, height=3, width=4, encoding="mono8")
    data = bytes(typestore().serialize_cdr(image, "sensor_msgs/msg/Image"))
    channel = Channel("/image", "sensor_msgs/msg/Image", "cdr", "ros2msg", schema)
    read = MessageDecoder().decoded(RawMessage(channel, 0, data))
    assert (read.header.frame_id, read.height, read.width) == ("camera", 3, 4)
