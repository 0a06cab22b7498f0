# SPDX-License-Identifier: Apache-2.0
"""Damaged bags: what can be read is read, what is lost is said, and nothing but BagError is raised."""

from __future__ import annotations

import os
import resource
import shutil
import time

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from imgu_ros.bags.messages import make_message, typestore
from imgu_ros.bags.reading import open_bag
from imgu_ros.bags.writing import BagWriter
from imgu_ros.config.parameters import LimitsParameters
from imgu_ros.errors import BagError

#: Ten chunks of three messages.
CHUNKS = [[(10 * c + i, f"message {10 * c + i:03d} " * 5) for i in range(3)] for c in range(10)]
ALL = [message for chunk in CHUNKS for message in chunk]


def read(path, limits=LimitsParameters()):  # noqa: B008 (frozen)
    with open_bag([path], limits=limits) as bag:
        got = [(m.time_ns, m.message.data) for m in bag.messages()]
        return got, bag.warnings


def one_line(error) -> str:
    text = str(error.value)
    assert text
    assert "\n" not in text
    return text


@pytest.mark.parametrize("compression", ["", "zstd", "lz4"])
@pytest.mark.parametrize("is_indexed", [True, False])
def test_a_cut_mcap_gives_every_complete_chunk(tmp_path, tiny_mcap, compression, is_indexed):
    whole = tiny_mcap(CHUNKS, compression, is_indexed=is_indexed)
    data = whole.data()
    path = tmp_path / "cut.mcap"
    for size in range(9, len(data) - 20, 97):
        path.write_bytes(data[:size])
        got, warnings = read(path)
        complete = [m for chunk, (_, end) in zip(CHUNKS, whole.offsets, strict=True) if end <= size for m in chunk]
        # of an uncompressed chunk, the messages before the cut come along
        assert got[: len(complete)] == complete
        assert ALL[: len(got)] == got
        assert len(got) < len(complete) + 3
        assert compression == "" or got == complete
        if size < whole.offsets[-1][1]:
            assert any("cut short" in w or "the end of the file is missing" in w for w in warnings), size


def test_the_loss_is_said_with_bytes_and_time(tmp_path, tiny_mcap):
    chunks = [[(1_500_000_000 + i, "a" * 500)] for i in range(4)]
    whole = tiny_mcap(chunks, "zstd")
    data = whole.data()
    (tmp_path / "cut.mcap").write_bytes(data[: whole.offsets[2][0] + 20])
    got, warnings = read(tmp_path / "cut.mcap")
    assert len(got) == 2
    assert warnings == ("cut.mcap: cut short or damaged: its last 20 bytes are incomplete; read until 1.500000001 s",)


def test_messages_outside_of_chunks_survive_a_cut(tmp_path, tiny_mcap):
    data = tiny_mcap(CHUNKS, is_chunked=False).data()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) * 6 // 10])
    got, warnings = read(tmp_path / "cut.mcap")
    assert got == ALL[: len(got)]
    assert 15 <= len(got) <= 20
    assert len(warnings) == 1


