# SPDX-License-Identifier: Apache-2.0
"""Recordings whose index, footer, sizes or order are wrong: what a scan by the format's description finds is read."""

from __future__ import annotations

import os
import random
import struct
import zlib
from collections import Counter

import pytest
from rosbags.rosbag1 import Writer as Rosbag1Writer

from fuzz.scan import identity, mcap_messages, rosbag1_messages
from imgu_ros.bags.reading import open_bag
from imgu_ros.bags.salvage import chunks
from imgu_ros.bags.storage import MessageBlock, RawMessage, merge_by_time
from imgu_ros.bags.writing import BagWriter
from imgu_ros.config.parameters import LimitsParameters
from imgu_ros.errors import BagError

CHUNKS = [[(10 * c + i, f"message {10 * c + i:03d} " * 5) for i in range(3)] for c in range(6)]
ALL = [message for chunk in CHUNKS for message in chunk]


def read(path, limits=LimitsParameters()):  # noqa: B008 (frozen)
    with open_bag([path], limits=limits) as bag:
        return [(m.time_ns, m.message.data) for m in bag.messages()], bag.warnings


def raw(path):
    """Return the identity of each message, as the scans do, and the warnings; nothing when the file is refused."""
    try:
        with open_bag([path]) as bag:
            return Counter(identity(m.time_ns, m.data) for m in bag.raw_messages()), bag.warnings
    except BagError as error:
        return Counter(), (str(error),)


def statistics(p, messages, chunks, counts, start, end):
    entries = b"".join(struct.pack("<HQ", *entry) for entry in counts.items())
    head = struct.pack("<QHIIIIQQ", messages, 1, len(counts), 0, 0, chunks, start, end)
    return p.record(11, head + struct.pack("<I", len(entries)) + entries)


def with_statistics(p, data, *promised):
    """Put statistics before the footer of a tiny file."""
    end = len(data) - 9 - 20 - 8
    return data[:end] + statistics(p, *promised) + data[end:]


def mutated(data: bytes, rng: random.Random) -> bytes:
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 3))):
        at = rng.randrange(len(out))
        kind = rng.randrange(5)
        if kind == 0:
            out[at] = rng.randrange(256)
        elif kind == 1:
            out[at] ^= 1 << rng.randrange(8)
        elif kind == 2:
            out[at : at + 8] = rng.choice((0, 1, 22, 2**31, 2**40, 2**63, 2**64 - 1)).to_bytes(8, "little")
        elif kind == 3:
            del out[at : at + rng.randrange(1, 40)]
        else:
            out[at:at] = rng.randbytes(rng.randrange(1, 40))
    return bytes(out)


@pytest.mark.parametrize("compression", ["", "zstd", "lz4"])
@pytest.mark.parametrize("layout", ["indexed", "unindexed", "unchunked", "statistics"])
def test_never_fewer_messages_of_an_mcap_than_a_scan_finds(tmp_path, tiny_mcap, mcap_parts, compression, layout):
    made = tiny_mcap(CHUNKS, compression, layout != "unchunked", layout != "unindexed")
    data = made.data()
    if layout == "statistics":
        data = with_statistics(mcap_parts, data, 18, 6, {1: 18}, 0, 52)
    assert sum(mcap_messages(data).values()) == len(ALL)
    rng = random.Random(f"{compression} {layout}")
    path = tmp_path / "x.mcap"
    for number in range(60):
        damaged = data[: rng.randrange(8, len(data))] if number % 4 == 0 else data[:8] + mutated(data[8:], rng)
        path.write_bytes(damaged)
        got, warnings = raw(path)
        lost = mcap_messages(damaged) - got
        assert not lost, (number, lost, warnings)
        if layout == "statistics" and sum(got.values()) < len(ALL):
            assert warnings, number


@pytest.mark.parametrize("compression", [None, "LZ4", "BZ2"])
def test_never_fewer_messages_of_a_ros1_bag_than_a_scan_finds(tmp_path, write_rosbag1, compression):
    path = tmp_path / "x.bag"
    write_rosbag1(path, 8, compression)
    data = path.read_bytes()
    assert sum(rosbag1_messages(data).values()) == 16
    rng = random.Random(str(compression))
    for number in range(60):
        damaged = data[: rng.randrange(13, len(data))] if number % 4 == 0 else data[:13] + mutated(data[13:], rng)
        path.write_bytes(damaged)
        got, warnings = raw(path)
        if any("definitions of" in warning for warning in warnings):
            continue  # a connection that is not defined
        lost = rosbag1_messages(damaged) - got
        assert not lost, (number, lost, warnings)
        if sum(got.values()) < 16:
            assert warnings, number


