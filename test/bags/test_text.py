# SPDX-License-Identifier: Apache-2.0
"""Text that is not UTF-8, and definitions that cannot be read: neither costs a message of another topic."""

from __future__ import annotations

import sqlite3
import struct

import numpy as np
import pytest

from imgu_ros.bags.reading import open_bag
from imgu_ros.bags.text import ascii_patched, text_of

#: A comment as an editor of Windows saved it: Latin-1, in Greek, in Shift-JIS, cut UTF-8, UTF-16, and nothing.
COMMENTS = {
    "latin-1": "# Stra\xdfenl\xe4nge in m, \xb5m genau\n".encode("latin-1"),
    "windows-1252": "# the robot\x92s \x93pose\x94\n".encode("latin-1"),
    "greek": "# \u03b3\u03c9\u03bd\u03af\u03b1\n".encode("iso8859-7"),
    "shift-jis": "# \u89d2\u5ea6\n".encode("shift-jis"),
    "undefined": b"# \x81\x8d\x8f\x90\x9d\n",
    "cut": "# Gr\xfc\xdfe\xfc".encode()[:-1],
    "utf-16": "# Gr\xf6\xdfe\n".encode("utf-16"),
    "nul": b"\0\0\0",
}
#: Definitions that are none, or that no parser of ours reads.
DEFINITIONS = {
    "empty": (b"ros2msg", b""),
    "no format": (b"", b"float64 x\n"),
    "syntax": (b"ros2msg", b"float64 [[[ x\n}{\n"),
    "constants": (b"ros2msg", b'string NAME = it\'s "here" # not a comment\nfloat64 X=1e400\nint8 Y=\n'),
    "wstring": (b"ros2msg", b'wstring<=10 name "w\xfcrfel"\nfloat64[<=3] x [1,,2]\n'),
    "keys": (b"omgidl", b"module a { struct B { @key @nested(TRUE) string<5> id; map<string, long> m; }; };"),
    "idl": (b"ros2idl", b"=" * 80 + b"\nIDL: a/msg/B\nmodule a { union U switch(long) { case 1: long x; }; };"),
    "protobuf": (b"protobuf", b"\x0a\x96\x01\xff\xfe\x12binary descriptor"),
    "json": (b"jsonschema", b'{"type": "object", "title": "w\xfcrfel"}'),
    "flatbuffer": (b"flatbuffer", bytes(range(256))),
    "unknown": (b"ros3msg\xff", b"\xff\xff"),
}


def raw_text(value: bytes) -> bytes:
    return struct.pack("<I", len(value)) + value


def raw_schema(parts, identity: int, name: bytes, form: bytes, definition: bytes) -> bytes:
    return parts.record(3, struct.pack("<H", identity) + raw_text(name) + raw_text(form) + raw_text(definition))


def raw_channel(parts, identity: int, schema: int, topic: bytes, encoding: bytes, metadata: bytes = b"") -> bytes:
    content = struct.pack("<HH", identity, schema) + raw_text(topic) + raw_text(encoding) + raw_text(metadata)
    return parts.record(4, content)


def mcap(parts, definitions: bytes, messages: list[bytes], in_chunk: bool) -> bytes:
    out = parts.magic + parts.record(1, raw_text(b"ros2") + raw_text("tiny f\xfcr".encode("latin-1")))
    records = b"".join(messages)
    out += parts.chunk(definitions + records, 1, 9) if in_chunk else definitions + parts.chunk(records, 1, 9)
    return out + parts.record(15, struct.pack("<I", 0)) + parts.record(2, struct.pack("<QQI", 0, 0, 0)) + parts.magic


def read(path, topic="/text"):
    with open_bag([path]) as bag:
        return [message.message.data for message in bag.messages([topic])], bag.warnings, bag.topics


