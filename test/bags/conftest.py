# SPDX-License-Identifier: Apache-2.0
"""A tiny MCAP writer, by the format's specification alone, and bags to read."""

from __future__ import annotations

import sqlite3
import struct
import zlib
from dataclasses import dataclass, field

import lz4.frame
import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.typesys import Stores, get_typestore

from imgu_ros.bags.messages import make_message, typestore

MAGIC = b"\x89MCAP0\r\n"


def text(value: str) -> bytes:
    return struct.pack("<I", len(value.encode())) + value.encode()


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def schema(identity: int, name: str, definition: str, form: str = "ros2msg") -> bytes:
    return record(3, struct.pack("<H", identity) + text(name) + text(form) + text(definition))


def channel(identity: int, schema_id: int, topic: str, encoding: str = "cdr") -> bytes:
    return record(4, struct.pack("<HH", identity, schema_id) + text(topic) + text(encoding) + struct.pack("<I", 0))


def message(channel_id: int, time_ns: int, data: bytes) -> bytes:
    return record(5, struct.pack("<HIQQ", channel_id, 0, time_ns, time_ns) + data)


def chunk(records: bytes, start: int, end: int, compression: str = "", crc: bool = True) -> bytes:
    packed = {"": bytes, "lz4": lz4.frame.compress, "zstd": zstd_compress}[compression](records)
    head = struct.pack("<QQQI", start, end, len(records), zlib.crc32(records) if crc else 0)
    return record(6, head + text(compression) + struct.pack("<Q", len(packed)) + packed)


def message_index(channel_id: int, entries: list[tuple[int, int]]) -> bytes:
    array = b"".join(struct.pack("<QQ", *entry) for entry in entries)
    return record(7, struct.pack("<HI", channel_id, len(array)) + array)


def zstd_compress(data: bytes) -> bytes:
    from imgu_ros.bags.compression import zstd

    return zstd.compress(data)


def string_cdr(value: str) -> bytes:
    """A std_msgs/String: encapsulation, length with terminator, text."""
    return b"\0\1\0\0" + struct.pack("<I", len(value) + 1) + value.encode() + b"\0"


@dataclass
class TinyMcap:
    """std_msgs/String messages on /text, `chunks` of (time, text) lists; chunked or not, indexed or not."""

    chunks: list[list[tuple[int, str]]]
    compression: str = ""
    is_chunked: bool = True
    is_indexed: bool = True
    has_crc: bool = True
    offsets: list[tuple[int, int]] = field(default_factory=list)

    def data(self) -> bytes:
        definitions = schema(1, "std_msgs/msg/String", "string data") + channel(1, 1, "/text")
        out = MAGIC + record(1, text("ros2") + text("tiny"))
        for i, messages in enumerate(self.chunks):
            records = definitions if i == 0 else b""
            entries = []
            for time_ns, value in messages:
                entries.append((time_ns, len(records)))
                records += message(1, time_ns, string_cdr(value))
            start = len(out)
            if self.is_chunked:
                times = [time_ns for time_ns, _ in messages]
                out += chunk(records, min(times), max(times), self.compression, self.has_crc)
                self.offsets.append((start, len(out)))
                out += message_index(1, entries) if self.is_indexed else b""
            else:
                out += records
                self.offsets.append((start, len(out)))
        out += record(15, struct.pack("<I", 0))
        return out + record(2, struct.pack("<QQI", 0, 0, 0)) + MAGIC


@pytest.fixture(scope="session")
def tiny_mcap():
    return TinyMcap


@pytest.fixture(scope="session")
def mcap_parts():
    """The record builders, for what TinyMcap does not make."""
    import types

    return types.SimpleNamespace(
        magic=MAGIC, text=text, record=record, schema=schema, channel=channel, message=message, chunk=chunk,
        message_index=message_index, string_cdr=string_cdr,
    )  # fmt: skip


