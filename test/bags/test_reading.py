# SPDX-License-Identifier: Apache-2.0
"""Whole bags: every storage, compression and version, against what was written."""

from __future__ import annotations

import functools
import operator
import shutil
import sqlite3

import numpy as np
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from imgu_ros.bags.messages import make_message, typestore
from imgu_ros.bags.reading import open_bag
from imgu_ros.bags.writing import BagWriter
from imgu_ros.errors import BagError


def texts(bag):
    return [(m.time_ns, m.message.data) for m in bag.messages()]


def write_with_rosbags(path, messages, storage, mode, serialized):
    writer = Writer(path, version=8, storage_plugin=storage)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/image", "sensor_msgs/msg/Image", typestore=typestore())
        for time_ns, message in messages:
            writer.write(connection, time_ns, serialized(message))


@pytest.mark.parametrize(
    ("storage", "mode"),
    [
        (StoragePlugin.MCAP, CompressionMode.NONE),
        (StoragePlugin.MCAP, CompressionMode.MESSAGE),
        (StoragePlugin.MCAP, CompressionMode.STORAGE),
        (StoragePlugin.MCAP, CompressionMode.FILE),
        (StoragePlugin.SQLITE3, CompressionMode.NONE),
        (StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
        (StoragePlugin.SQLITE3, CompressionMode.FILE),
    ],
)
def test_every_storage_and_compression_of_rosbag2(tmp_path, storage, mode, image_message, serialized):
    # Recorded out of order: messages come in time order.
    times = [5, 3, 4, 10**9, 7]
    written = {t: image_message(i) for i, t in enumerate(times)}
    write_with_rosbags(tmp_path / "bag", list(written.items()), storage, mode, serialized)
    alone = next(path for path in (tmp_path / "bag").iterdir() if path.name != "metadata.yaml")
    for path in (tmp_path / "bag", tmp_path / "bag" / "metadata.yaml", alone):
        with open_bag([path]) as bag:
            assert [(t.name, t.type_name, t.count) for t in bag.topics] == [("/image", "sensor_msgs/msg/Image", 5)]
            assert (bag.message_count, bag.start_ns, bag.end_ns) == (5, 3, 10**9)
            got = list(bag.messages(["/image"]))
            assert [m.time_ns for m in got] == sorted(times)
            for m in got:
                assert np.array_equal(m.message.data, written[m.time_ns].data)
                assert m.message.header.frame_id == "camera"
            assert list(bag.messages([])) == []
            assert list(bag.messages(["/other"])) == []
            assert [m.time_ns for m in bag.messages()] == sorted(times)  # another pass
            assert bag.warnings == ()


@pytest.mark.parametrize("compression", [None, "BZ2", "LZ4"])
def test_rosbag1_gives_messages_with_ros2_fields(tmp_path, compression, write_rosbag1):
    write_rosbag1(tmp_path / "one.bag", 10, compression)
    with open_bag([tmp_path / "one.bag"]) as bag:
        assert {t.name: t.count for t in bag.topics} == {"/camera/image_raw": 10, "/camera/camera_info": 10}
        assert (bag.start_ns, bag.end_ns) == (10**9, 10**9 + 9)
        images = list(bag.messages(["/camera/image_raw"]))
        assert [int(m.message.data[0]) for m in images] == list(range(10))
        assert images[3].message.header.stamp.sec == 3
        info = next(bag.messages(["/camera/camera_info"])).message
        assert np.array_equal(info.k, np.arange(9.0))
        assert np.array_equal(info.p, np.arange(12.0))
        assert info.__msgtype__ == "sensor_msgs/msg/CameraInfo"
        assert bag.warnings == ()
        # as CDR, for a player: rosbags' own Jazzy store reads it
        raw = next(bag.cdr_messages(["/camera/camera_info"]))
        assert np.array_equal(typestore().deserialize_cdr(raw.data, "sensor_msgs/msg/CameraInfo").k, np.arange(9.0))


def test_several_bags_are_read_as_one(tmp_path, write_rosbag1, image_message):
    write_rosbag1(tmp_path / "one.bag", 3)  # 1e9, 1e9 + 1, 1e9 + 2
    for name, times in (("a", [10**9 + 1, 10**9 + 5]), ("b", [10**9 - 1, 10**9 + 3])):
        with BagWriter(tmp_path / name, "mcap" if name == "a" else "sqlite3") as writer:
            for t in times:
                writer.write("/camera/image_raw", image_message(1), t)
    with open_bag([tmp_path / "one.bag", tmp_path / "a", tmp_path / "b"]) as bag:
        times = [m.time_ns - 10**9 for m in bag.messages(["/camera/image_raw"])]
        assert times == [-1, 0, 1, 1, 2, 3, 5]
        assert bag.message_count == 3 + 3 + 2 + 2


@pytest.mark.parametrize("compression", ["", "zstd", "lz4"])
@pytest.mark.parametrize("is_indexed", [True, False])
def test_overlapping_chunks_are_merged_by_time(tmp_path, tiny_mcap, compression, is_indexed):
    chunks = [[(5, "e"), (1, "a")], [(2, "b"), (6, "f")], [(3, "c")], [(10, "g"), (11, "h")]]
    (tmp_path / "x").write_bytes(tiny_mcap(chunks, compression, is_indexed=is_indexed).data())
    with open_bag([tmp_path / "x"]) as bag:
        assert texts(bag) == sorted(functools.reduce(operator.iadd, chunks, []))
        assert (bag.message_count, bag.start_ns, bag.end_ns, bag.warnings) == (7, 1, 11, ())


def test_messages_outside_of_chunks(tmp_path, tiny_mcap):
    chunks = [[(5, "e"), (1, "a")], [(2, "b")]]
    (tmp_path / "x.mcap").write_bytes(tiny_mcap(chunks, is_chunked=False).data())
    with open_bag([tmp_path / "x.mcap"]) as bag:
        assert texts(bag) == [(1, "a"), (2, "b"), (5, "e")]
        assert bag.warnings == ()


def test_equal_times_keep_the_order_of_recording(tmp_path, tiny_mcap):
    (tmp_path / "x.mcap").write_bytes(tiny_mcap([[(1, "a"), (1, "b")], [(1, "c"), (1, "d")]]).data())
    with open_bag([tmp_path / "x.mcap"]) as bag:
        assert [value for _, value in texts(bag)] == ["a", "b", "c", "d"]


def test_a_definition_in_the_bag_counts_more_than_jazzys(tmp_path, mcap_parts):
    p = mcap_parts
    # std_msgs/String of another world, and a type that nobody knows
    definitions = p.schema(1, "std_msgs/msg/String", "uint8 more") + p.channel(1, 1, "/changed")
    definitions += p.schema(2, "my_msgs/msg/Own", "builtin_interfaces/Time when\nint32[] values") + p.channel(
        2, 2, "/own"
    )
    messages = p.message(1, 1, b"\0\1\0\0\x07") + p.message(
        2, 2, b"\0\1\0\0" + bytes([3, 0, 0, 0] * 2 + [1, 0, 0, 0, 9, 0, 0, 0])
    )
    data = p.magic + p.record(1, p.text("") + p.text("")) + definitions + messages
    (tmp_path / "x.mcap").write_bytes(data + p.record(2, bytes(20)) + p.magic)
    with open_bag([tmp_path / "x.mcap"]) as bag:
        changed, own = (m.message for m in bag.messages())
        assert changed.more == 7
        assert (own.when.sec, own.values.tolist()) == (3, [9])


def test_a_topic_of_unknown_type_affects_itself_alone(tmp_path, mcap_parts):
    p = mcap_parts
    definitions = p.schema(1, "std_msgs/msg/String", "string data") + p.channel(1, 1, "/text")
    definitions += p.schema(2, "my_msgs/msg/Own", "") + p.channel(2, 2, "/own")
    definitions += p.schema(3, "x", "{}", "jsonschema") + p.channel(3, 3, "/json", "json") + p.channel(4, 0, "/none")
    messages = b"".join(p.message(i, i, p.string_cdr("hello")) for i in (4, 3, 2, 1))
    data = p.magic + p.record(1, p.text("") + p.text("")) + definitions + messages
    (tmp_path / "x.mcap").write_bytes(data + p.record(2, bytes(20)) + p.magic)
    with open_bag([tmp_path / "x.mcap"]) as bag:
        assert texts(bag) == [(1, "hello")]
        assert len(bag.warnings) == 3
        assert any(w.startswith("/own: its messages cannot be read: type my_msgs/msg/Own") for w in bag.warnings)
        assert any("/json" in w and "need cdr or ros1" in w for w in bag.warnings)


def test_idl_definitions(tmp_path, mcap_parts):
    p = mcap_parts
    idl = "=" * 80 + "\nIDL: my_msgs/msg/Own\nmodule my_msgs { module msg { struct Own { int32 value; }; }; };"
    definitions = p.schema(1, "my_msgs/msg/Own", idl, "ros2idl") + p.channel(1, 1, "/own")
    data = p.magic + p.record(1, p.text("") + p.text("")) + definitions + p.message(1, 1, b"\0\1\0\0\x05\0\0\0")
    (tmp_path / "x.mcap").write_bytes(data + p.record(2, bytes(20)) + p.magic)
    with open_bag([tmp_path / "x.mcap"]) as bag:
        assert [m.message.value for m in bag.messages()] == [5]


@pytest.mark.parametrize("version", [1, 2])
def test_old_sqlite_schemas_use_jazzys_definitions(tmp_path, version, image_message, serialized):
    with sqlite3.connect(tmp_path / "old #1.db3") as database:  # a path that would break an unquoted URI
        qos = ", offered_qos_profiles TEXT NOT NULL" if version == 2 else ""
        database.execute(
            f"CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT{qos})"
        )
        database.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"
        )
        extra = (",''",) if version == 2 else ("",)
        database.execute(f"INSERT INTO topics VALUES(1, '/image', 'sensor_msgs/msg/Image', 'cdr'{extra[0]})")
        for i in (2, 1):
            database.execute("INSERT INTO messages VALUES(?, 1, ?, ?)", (3 - i, i, serialized(image_message(i))))
    database.close()
    with open_bag([tmp_path / "old #1.db3"]) as bag:
        assert [(m.time_ns, m.message.header.stamp.sec) for m in bag.messages()] == [(1, 1), (2, 2)]
        assert bag.warnings == ()