@pytest.mark.parametrize("in_chunk", [True, False])
@pytest.mark.parametrize("where", ["unrelated", "own", "name", "topic", "encoding", "metadata"])
@pytest.mark.parametrize("comment", COMMENTS)
def test_mcap_with_text_that_is_not_utf8(tmp_path, mcap_parts, comment, where, in_chunk):
    p, odd = mcap_parts, COMMENTS[comment]
    own = b"string data\n" + (odd if where == "own" and odd.startswith(b"#") else b"")
    qos = b"offered_qos_profiles" + odd
    definitions = (
        raw_schema(p, 7, b"my_msgs/msg/" + (odd if where == "name" else b"Odd"), b"ros2msg", odd + b"float64 x\n")
        + raw_channel(p, 7, 7, b"/odd" + (odd if where == "topic" else b""), odd if where == "encoding" else b"cdr")
        + raw_schema(p, 1, b"std_msgs/msg/String", b"ros2msg", own)
        + raw_channel(p, 1, 1, b"/text", b"cdr", raw_text(qos) if where == "metadata" else b"")
    )
    messages = [p.message(7, 1, bytes(12)), p.message(1, 2, p.string_cdr("a")), p.message(1, 3, p.string_cdr("b"))]
    (tmp_path / "x.mcap").write_bytes(mcap(p, definitions, messages, in_chunk))
    data, warnings, topics = read(tmp_path / "x.mcap")
    assert (data, warnings) == (["a", "b"], ())
    assert [topic.count for topic in topics] == [1, 2]
    for topic in topics:
        f"{topic.name} {topic.type_name}".encode()  # can be printed


@pytest.mark.parametrize("in_chunk", [True, False])
@pytest.mark.parametrize("kind", DEFINITIONS)
def test_mcap_with_definitions_that_cannot_be_read(tmp_path, mcap_parts, kind, in_chunk):
    p, (form, definition) = mcap_parts, DEFINITIONS[kind]
    encoding = form if form in (b"protobuf", b"flatbuffer") else b"cdr"
    definitions = (
        raw_schema(p, 7, b"a/msg/B", form, definition)
        + raw_channel(p, 7, 7, b"/odd", encoding)
        # Two definitions of one name, and no schema at all.
        + raw_schema(p, 8, b"std_msgs/msg/String", form, definition)
        + raw_channel(p, 8, 8, b"/other", encoding)
        + raw_channel(p, 9, 0, b"/none", b"json")
        + raw_schema(p, 1, b"std_msgs/msg/String", b"ros2msg", b"string data\n")
        + raw_channel(p, 1, 1, b"/text", b"cdr")
    )
    odd = [p.message(channel, 1, b"\0\1\0\0\7\7\7") for channel in (7, 8, 9)]
    (tmp_path / "x.mcap").write_bytes(mcap(p, definitions, [*odd, p.message(1, 2, p.string_cdr("a"))], in_chunk))
    data, warnings, topics = read(tmp_path / "x.mcap")
    assert (data, warnings) == (["a"], ())
    assert {topic.name for topic in topics} == {"/odd", "/other", "/none", "/text"}
    # Those that are asked for say why they cannot be had; a player passes on what a receiver may know.
    with open_bag([tmp_path / "x.mcap"]) as bag:
        assert [message.message.data for message in bag.messages() if message.topic == "/text"] == ["a"]
        assert all(line.startswith(("/odd: ", "/other: ", "/none: ")) for line in bag.warnings)
        assert next(bag.cdr_messages(["/text"])).data == p.string_cdr("a")


@pytest.mark.parametrize("in_chunk", [True, False])
def test_mcap_with_records_of_definitions_that_do_not_hold(tmp_path, mcap_parts, in_chunk):
    """A text that claims to be longer than its record: that record is lost, and no other."""
    p = mcap_parts
    definitions = (
        p.record(3, struct.pack("<HI", 7, 10_000) + b"a/msg/B")
        + p.record(4, struct.pack("<H", 7))
        + p.schema(1, "std_msgs/msg/String", "string data")
        + p.channel(1, 1, "/text")
    )
    (tmp_path / "x.mcap").write_bytes(mcap(p, definitions, [p.message(1, 2, p.string_cdr("a"))], in_chunk))
    assert read(tmp_path / "x.mcap")[:2] == (["a"], ())