def test_files_one_behind_the_other_are_read_with_their_own_channels(tmp_path, tiny_mcap, mcap_parts):
    p = mcap_parts
    records = p.schema(1, "std_msgs/msg/String", "string data") + p.channel(1, 1, "/other")
    records += p.message(1, 7, p.string_cdr("of the second"))
    second = p.magic + p.record(1, p.text("") * 2) + p.chunk(records, 7, 7) + p.record(2, bytes(20)) + p.magic
    first = tiny_mcap(CHUNKS).data()
    (tmp_path / "x.mcap").write_bytes(first + second)
    with open_bag([tmp_path / "x.mcap"]) as bag:
        assert {topic.name: topic.count for topic in bag.topics} == {"/text": len(ALL), "/other": 1}
        assert [m.message.data for m in bag.messages(["/other"])] == ["of the second"]
        assert any(f"another file follows behind the footer at byte {len(first) - 37}" in w for w in bag.warnings)


def test_ros1_bags_one_behind_the_other(tmp_path, write_rosbag1):
    write_rosbag1(tmp_path / "a.bag", 5, "LZ4")
    write_rosbag1(tmp_path / "b.bag", 4)
    whole = (tmp_path / "a.bag").read_bytes() + (tmp_path / "b.bag").read_bytes()
    (tmp_path / "ab.bag").write_bytes(whole)
    with open_bag([tmp_path / "ab.bag"]) as bag:
        assert {topic.count for topic in bag.topics} == {9}
        assert sum(1 for _ in bag.messages()) == 18
        assert any("another bag follows" in w for w in bag.warnings)


@pytest.mark.parametrize("opcode", [0, 2, 4, 5, 7, 9, 0x46, 0x86])
def test_a_chunk_whose_type_is_another_is_read(tmp_path, tiny_mcap, opcode):
    made = tiny_mcap(CHUNKS, "zstd")
    data = bytearray(made.data())
    data[made.offsets[3][0]] = opcode
    (tmp_path / "x.mcap").write_bytes(data)
    got, warnings = read(tmp_path / "x.mcap")
    assert got == ALL
    assert any("read as a chunk" in warning for warning in warnings)


def test_what_follows_a_footer_is_read(tmp_path, tiny_mcap):
    made = tiny_mcap(CHUNKS)
    data = made.data()
    at = made.offsets[2][0]
    footer = data[-37:-8]
    for inserted in (footer, footer + data[-8:], footer + data[-8:] + b"junk" * 5):
        (tmp_path / "x.mcap").write_bytes(data[:at] + inserted + data[at:])
        got, warnings = read(tmp_path / "x.mcap")
        assert got == ALL
        assert any(f"goes on behind the footer at byte {at}" in warning for warning in warnings)


def test_a_false_chunk_hides_no_true_one(tmp_path, tiny_mcap):
    made = tiny_mcap(CHUNKS, "zstd")
    data = made.data()
    start, end = made.offsets[2]
    for size in (200, end - start + 11, end - start + 11 + 60):  # into the next chunk, to its end, beyond
        head = struct.pack("<BQQQQII", 6, 40 + size, 0, 1, size, 0, 0) + struct.pack("<Q", size)
        (tmp_path / "x.mcap").write_bytes(data[:start] + b"\0" * 20 + head + b"\0" * 11 + data[start:])
        got, warnings = read(tmp_path / "x.mcap")
        assert got == ALL, size
        assert warnings


def test_a_wrong_length_that_leads_beyond_chunks_loses_none(tmp_path, tiny_mcap, mcap_parts):
    made = tiny_mcap(CHUNKS, "zstd")
    data = made.data()
    (at, _), (far, _) = made.offsets[1], made.offsets[4]
    metadata = bytearray(mcap_parts.record(12, b"name" * 5))
    metadata[1:9] = (far - at + 30).to_bytes(8, "little")
    (tmp_path / "x.mcap").write_bytes(data[:at] + metadata + data[at:])
    got, warnings = read(tmp_path / "x.mcap")
    assert got == ALL
    assert any("damaged and skipped" in warning for warning in warnings)