def test_a_write_ahead_log_is_read_too(tmp_path, image_message, serialized):
    with BagWriter(tmp_path / "bag", "sqlite3") as writer:
        writer.write("/image", image_message(1), 1)
    path = tmp_path / "bag" / "bag.db3"
    database = sqlite3.connect(path)
    database.execute("PRAGMA journal_mode = WAL")
    database.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES(1, 2, ?)", (serialized(image_message(2)),))
    database.commit()
    for suffix in ("", "-wal"):  # as after a crash: the log was never merged
        shutil.copy(f"{path}{suffix}", tmp_path / f"copy.db3{suffix}")
    database.close()
    with open_bag([tmp_path / "copy.db3"]) as bag:
        assert [m.time_ns for m in bag.messages()] == [1, 2]


def test_a_valid_bag_without_messages(tmp_path, tiny_mcap, write_rosbag1):
    with BagWriter(tmp_path / "mcap"):
        pass
    with BagWriter(tmp_path / "sqlite", "sqlite3"):
        pass
    write_rosbag1(tmp_path / "one.bag", 0)
    for path in (tmp_path / "mcap", tmp_path / "sqlite", tmp_path / "one.bag"):
        with open_bag([path]) as bag:
            assert (list(bag.messages()), bag.message_count, bag.start_ns, bag.end_ns) == ([], 0, 0, 0)
            assert bag.warnings == ()