@pytest.mark.parametrize("encoding", [b"CDR", b"", b" cdr ", b"Cdr"])
@pytest.mark.parametrize("form", [b"ROS2MSG", b"ros2msg", b""])
def test_ways_to_write_cdr(tmp_path, mcap_parts, write_sqlite, encoding, form):
    p = mcap_parts
    definitions = raw_schema(p, 1, b"my_msgs/Word" if form else b"std_msgs/msg/String", form, b"string data\r\n")
    definitions += raw_channel(p, 1, 1, b"/text", encoding)
    (tmp_path / "x.mcap").write_bytes(mcap(p, definitions, [p.message(1, 2, p.string_cdr("a"))], True))
    assert read(tmp_path / "x.mcap")[:2] == (["a"], ())
    rows = [(b"/text", b"std_msgs/msg/String", encoding, b"", b"")]
    write_sqlite(tmp_path / "x.db3", 4, rows, None, [(1, 2, p.string_cdr("a"))])
    assert read(tmp_path / "x.db3")[:2] == (["a"], ())


@pytest.mark.parametrize("version", [1, 2, 4])
@pytest.mark.parametrize("comment", COMMENTS)
def test_sqlite_with_text_that_is_not_utf8(tmp_path, mcap_parts, write_sqlite, comment, version):
    odd = COMMENTS[comment]
    rows = [
        (b"/odd" + odd, b"my_msgs/msg/" + odd, odd, odd, odd),
        (b"/text", b"std_msgs/msg/String", b"cdr", b"- history: " + odd, b"RIHS01_" + odd),
    ]
    definitions = [(b"my_msgs/msg/Odd", b"ros2msg", odd, odd), (b"std_msgs/msg/String", odd, odd + b"string data", odd)]
    messages = [(1, 1, bytes(9)), (2, 2, mcap_parts.string_cdr("a"))]
    write_sqlite(tmp_path / "x.db3", version, rows, definitions if version == 4 else None, messages)
    data, warnings, topics = read(tmp_path / "x.db3")
    assert (data, warnings) == (["a"], ())
    assert [topic.count for topic in topics] == [1, 1]


@pytest.mark.parametrize("kind", DEFINITIONS)
def test_sqlite_with_definitions_that_cannot_be_read(tmp_path, mcap_parts, write_sqlite, kind):
    form, definition = DEFINITIONS[kind]
    rows = [(b"/odd", b"a/msg/B", b"cdr", b"", b""), (b"/text", b"std_msgs/msg/String", b"cdr", b"", b"RIHS01_1")]
    definitions = [
        (b"a/msg/B", form, definition, b""),
        (b"std_msgs/msg/String", form, definition, b"RIHS01_0"),
        (b"std_msgs/msg/String", b"ros2msg", b"string data", b"RIHS01_1"),
    ]
    messages = [(1, 1, bytes(9)), (2, 2, mcap_parts.string_cdr("a"))]
    write_sqlite(tmp_path / "x.db3", 4, rows, definitions, messages)
    assert read(tmp_path / "x.db3")[:2] == (["a"], ())


def test_sqlite_tells_types_of_one_name_apart_by_their_hash(tmp_path, mcap_parts, write_sqlite):
    rows = [(f"/{i}".encode(), b"my/msg/Word", b"cdr", b"", f"RIHS01_{i}".encode()) for i in range(2)]
    definitions = [
        (b"my/msg/Word", b"ros2msg", b"string first", b"RIHS01_0"),
        (b"my/msg/Word", b"ros2msg", b"string second", b"RIHS01_1"),
    ]
    write_sqlite(tmp_path / "x.db3", 4, rows, definitions, [(i + 1, i, mcap_parts.string_cdr("a")) for i in range(2)])
    with open_bag([tmp_path / "x.db3"]) as bag:
        one, other = (message.message for message in bag.messages())
    assert (one.first, other.second) == ("a", "a")