@pytest.fixture(scope="session")
def image_message():
    def make(value: int, width: int = 30, height: int = 20):
        rng = np.random.default_rng(value)
        data = rng.integers(0, 256, width * height, dtype=np.uint8)
        stamp = make_message("builtin_interfaces/msg/Time", sec=value)
        header = make_message("std_msgs/msg/Header", stamp=stamp, frame_id="camera")
        return make_message(
            "sensor_msgs/msg/Image", header=header, height=height, width=width, step=width, encoding="mono8", data=data
        )

    return make


@pytest.fixture(scope="session")
def write_rosbag1():
    def write(path, count=10, compression=None, chunk_bytes=2000):
        """/camera/image_raw and /camera/camera_info, as ROS 1 has them (K, not k)."""
        store = get_typestore(Stores.ROS1_NOETIC)
        writer = Rosbag1Writer(path)
        if compression:
            writer.set_compression(Rosbag1Writer.CompressionFormat[compression])
        with writer:
            writer.chunk_threshold = chunk_bytes
            images = writer.add_connection("/camera/image_raw", "sensor_msgs/msg/Image", typestore=store)
            infos = writer.add_connection("/camera/camera_info", "sensor_msgs/msg/CameraInfo", typestore=store)
            types = store.types
            for i in range(count):
                stamp = types["builtin_interfaces/msg/Time"](sec=i, nanosec=5)
                header = types["std_msgs/msg/Header"](seq=i, stamp=stamp, frame_id="cam")
                image = types["sensor_msgs/msg/Image"](
                    header=header, height=20, width=30, encoding="mono8", is_bigendian=0, step=30,
                    data=np.full(600, i, np.uint8),
                )  # fmt: skip
                info = types["sensor_msgs/msg/CameraInfo"](
                    header=header, height=20, width=30, distortion_model="plumb_bob", D=np.zeros(5),
                    K=np.arange(9.0), R=np.eye(3).ravel(), P=np.arange(12.0), binning_x=0, binning_y=0,
                    roi=types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False),
                )  # fmt: skip
                time_ns = 10**9 + i
                writer.write(images, time_ns, store.serialize_ros1(image, "sensor_msgs/msg/Image"))
                writer.write(infos, time_ns, store.serialize_ros1(info, "sensor_msgs/msg/CameraInfo"))

    return write


@pytest.fixture(scope="session")
def serialized():
    def serialize(message) -> bytes:
        return bytes(typestore().serialize_cdr(message, message.__msgtype__))

    return serialize


#: Columns of `topics` in the versions of rosbag2's schema, and of `message_definitions`.
TOPICS = {
    1: "id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT",
    2: "id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT, offered_qos_profiles TEXT",
    4: "id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT, offered_qos_profiles TEXT, "
    "type_description_hash TEXT",
}
MESSAGE_DEFINITIONS = (
    "id INTEGER PRIMARY KEY, topic_type TEXT, encoding TEXT, encoded_message_definition TEXT, "
    "type_description_hash TEXT"
)


@pytest.fixture(scope="session")
def write_sqlite():
    def write(path, version, rows, definitions, messages, definition_columns=MESSAGE_DEFINITIONS):
        """A .db3 as rosbag2 has it, whatever bytes its texts are; definitions None: without their table."""
        count = TOPICS[version].count(",")
        marks = ", ".join(["CAST(? AS TEXT)"] * count)
        database = sqlite3.connect(path)
        database.execute(f"CREATE TABLE topics({TOPICS[version]})")
        database.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"
        )
        for identity, row in enumerate(rows, 1):
            database.execute(f"INSERT INTO topics VALUES({identity}, {marks})", row[:count])
        if definitions is not None:
            database.execute(f"CREATE TABLE message_definitions({definition_columns})")
            for row in definitions:
                values = ", ".join(["CAST(? AS TEXT)"] * len(row))
                database.execute(f"INSERT INTO message_definitions VALUES(NULL, {values})", row)
        for topic, time_ns, data in messages:
            database.execute("INSERT INTO messages VALUES(NULL, ?, ?, ?)", (topic, time_ns, data))
        database.commit()
        database.close()

    return write