def test_a_closed_bag_says_so(tmp_path, tiny_mcap):
    (tmp_path / "x.mcap").write_bytes(tiny_mcap([[(1, "a")], [(2, "b")]]).data())
    bag = open_bag([tmp_path / "x.mcap"])
    reading = bag.messages()
    next(reading)
    bag.close()
    bag.close()
    with pytest.raises(BagError, match="closed"):
        next(reading)
    with pytest.raises(BagError, match="closed"):
        list(bag.messages())


def test_memory_does_not_grow_with_the_bag(tmp_path, image_message):
    import tracemalloc

    def peak(count: int, storage: str) -> int:
        with BagWriter(tmp_path / f"{storage}{count}", storage, "zstd") as writer:
            image = image_message(1, 640, 480)
            for i in range(count):
                writer.write("/image", image, i)
        with open_bag([tmp_path / f"{storage}{count}"]) as bag:
            next(bag.messages())  # types and imports
            tracemalloc.start()
            try:
                assert sum(1 for _ in bag.messages()) == count
                return tracemalloc.get_traced_memory()[1]
            finally:
                tracemalloc.stop()

    for storage in ("mcap", "sqlite3"):
        assert peak(80, storage) < peak(10, storage) + 2_000_000


def test_the_recorded_ros1_bag(data_dir):
    with open_bag([data_dir / "bags" / "ros_numpy_test_a.bag"]) as bag:
        got = {m.topic: m.message for m in bag.messages()}
    assert (got["/image"].encoding, got["/image"].data.size) == ("rgb8", got["/image"].height * got["/image"].step)
    assert got["/compressedimage"].data[:8].tobytes() == b"\x89PNG\r\n\x1a\n"
    assert (got["/vector3"].x, got["/vector3"].y, got["/vector3"].z) == (1.0, 2.0, 3.0)


def test_messages_of_make_message_come_back(tmp_path):
    info = make_message("sensor_msgs/msg/CameraInfo", k=np.arange(9.0), d=np.arange(5.0), distortion_model="plumb_bob")
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/info", info, 1)
    with open_bag([tmp_path / "bag"]) as bag:
        got = next(bag.messages()).message
    assert np.array_equal(got.k, info.k)
    assert np.array_equal(got.d, info.d)
