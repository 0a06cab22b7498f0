# SPDX-License-Identifier: Apache-2.0
"""Compressed bytes that become too many: refused with the limit's name, in bounded memory; the near side is read."""

from __future__ import annotations

import bz2
import shutil
import struct
import tracemalloc
from collections import namedtuple

import lz4.frame
import pytest

from imgu_ros.bags import compression
from imgu_ros.bags.compression import Expansion, decompressed, decompressed_message, zstd
from imgu_ros.bags.reading import open_bag
from imgu_ros.bags.salvage.chunks import ChannelRecord, DefinitionBudget, Definitions, SchemaRecord
from imgu_ros.config.parameters import LimitsParameters
from imgu_ros.errors import BagError

SMALL = LimitsParameters(message_mb=8, temporary_mb=3)
COMPRESS = {"zstd": zstd.compress, "lz4": lz4.frame.compress, "bz2": bz2.compress}


def peak_mb(call):
    tracemalloc.start()
    try:
        call()
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    return peak / 1e6


@pytest.mark.parametrize("method", ["zstd", "lz4", "bz2"])
def test_chunks_are_decompressed_up_to_the_limit_and_not_beyond(method):
    near = bytes(8_000_000)
    assert bytes(decompressed(COMPRESS[method](near), method, len(near), SMALL)) == near
    packed = COMPRESS[method](bytes(60_000_000))

    def claimed(size):
        with pytest.raises(BagError, match="limits.message_mb|more bytes than announced"):
            decompressed(packed, method, size, SMALL)

    for size in (60_000_000, 2**63, 1000, 8_000_000):
        assert peak_mb(lambda size=size: claimed(size)) < 30


def test_a_chunk_larger_than_what_is_decompressed_at_once():
    data = bytes(range(256)) * 70_000
    for method in ("zstd", "lz4"):
        assert bytes(decompressed(COMPRESS[method](data), method, len(data))) == data


def test_zstd_frames_one_behind_the_other_and_skippable_ones():
    skippable = struct.pack("<II", 0x184D2A50, 0)
    frames = b"".join(skippable + zstd.compress(bytes([i]) * 1000) for i in range(20))
    want = b"".join(bytes([i]) * 1000 for i in range(20))
    assert decompressed(frames, "zstd", len(want)) == want
    # hundreds of thousands of empty ones cost no quadratic time
    assert decompressed(skippable * 20_000 + zstd.compress(b"x" * 9), "zstd", 9) == b"x" * 9


def test_a_window_of_two_gigabytes_is_refused():
    frame = bytearray(b"\x28\xb5\x2f\xfd\x00\xa8") + b"\x01\0\0"  # window descriptor: 2^31 bytes
    with pytest.raises(BagError, match="damaged"):
        decompressed(bytes(frame), "zstd", 100)


def test_messages_that_are_bombs_are_refused():
    near = bytes(8_000_000)
    assert bytes(decompressed_message(zstd.compress(near), SMALL)) == near
    with pytest.raises(BagError, match=r"need at most 8 \(limits.message_mb\)"):
        decompressed_message(zstd.compress(bytes(8_000_001)), SMALL)


def test_all_chunks_together_stay_below_the_expansion():
    expansion = Expansion(LimitsParameters(expansion=100))
    for _ in range(10):
        expansion.take(10, 200_001_000 - 1000)
    with pytest.raises(BagError, match=r"limits.expansion"):
        expansion.take(10, 200_000_000)
    expansion.take(10_000_000, 1_000_000_000)  # what is below the factor always may