def test_the_data_count_where_index_and_statistics_are_wrong(tmp_path, tiny_mcap, mcap_parts):
    data = tiny_mcap(CHUNKS).data()
    path = tmp_path / "x.mcap"
    path.write_bytes(with_statistics(mcap_parts, data, 18, 6, {1: 18}, 0, 52))
    assert read(path) == (ALL, ())
    for promised, said in (
        ((0, 6, {}, 0, 52), "0 messages by its statistics; 18 are there"),
        ((20, 6, {1: 20}, 0, 52), "20 messages by its statistics; 18 are there"),
        ((18, 7, {1: 18}, 0, 52), "7 chunks by its statistics; 6 are there"),
        ((18, 6, {9: 18}, 0, 52), "other numbers of messages"),
    ):
        path.write_bytes(with_statistics(mcap_parts, data, *promised))
        got, warnings = read(path)
        assert got == ALL
        assert any(said in warning for warning in warnings), warnings
    # a message index that names another channel, and one that has fewer entries, in a file without statistics
    at = data.index(b"\x07" + struct.pack("<QH", 54, 1))
    for forged in (
        data[: at + 9] + b"\x05\0" + data[at + 11 :],
        data[:at] + mcap_parts.message_index(1, [(0, 0)]) + data[at + 9 + 54 :],
    ):
        path.write_bytes(forged)
        got, warnings = read(path)
        assert got == ALL
        assert any("promises" in warning and "it has 3" in warning for warning in warnings) or b"\x05\0" in forged


def test_a_list_of_chunks_counts_without_statistics(tmp_path, tiny_mcap, mcap_parts):
    data = tiny_mcap(CHUNKS).data()
    end = len(data) - 37
    listed = mcap_parts.record(8, bytes(75))  # of which only the number counts
    for number, said in ((0, ()), (6, ()), (7, ("x.mcap: 7 chunks in its list of chunks; 6 are there",))):
        (tmp_path / "x.mcap").write_bytes(data[:end] + number * listed + data[end:])
        assert read(tmp_path / "x.mcap") == (ALL, said)


def test_a_summary_of_another_checksum_is_not_believed(tmp_path, tiny_mcap, mcap_parts):
    """Its channel has another topic than the one in the data."""
    data = tiny_mcap(CHUNKS).data()
    end = len(data) - 37
    summary = mcap_parts.schema(1, "std_msgs/msg/String", "string data") + mcap_parts.channel(1, 1, "/tezt")
    footer = struct.pack("<BQQQ", 2, 20, end, 0)
    for crc in (0, 1 + zlib.crc32(summary + footer)):
        whole = data[:end] + summary + footer + struct.pack("<I", crc & 0xFFFFFFFF) + mcap_parts.magic
        (tmp_path / "x.mcap").write_bytes(whole)
        with open_bag([tmp_path / "x.mcap"]) as bag:
            assert [(topic.name, topic.count) for topic in bag.topics] == [("/text", len(ALL))]
            assert bool(crc) == any("checksum of its summary" in warning for warning in bag.warnings)


def test_times_beyond_all_bounds_cost_no_message(tmp_path, mcap_parts):
    p = mcap_parts
    records = p.schema(1, "std_msgs/msg/String", "string data") + p.channel(1, 1, "/text")
    records += b"".join(p.message(1, time, p.string_cdr("x")) for time in (2**64 - 1, 5, 2**63, 6))
    for body in (p.chunk(records, 2**64 - 1, 2**64 - 1), records):
        (tmp_path / "x.mcap").write_bytes(
            p.magic + p.record(1, p.text("") * 2) + body + p.record(2, bytes(20)) + p.magic
        )
        got, _ = read(tmp_path / "x.mcap")
        assert sorted(time for time, _ in got) == [5, 6, 2**63 - 1, 2**63 - 1]