def test_sqlite_whose_table_of_definitions_is_another(tmp_path, mcap_parts, write_sqlite):
    rows = [(b"/text", b"std_msgs/msg/String", b"cdr", b"", b"")]
    messages = [(1, 2, mcap_parts.string_cdr("a"))]
    write_sqlite(tmp_path / "x.db3", 4, rows, [], messages, definition_columns="name TEXT, other TEXT")
    data, warnings, _ = read(tmp_path / "x.db3")
    assert data == ["a"]
    assert warnings == (
        "x.db3: its message definitions cannot be read (no column encoded_message_definition); those of ROS 2 serve",
    )


def ros1_header(**fields: bytes) -> bytes:
    parts = [name.rstrip("_").encode() + b"=" + value for name, value in fields.items()]
    content = b"".join(struct.pack("<I", len(part)) + part for part in parts)
    return struct.pack("<I", len(content)) + content


def ros1_record(data: bytes, **fields: bytes) -> bytes:
    return ros1_header(**fields) + struct.pack("<I", len(data)) + data


def ros1_bag(connections: list[bytes], messages: list[bytes]) -> bytes:
    """A bag that its recorder did not close, as the format's description has it."""
    chunk = b"".join(connections) + b"".join(messages)
    head = ros1_record(bytes(4027), op=b"\x03", index_pos=bytes(8), conn_count=bytes(4), chunk_count=bytes(4))
    body = ros1_record(chunk, op=b"\x05", compression=b"none", size=struct.pack("<I", len(chunk)))
    return b"#ROSBAG V2.0\n" + head + body


def ros1_connection(identity: int, topic: bytes, data: bytes) -> bytes:
    return ros1_record(data, op=b"\x07", conn=struct.pack("<I", identity), topic=topic)


def ros1_message(identity: int, seconds: int, data: bytes) -> bytes:
    return ros1_record(data, op=b"\x02", conn=struct.pack("<I", identity), time=struct.pack("<II", seconds, 0))


ROS1_STRING = {"type_": b"std_msgs/String", "md5sum": b"992ce8a1687cec8c8bd883ec73ca41d1"}


@pytest.mark.parametrize("comment", COMMENTS)
def test_rosbag1_with_text_that_is_not_utf8(tmp_path, comment):
    odd = COMMENTS[comment]
    unrelated = ros1_header(type_=b"my_msgs/Odd" + odd, md5sum=odd, message_definition=odd, callerid=odd)
    definition = b"string data\n" + (odd if odd.startswith(b"#") else b"")
    own = ros1_header(**ROS1_STRING, message_definition=definition, callerid=b"/" + odd, latching=odd, topic=odd)
    connections = [ros1_connection(0, b"/odd" + odd, unrelated[4:]), ros1_connection(1, b"/text", own[4:])]
    messages = [ros1_message(0, 1, bytes(4)), ros1_message(1, 2, raw_text(b"a"))]
    (tmp_path / "x.bag").write_bytes(ros1_bag(connections, messages))
    data, warnings, topics = read(tmp_path / "x.bag")
    assert data == ["a"]
    assert len(topics) == 2
    assert warnings == ("x.bag: the end of the file is missing; read until 2.000000000 s",)


@pytest.mark.parametrize("kind", [*sorted(DEFINITIONS.keys() - {"no format"}), "missing"])
def test_rosbag1_with_definitions_that_cannot_be_read(tmp_path, kind):
    """Of the types that ROS 1 brings, none is needed."""
    definition = {} if kind == "missing" else {"message_definition": DEFINITIONS[kind][1]}
    broken = struct.pack("<I", 3) + b"abc"
    connections = [
        ros1_connection(0, b"/odd", ros1_header(type_=b"a/B", **definition)[4:]),
        ros1_connection(1, b"/text", ros1_header(**ROS1_STRING, **definition)[4:] + broken),
        ros1_record(broken, op=b"\x07", topic=b"/nobody"),
    ]
    messages = [ros1_message(0, 1, bytes(4)), ros1_message(1, 2, raw_text(b"a"))]
    (tmp_path / "x.bag").write_bytes(ros1_bag(connections, messages))
    assert read(tmp_path / "x.bag")[0] == ["a"]