def test_chunks_that_announce_less_than_they_have_count_with_what_they_become(tmp_path, mcap_parts, monkeypatch):
    p, pieces = mcap_parts, []
    packed = zstd.compress(p.record(0x90, bytes(1_000_000)))
    head = struct.pack("<QQQI", 5, 5, 100, 0) + p.text("zstd") + struct.pack("<Q", len(packed))
    definitions = p.schema(1, "std_msgs/msg/String", "string data") + p.channel(1, 1, "/text")
    data = p.magic + p.record(1, p.text("") * 2) + definitions + 50 * p.record(6, head + packed)
    (tmp_path / "x.mcap").write_bytes(data + p.record(2, bytes(20)) + p.magic)
    decompress = compression._pieces

    def counted(*arguments):
        for piece in decompress(*arguments):
            pieces.append(len(piece))
            yield piece

    monkeypatch.setattr(compression, "_pieces", counted)
    monkeypatch.setattr(compression, "_FREE_IN_PASSING", 5_000_000)
    with open_bag([tmp_path / "x.mcap"], limits=LimitsParameters(expansion=100)) as bag:
        assert list(bag.messages()) == []
    assert 5_000_000 < sum(pieces) < 12_000_000  # of 50 MB, read twice where nothing tells of them


def test_a_file_is_decompressed_as_far_as_the_limits_allow(tmp_path, tiny_mcap, monkeypatch):
    chunks = [[(c, f"{c} " + "x" * 100_000)] for c in range(60)]
    made = tiny_mcap(chunks)
    path = tmp_path / "x.mcap.zstd"
    path.write_bytes(zstd.compress(made.data()))

    def times(limits):
        with open_bag([path], limits=limits) as bag:
            return [m.time_ns for m in bag.messages()], bag.warnings

    assert times(LimitsParameters(temporary_mb=7)) == (list(range(60)), ())
    got, warnings = times(SMALL)
    assert got == list(range(len(got)))
    assert 15 < len(got) < 30
    assert "need at most 3 MB of temporary copies (limits.temporary_mb)" in warnings[0]
    assert any("cut short" in warning for warning in warnings)

    monkeypatch.setattr(compression, "_FREE_ON_DISK", 2_000_000)
    got, warnings = times(LimitsParameters(expansion=1))
    assert 5 < len(got) < 30
    assert "(limits.expansion)" in warnings[0]

    usage = namedtuple("usage", "total used free")
    free = iter([504_000_000, 500_000_000])
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(10**10, 0, next(free)))
    got, warnings = times(LimitsParameters(expansion=1_000_000))
    assert 5 < len(got) < 60
    assert "MB left; need more" in warnings[0]


def test_overlapping_bombs_are_read_one_after_the_other(tmp_path, mcap_parts):
    p = mcap_parts
    records = p.message(1, 5, p.string_cdr("y" * 4_000_000))
    chunk = p.chunk(records, 5, 5, "zstd", crc=False)
    definitions = p.schema(1, "std_msgs/msg/String", "string data") + p.channel(1, 1, "/text")
    data = p.magic + p.record(1, p.text("") * 2) + definitions + chunk * 30 + p.record(2, bytes(20)) + p.magic
    (tmp_path / "x.mcap").write_bytes(data)

    def count():
        with open_bag([tmp_path / "x.mcap"], limits=SMALL) as bag:
            assert sum(1 for _ in bag.raw_messages()) == 30

    assert peak_mb(count) < 40


def test_definitions_of_files_in_one_share_their_room(tmp_path, mcap_parts):
    """Chunks of a thousand bytes that each hold eight megabytes of definitions, of one file behind the other."""
    p = mcap_parts

    def one(number):
        texts = [chr(65 + number) + letter * 3_900_000 for letter in "ab"]
        records = b"".join(p.schema(i + 1, "a/msg/B", text) for i, text in enumerate(texts))
        records += p.channel(1, 1, "/text") + p.message(1, number, p.string_cdr("a"))
        return p.magic + p.record(1, p.text("") * 2) + p.channel(9, 9, "") + p.chunk(records, 0, 9, "zstd", crc=False)

    (tmp_path / "x.mcap").write_bytes(b"".join(map(one, range(30))) + p.magic)

    def read():
        with open_bag([tmp_path / "x.mcap"], limits=SMALL) as bag:
            # What a definition is lost of is skipped, and said.
            assert 5 < sum(1 for _ in bag.raw_messages()) <= 30

    assert peak_mb(read) < 130