@pytest.mark.parametrize("compression", ["", "zstd", "lz4"])
def test_a_corrupted_chunk_is_said_and_costs_no_other(tmp_path, tiny_mcap, compression):
    whole = tiny_mcap(CHUNKS, compression)
    data = bytearray(whole.data())
    start, end = whole.offsets[4]
    data[(start + end) // 2] ^= 0x40
    (tmp_path / "x.mcap").write_bytes(data)
    got, warnings = read(tmp_path / "x.mcap")
    assert [m for m in got if m in ALL] == [m for c, chunk in enumerate(CHUNKS) for m in chunk if c != 4 or m in got]
    # what can be had of it comes, for the checksum may be what is wrong
    assert len(got) == len(ALL) if compression == "" else len(got) <= len(ALL)
    assert f"chunk at byte {start}" in warnings[0]


@pytest.mark.parametrize(("compression", "is_chunked"), [("", True), ("zstd", True), ("", False)])
def test_a_corrupted_length_costs_one_chunk(tmp_path, tiny_mcap, compression, is_chunked):
    whole = tiny_mcap(CHUNKS, compression, is_chunked=is_chunked)
    data = bytearray(whole.data())
    start, end = whole.offsets[4]
    # outside of chunks, a message one byte too long swallows the next one's first byte
    for forged in (2**62, 2**40, 0, 1, *([end - start + 1] if is_chunked else [])):
        data[start + 1 : start + 9] = forged.to_bytes(8, "little")
        (tmp_path / "x.mcap").write_bytes(data)
        got, warnings = read(tmp_path / "x.mcap")
        other = [m for c, chunk in enumerate(CHUNKS) if c != 4 for m in chunk]
        assert set(other) <= set(got), forged
        assert set(got) <= set(ALL)
        assert warnings


def test_a_message_of_garbage_is_skipped_and_said(tmp_path, mcap_parts):
    p = mcap_parts
    records = p.schema(1, "std_msgs/msg/String", "string data") + p.channel(1, 1, "/text")
    bodies = [
        p.string_cdr("a"),
        b"",
        b"\xff" * 30,
        b"\0\1\0\0\xff\xff\xff\x7f",
        b"\x28\xb5\x2f\xfd\0\0",
        p.string_cdr("b"),
    ]
    for i, body in enumerate(bodies):
        records += p.message(1, i, body)
    data = p.magic + p.record(1, p.text("") * 2) + p.chunk(records, 0, 9) + p.record(2, bytes(20)) + p.magic
    (tmp_path / "x.mcap").write_bytes(data)
    got, warnings = read(tmp_path / "x.mcap")
    assert [value for _, value in got] == ["a", "b"]
    assert len(warnings) == 1
    assert "/text: the message at 0.000000001 s is damaged and skipped" in warnings[0]
    assert "(and 3 others)" in warnings[0]


def test_metadata_that_announces_more_is_said(tmp_path, image_message):
    with BagWriter(tmp_path / "bag", "mcap") as writer:
        for i in range(3000):
            writer.write("/image", image_message(1), i)
    path = tmp_path / "bag" / "bag.mcap"
    os.truncate(path, path.stat().st_size * 6 // 10)
    with open_bag([tmp_path / "bag"]) as bag:
        count = sum(1 for _ in bag.messages())
        assert count == bag.message_count
        assert 1600 < count < 1900
        assert any(f"{count} of the 3000 messages that metadata.yaml announces" in w for w in bag.warnings)
        assert any("cut short" in w for w in bag.warnings)


def test_missing_splits_are_named(data_dir):
    with open_bag([data_dir / "bags" / "soccer_goal_ros2_mcap_zstd"]) as bag:
        images = list(bag.messages())
        assert [(m.message.width, m.message.height, m.message.encoding) for m in images] == [(640, 480, "rgb8")] * 2
        assert all(m.message.data.size == 640 * 480 * 3 for m in images)
        assert len(bag.warnings) == 1
        assert (
            "12 of 13 files are missing (soccer_goal_0.mcap, soccer_goal_1.mcap, ..., soccer_goal_11.mcap)"
            in bag.warnings[0]
        )
        assert "249 of 251 messages" in bag.warnings[0]


@pytest.mark.parametrize("metadata", [None, b"", b"\xff\xfe\0", b"a: [", b"rosbag2_bagfile_information: 3", b"[1, 2]"])
def test_damaged_metadata_falls_back_to_the_files(tmp_path, metadata, tiny_mcap):
    (tmp_path / "a.mcap").write_bytes(tiny_mcap(CHUNKS[:5]).data())
    (tmp_path / "b.mcap").write_bytes(tiny_mcap(CHUNKS[5:]).data())
    if metadata is not None:
        (tmp_path / "metadata.yaml").write_bytes(metadata)
    got, warnings = read(tmp_path)
    assert got == ALL
    assert len(warnings) == 1
    assert "metadata.yaml" in warnings[0]


def test_one_damaged_split_does_not_cost_the_others(tmp_path, tiny_mcap):
    (tmp_path / "a.mcap").write_bytes(b"garbage")
    (tmp_path / "b.mcap").write_bytes(tiny_mcap(CHUNKS).data())
    (tmp_path / "c.mcap").write_bytes(b"")
    got, warnings = read(tmp_path)
    assert got == ALL
    assert sum(w.startswith("skipped: ") for w in warnings) == 2


def test_a_cut_compressed_file_gives_its_beginning(tmp_path, image_message, serialized):
    writer = Writer(tmp_path / "bag", version=8, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.FILE, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/image", "sensor_msgs/msg/Image", typestore=typestore())
        for i in range(6000):
            writer.write(connection, i, serialized(image_message(i % 50)))
    path = next((tmp_path / "bag").glob("*.zstd"))
    os.truncate(path, path.stat().st_size * 6 // 10)
    with open_bag([tmp_path / "bag"]) as bag:
        times = [m.time_ns for m in bag.messages()]
        assert times == list(range(len(times)))
        assert len(times) > 1000
        assert any("the compressed file is cut short" in w for w in bag.warnings)


def test_a_cut_sqlite_bag_gives_what_is_there(tmp_path, image_message):
    with BagWriter(tmp_path / "bag", "sqlite3") as writer:
        for i in range(2000):
            writer.write("/image", image_message(i % 7), i)
    path = tmp_path / "bag" / "bag.db3"
    os.truncate(path, path.stat().st_size * 6 // 10)
    with open_bag([tmp_path / "bag"]) as bag:
        times = [m.time_ns for m in bag.messages()]
        assert times[:1000] == list(range(1000))
        assert times == sorted(set(times))
        assert len(times) > 500
        assert any("cut short or damaged" in w for w in bag.warnings)


@pytest.mark.parametrize("compression", [None, "BZ2", "LZ4"])
def test_a_cut_ros1_bag_gives_every_complete_chunk(tmp_path, compression, write_rosbag1):
    write_rosbag1(tmp_path / "one.bag", 60, compression)
    data = (tmp_path / "one.bag").read_bytes()
    index = int.from_bytes(data[data.index(b"index_pos=") + 10 :][:8], "little")
    (tmp_path / "cut.bag").write_bytes(data[: index * 6 // 10])
    with open_bag([tmp_path / "cut.bag"]) as bag:
        values = [int(m.message.data[0]) for m in bag.messages(["/camera/image_raw"])]
        assert values == list(range(len(values)))
        assert 20 <= len(values) <= 37
        assert any("cut short" in w for w in bag.warnings)
    # as the recorder leaves it when it is killed: no index, and a header that says so
    at = data.index(b"index_pos=") + 10
    (tmp_path / "active.bag").write_bytes(data[:at] + bytes(8) + data[at + 8 : index])
    with open_bag([tmp_path / "active.bag"]) as bag:
        assert sum(1 for _ in bag.messages()) == 120
        assert any("end of the file is missing" in w for w in bag.warnings)


def test_a_damaged_chunk_of_a_ros1_bag_costs_itself_alone(tmp_path, write_rosbag1):
    write_rosbag1(tmp_path / "one.bag", 60, "LZ4")
    data = bytearray((tmp_path / "one.bag").read_bytes())
    starts = [i for i in range(len(data)) if data[i : i + 4] == b"op=\x05"]
    data[starts[3] - 30 : starts[3] + 30] = bytes(60)
    (tmp_path / "one.bag").write_bytes(data)
    with open_bag([tmp_path / "one.bag"]) as bag:
        values = {int(m.message.data[0]) for m in bag.messages(["/camera/image_raw"])}
        assert 55 <= len(values) < 60
        assert any("damaged and skipped" in w for w in bag.warnings)


def test_what_is_no_bag_is_refused_in_one_line(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "metadata_only").mkdir()
    (tmp_path / "metadata_only" / "metadata.yaml").write_text("a: [")
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "empty.db3").touch()
    (tmp_path / "random.bag").write_bytes(os.urandom(5000))
    (tmp_path / "short.mcap").write_bytes(b"\x89MCA")
    (tmp_path / "bad.db3").write_bytes(b"SQLite format 3\0" + os.urandom(5000))
    os.mkfifo(tmp_path / "pipe")  # must not block
    cases = {
        "nothing": "No such file",
        "pipe": "not a regular file",
        "folder": "no bag, video or picture in this folder",
        "metadata_only": "need .mcap or .db3 files",
        "empty.mcap": "empty file",
        "empty.db3": "empty file",
        "random.bag": "not a bag",
        "short.mcap": "not a bag",
        "bad.db3": "need",
    }
    for name, text in cases.items():
        with pytest.raises(BagError) as error:
            open_bag([tmp_path / name])
        assert text in one_line(error)
        assert name in one_line(error)
    with pytest.raises(BagError, match="no bag given"):
        open_bag([])


def test_a_bag_all_of_whose_splits_are_missing_is_refused(tmp_path, image_message):
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/image", image_message(1), 1)
    (tmp_path / "bag" / "bag.mcap").unlink()
    with pytest.raises(BagError, match=r"its files are missing \(bag.mcap\)"):
        open_bag([tmp_path / "bag"])


def test_splits_far_apart_are_opened_one_by_one(tmp_path, tiny_mcap):
    """A hundred splits, and metadata.yaml in an order of its own."""
    names = []
    for i, chunk in enumerate(CHUNKS):
        names.append(f"s_{i}.mcap")
        (tmp_path / names[-1]).write_bytes(tiny_mcap([chunk]).data())
    (tmp_path / "metadata.yaml").write_text(
        yaml.safe_dump({"rosbag2_bagfile_information": {"relative_file_paths": [f"old/{n}" for n in reversed(names)]}})
    )
    assert read(tmp_path) == (ALL, ())


@pytest.fixture(scope="module")
def small_bags(tmp_path_factory):
    """Bytes of one small file of each kind, by name."""
    folder = tmp_path_factory.mktemp("small")
    files = {}
    for storage, compression in (("mcap", "none"), ("mcap", "zstd"), ("sqlite3", "none"), ("sqlite3", "zstd")):
        name = f"{storage}_{compression}"
        with BagWriter(folder / name, storage, compression) as writer:
            for i in range(12):
                writer.write("/text", make_message("std_msgs/msg/String", data=f"text {i} " * 9), 100 + i)
                writer.write("/info", make_message("sensor_msgs/msg/CameraInfo", width=i), 100 + i)
        files[name] = next((folder / name).glob(f"{name}.*")).read_bytes()
    return files


@pytest.mark.parametrize("at", [28_000, 28_800, 31_000, 33_500, 36_000])
def test_a_sqlite_bag_that_lacks_a_byte_comes_to_an_end(at, small_bags, tmp_path):
    """SQLite gives the rows of such a file again and again."""
    whole = small_bags["sqlite3_none"]
    path = tmp_path / "damaged"
    path.write_bytes(whole[:at] + whole[at + 1 :])
    with open_bag([path]) as bag:
        assert bag.message_count <= 24
        assert sum(1 for _ in bag.messages()) <= 24
        assert bag.warnings


@st.composite
def damage(draw):
    """A function that damages some bytes."""
    steps = draw(
        st.lists(
            st.one_of(
                st.tuples(st.just("cut"), st.floats(0, 1)),
                st.tuples(st.just("flip"), st.floats(0, 1, exclude_max=True), st.integers(0, 7)),
                st.tuples(
                    st.just("forge"), st.floats(0, 1), st.sampled_from([2**64 - 1, 2**63, 2**40, 2**31, 2**30, 0])
                ),
                st.tuples(st.just("remove"), st.floats(0, 1), st.integers(1, 300)),
            ),
            min_size=1,
            max_size=3,
        )
    )

    def apply(data: bytes) -> bytes:
        out = bytearray(data)
        for kind, where, *what in steps:
            at = int(where * len(out))
            if kind == "cut":
                del out[at:]
            elif kind == "flip" and out:
                out[at] ^= 1 << what[0]
            elif kind == "forge":
                out[at : at + 8] = what[0].to_bytes(8, "little")
            elif kind == "remove":
                del out[at : at + what[0]]
        return bytes(out)

    return apply


@pytest.mark.parametrize("kind", ["mcap_none", "mcap_zstd", "sqlite3_none", "sqlite3_zstd", "rosbag1", "tiny"])
@given(damages=st.lists(damage(), min_size=4, max_size=4))
def test_any_damage_gives_messages_warnings_or_a_bag_error(
    kind, damages, small_bags, tmp_path_factory, tiny_mcap, write_rosbag1
):
    if kind not in small_bags:
        if kind == "rosbag1":
            path = tmp_path_factory.mktemp("one") / "one.bag"
            write_rosbag1(path, 8, "LZ4")
            small_bags[kind] = path.read_bytes()
        else:
            small_bags[kind] = tiny_mcap(CHUNKS, "lz4").data()
    path = tmp_path_factory.getbasetemp() / "damaged"
    for apply in damages:
        path.write_bytes(apply(small_bags[kind]))
        began = time.monotonic()
        try:
            with open_bag([path]) as bag:
                for message in bag.messages():
                    assert 0 <= message.time_ns < 2**63
                for raw in bag.cdr_messages():
                    assert isinstance(raw.data, bytes)
                assert all("\n" not in warning for warning in bag.warnings)
                assert bag.start_ns <= max(bag.end_ns, bag.start_ns)
        except BagError as error:
            lines = str(error).splitlines()
            assert len(lines) == 1
        assert time.monotonic() - began < 5
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < 2_000_000  # KB: no forged length was allocated


def test_a_zstd_bomb_is_refused_before_it_fills_the_memory(tmp_path, mcap_parts):
    p = mcap_parts
    from imgu_ros.bags.compression import zstd

    bomb = zstd.compress(bytes(50_000_000))
    records = p.schema(1, "std_msgs/msg/String", "string data") + p.channel(1, 1, "/text") + p.message(1, 1, bomb)
    data = p.magic + p.record(1, p.text("") * 2) + p.chunk(records, 1, 1) + p.record(2, bytes(20)) + p.magic
    (tmp_path / "x.mcap").write_bytes(data)
    got, warnings = read(tmp_path / "x.mcap", LimitsParameters(message_mb=10))
    assert got == []
    assert "need at most 10 (limits.message_mb)" in warnings[0]


def test_a_bag_that_shrinks_while_it_is_read(tmp_path, tiny_mcap):
    path = tmp_path / "x.mcap"
    path.write_bytes(tiny_mcap(CHUNKS).data())
    with open_bag([path]) as bag:
        reading = bag.messages()
        next(reading)
        os.truncate(path, 500)
        rest = list(reading)
        assert len(rest) < len(ALL) - 1
        assert bag.warnings


def test_an_unreadable_file_is_said(tmp_path, tiny_mcap, monkeypatch):
    path = tmp_path / "x.mcap"
    path.write_bytes(tiny_mcap(CHUNKS).data())

    def refuse(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("imgu_ros.bags.byte_file.os.open", refuse)
    with pytest.raises(BagError, match="Permission denied; need a readable file"):
        open_bag([path])


def test_a_temporary_folder_is_removed(tmp_path, monkeypatch, tiny_mcap):
    from imgu_ros.bags.compression import zstd

    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    (tmp_path / "x.mcap.zstd").write_bytes(zstd.compress(tiny_mcap(CHUNKS).data()))
    with open_bag([tmp_path / "x.mcap.zstd"]) as bag:
        assert bag.message_count == len(ALL)
        assert len(list((tmp_path / "temporary").iterdir())) == 1
    assert list((tmp_path / "temporary").iterdir()) == []
    shutil.rmtree(tmp_path / "temporary")
    with pytest.raises(BagError, match="no temporary folder"):
        open_bag([tmp_path / "x.mcap.zstd"])