def test_text_inside_a_cdr_message_that_is_needed(tmp_path, mcap_parts, image_message, serialized):
    """A frame_id in Latin-1 costs no frame."""
    p = mcap_parts
    image = image_message(3)
    data = serialized(image)
    assert data.count(b"\7\0\0\0camera\0") == 1
    definitions = p.schema(1, "sensor_msgs/msg/Image", "") + p.channel(1, 1, "/image_raw")
    messages = [p.message(1, 5, data.replace(b"camera\0", b"gr\xfc\xdfe.\0"))]
    (tmp_path / "x").write_bytes(mcap(p, definitions, messages, False))
    with open_bag([tmp_path / "x"]) as bag:
        (message,) = bag.messages(["/image_raw"])
        assert bag.warnings == ()
    assert message.message.header.frame_id == "gr??e."
    np.testing.assert_array_equal(message.message.data, image.data)


def test_text_inside_a_ros1_message_that_is_needed(tmp_path, write_rosbag1):
    write_rosbag1(tmp_path / "x", 1)
    whole = (tmp_path / "x").read_bytes()
    assert whole.count(b"\3\0\0\0cam") == 2
    (tmp_path / "x").write_bytes(whole.replace(b"\3\0\0\0cam", b"\3\0\0\0c\xe4m"))
    with open_bag([tmp_path / "x"]) as bag:
        (message,) = bag.messages(["/camera/image_raw"])
        assert bag.warnings == ()
    assert message.message.header.frame_id == "c?m"
    np.testing.assert_array_equal(message.message.data, np.zeros(600, np.uint8))


def test_patching_keeps_lengths_and_places():
    # The same bytes stand in the stamp before it.
    for size in (b"\3\0\0\0", b"\4\0\0\0", b"\0\0\0\4"):
        data = b"\1\xe9t\xe9" + size + b"\xe9t\xe9\0\3\xff"
        expected = b"\1\xe9t\xe9" + size + b"?t?\0\3\xff"
        assert ascii_patched(data, b"\xe9t\xe9") == ascii_patched(memoryview(data), b"\xe9t\xe9") == expected
    with pytest.raises(ValueError, match="no string of 3 bytes"):
        ascii_patched(b"\xe9t\xe9", b"\xe9t\xe9")


def test_different_names_stay_different():
    assert len({text_of(bytes((code,))) for code in range(256)}) == 256
    word = "Gr\xf6\xdfe"
    assert {text_of(word.encode(encoding)) for encoding in ("utf-8", "latin-1", "utf-8-sig", "utf-16")} == {word}


def test_sqlite_text_that_is_no_text(tmp_path, mcap_parts):
    """NULL and numbers, where text should be."""
    database = sqlite3.connect(tmp_path / "x.db3")
    database.execute(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, serialization_format, offered_qos_profiles)"
    )
    database.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)")
    database.execute("INSERT INTO topics VALUES(1, NULL, 5, 2.5, NULL)")
    database.execute("INSERT INTO topics VALUES(2, '/text', 'std_msgs/msg/String', 'cdr', NULL)")
    for topic in (1, 2):
        database.execute("INSERT INTO messages VALUES(NULL, ?, 1, ?)", (topic, mcap_parts.string_cdr("a")))
    database.commit()
    database.close()
    data, warnings, topics = read(tmp_path / "x.db3")
    assert (data, warnings) == (["a"], ())
    assert [(topic.name, topic.type_name) for topic in topics] == [("", "5"), ("/text", "std_msgs/msg/String")]