def test_a_text_that_comes_again_takes_no_room():
    texts = [str(i) * 400 for i in range(3)]
    budget = DefinitionBudget(left=3000)
    files = [Definitions() for _ in range(3)]
    for definitions in files:
        definitions.define(SchemaRecord(1, "a/msg/B", "ros2msg", texts[0] + ""))
        definitions.define(ChannelRecord(1, 1, "/a", "cdr"))
        definitions.share(budget)
    assert all(definitions.schemas and definitions.channels for definitions in files)
    assert budget.left == 3000 - 400 - 3 * (200 + 7) - 3 * (200 + 2)
    for i in (1, 2, 3):
        files[0].define(SchemaRecord(i, "a/msg/C", "ros2msg", texts[1] if i == 2 else texts[2] * 4))
    assert files[0].schemas.keys() == {1, 2}


@pytest.mark.parametrize("method", ["zstd", "lz4"])
def test_a_few_bytes_that_become_endlessly_many_messages(tmp_path, mcap_parts, method):
    """Three hundred bytes become 200,000 messages: not all are read, which is said, and no others are lost."""
    p = mcap_parts
    definitions = p.schema(1, "std_msgs/msg/String", "string data") + p.channel(1, 1, "/text")

    def chunk(records):
        packed = COMPRESS[method](records)
        content = struct.pack("<QQQI", 5, 5, len(records), 0) + p.text(method) + struct.pack("<Q", len(packed)) + packed
        return p.record(6, content)

    def message(number, text):
        return p.record(5, struct.pack("<HIQQ", 1, 0, number, number) + p.string_cdr(text))

    one = p.record(5, struct.pack("<HIQQ", 1, 0, 7, 7) + p.string_cdr("again"))
    good = b"".join(message(9 + i, "good") for i in range(3))
    data = p.magic + p.record(1, p.text("") * 2) + definitions + chunk(200_000 * one) + chunk(good)
    (tmp_path / "x.mcap").write_bytes(data + p.record(2, bytes(20)) + p.magic)
    with open_bag([tmp_path / "x.mcap"]) as bag:
        for _ in range(2):  # the second pass gives the same
            texts = [message.message.data for message in bag.messages()]
            assert texts[-3:] == ["good"] * 3
            assert 100_000 <= len(texts) - 3 < 150_000
        assert "limits.expansion" in " ".join(bag.warnings)


def test_many_small_messages_with_stamps_of_their_own_are_all_read(tmp_path, mcap_parts):
    """The near side: a clock, whose messages compress as well as messages can that have been recorded."""
    p, count = mcap_parts, 150_000
    records = bytearray()
    for i in range(count):
        stamp = 10**18 + i * 1_000_000 + i * 7919 % 1000
        content = (
            struct.pack("<HIQQ", 1, i, stamp, stamp) + b"\0\1\0\0" + struct.pack("<iI", i // 1000, i % 1000 * 10**6)
        )
        records += p.record(5, content)
    packed = zstd.compress(bytes(records))
    head = struct.pack("<QQQI", 10**18, 10**18 + count * 10**6, len(records), 0) + p.text("zstd")
    definitions = p.schema(1, "builtin_interfaces/msg/Time", "int32 sec\nuint32 nanosec") + p.channel(1, 1, "/clock")
    data = p.magic + p.record(1, p.text("") * 2) + definitions
    data += p.record(6, head + struct.pack("<Q", len(packed)) + packed)
    (tmp_path / "x.mcap").write_bytes(data + p.record(2, bytes(20)) + p.magic)
    with open_bag([tmp_path / "x.mcap"]) as bag:
        assert sum(1 for _ in bag.raw_messages()) == count
        assert bag.warnings == ()