def test_an_attachment_of_gigabytes_is_not_read(tmp_path, tiny_mcap):
    made = tiny_mcap(CHUNKS)
    data = made.data()
    at = made.offsets[3][0]
    size = 5 * 10**9
    with (tmp_path / "x.mcap").open("wb") as file:
        file.write(data[:at] + struct.pack("<BQ", 9, size))
        file.seek(size, os.SEEK_CUR)
        file.write(data[at:])
    assert read(tmp_path / "x.mcap") == (ALL, ())


def test_a_file_that_is_replaced_or_cut_while_it_is_opened(tmp_path, tiny_mcap, monkeypatch):
    path = tmp_path / "x.mcap"
    made = tiny_mcap(CHUNKS, is_indexed=False)
    path.write_bytes(made.data())
    pread, calls = os.pread, []

    def shrinking(descriptor, size, offset):
        calls.append(offset)
        if len(calls) == 4:
            os.truncate(path, made.offsets[3][1])
        return pread(descriptor, size, offset)

    monkeypatch.setattr("imgu_ros.bags.byte_file.os.pread", shrinking)
    got, warnings = read(path)
    assert got == ALL[:12]
    assert warnings


def test_paths_that_lead_nowhere_are_refused_in_one_line(tmp_path):
    loop = tmp_path / "loop.mcap"
    loop.symlink_to(loop)
    for path in (loop, tmp_path / "a\0b", tmp_path / ("x" * 300), tmp_path / os.fsdecode(b"\xff\xfe.mcap")):
        with pytest.raises(BagError) as error:
            open_bag([path])
        assert "\n" not in str(error.value)


def test_a_path_that_is_not_utf8_is_read(tmp_path, tiny_mcap):
    path = tmp_path / os.fsdecode(b"caf\xe9.mcap")
    path.write_bytes(tiny_mcap(CHUNKS).data())
    assert read(path) == (ALL, ())


def test_chunks_that_overlap_are_open_together_within_the_limit():
    opened, most = [0], [0]

    def part(start):
        def messages():
            opened[0] += 1
            most[0] = max(most[0], opened[0])
            for time in (start, 100 + start):
                yield RawMessage(None, time, b"")
            opened[0] -= 1

        return MessageBlock(start, messages, start, 10_000)

    late = []
    times = [m.time_ns for m in merge_by_time([iter([part(i) for i in range(20)])], 50_000, lambda: late.append(1))]
    assert sorted(times) == [*range(20), *range(100, 120)]
    assert most[0] <= 4
    assert late
    late.clear()
    assert [
        m.time_ns for m in merge_by_time([iter([part(i) for i in range(20)])], 10**6, lambda: late.append(1))
    ] == sorted(times)
    assert not late


def test_a_whole_bag_has_no_warning(tmp_path, image_message, write_rosbag1):
    for storage, compression in (("mcap", "none"), ("mcap", "zstd")):
        with BagWriter(tmp_path / compression, storage, compression) as writer:
            for i in range(50):
                writer.write("/image", image_message(i), i)
        with open_bag([tmp_path / compression]) as bag:
            assert sum(1 for _ in bag.messages()) == bag.message_count == 50
            assert bag.warnings == ()
    assert Rosbag1Writer
    for compression in (None, "BZ2", "LZ4"):
        write_rosbag1(tmp_path / f"{compression}.bag", 20, compression)
        with open_bag([tmp_path / f"{compression}.bag"]) as bag:
            assert sum(1 for _ in bag.messages()) == bag.message_count == 40
            assert bag.warnings == ()


def test_endlessly_many_files_in_one_are_left_and_said(tmp_path, mcap_parts, monkeypatch):
    monkeypatch.setattr(chunks, "_MOST_FILES", 3)
    p = mcap_parts
    head = p.magic + p.record(1, p.text("") * 2)
    definitions = p.schema(1, "std_msgs/msg/String", "string data") + p.channel(1, 1, "/text")
    files = [head + definitions + p.message(1, i, p.string_cdr(str(i))) + p.record(2, bytes(20)) for i in range(5)]
    (tmp_path / "x.mcap").write_bytes(b"".join(file + p.magic for file in files))
    found, warnings = read(tmp_path / "x.mcap")
    assert found == [(0, "0"), (1, "1"), (2, "2")]
    assert sum("3 files follow one another" in warning for warning in warnings) == 1
