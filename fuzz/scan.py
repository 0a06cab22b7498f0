# SPDX-License-Identifier: Apache-2.0
"""What a recording holds by its format's specification alone: what no reader may give less of.

These scans share nothing with imgu_ros.bags: they walk a file from its first record to the first that does not hold.
"""

from __future__ import annotations

import os
import re
import sqlite3
import struct
import zlib
from collections import Counter
from contextlib import closing, suppress
from pathlib import Path
from urllib.parse import quote

import yaml

from fuzz import mcap, rosbag1
from fuzz.zstd import decompressed, decompressed_file

#: A message: its time in ns, its number of bytes, and their CRC-32.
Identity = tuple[int, int, int]
Messages = Counter[Identity]
_MOST_BYTES = 2**28
_LAST_TIME = 2**63 - 1
#: The last: a message of SQLite's about damaged text.
_SQLITE_ERRORS = (sqlite3.Error, MemoryError, UnicodeDecodeError)


def identity(time_ns: int, data: bytes | memoryview) -> Identity:
    """Return what tells a message from others."""
    return time_ns, len(data), zlib.crc32(data)


def scanned(path: Path) -> Messages:
    """Return the messages of a file, or of a folder's files."""
    if path.is_dir():
        return sum((scanned(file) for file in _files(path)), Messages())
    if not os.path.isfile(path):
        return Messages()
    data = path.read_bytes()
    if path.suffix == ".zstd" and data.startswith(b"\x28\xb5\x2f\xfd"):
        plain = path.parent / "plain"
        plain.write_bytes(decompressed_file(data, _MOST_BYTES))
        try:
            return scanned(plain)
        finally:
            plain.unlink()
    if data.startswith(mcap.MAGIC):
        return mcap_messages(data)
    if data.startswith(rosbag1.MAGIC):
        return rosbag1_messages(data)
    return sqlite_messages(path) if data.startswith(b"SQLite format 3\0") else Messages()


def _files(folder: Path) -> list[Path]:
    """Return the files that metadata.yaml names; where it names none that is there, those of the storage it names."""
    present = [path for path in sorted(folder.iterdir()) if path.suffix in (".mcap", ".db3", ".zstd")]
    try:
        path = folder / "metadata.yaml"
        text = path.read_text() if path.is_file() and path.stat().st_size < 10**6 else ""
        if re.search(r"[[{?-]{1000}", text.replace(" ", "")):
            return present  # the parser's stack is not deep enough
        information = yaml.load(text, yaml.CBaseLoader)["rosbag2_bagfile_information"]
        names = information.get("relative_file_paths")
        if not isinstance(names, list):  # it says the same twice
            names = [entry["path"] for entry in information["files"]]
        storage = {"mcap": ".mcap", "sqlite3": ".db3"}.get(str(information.get("storage_identifier")), "")
        named = [folder / name for name in names if isinstance(name, str)]
        named = [file for file in dict.fromkeys(named) if file in present]
        present = [path for path in present if storage in path.suffixes] or present
    except Exception:
        named = []
    return named or present


def mcap_messages(data: bytes) -> Messages:
    """Return the messages of an MCAP file, of channels that are defined before them."""
    found = Messages()
    channels: set[int] = set()
    at = 0
    while at < len(data):
        if data.startswith(mcap.MAGIC, at):
            at += len(mcap.MAGIC)
            if data[at : at + 1] == b"\1":  # another file begins, whose channels are its own
                channels = set()
            continue
        if at + 9 > len(data):
            break
        opcode, length = struct.unpack_from("<BQ", data, at)
        content = data[at + 9 : at + 9 + length]
        if opcode == 0 or len(content) != length:
            break
        if opcode == mcap.CHUNK:
            with suppress(Exception):  # a chunk that does not hold is not read
                _mcap_record_run(_chunk_records(content), channels, found)
        else:
            _mcap_record(opcode, content, channels, found)
        at += 9 + length
    return found


def _mcap_record_run(data: bytes, channels: set[int], found: Messages) -> None:
    at = 0
    while at + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, at)
        content = data[at + 9 : at + 9 + length]
        if opcode == 0 or len(content) != length:
            break
        _mcap_record(opcode, content, channels, found)
        at += 9 + length


def _mcap_record(opcode: int, content: bytes, channels: set[int], found: Messages) -> None:
    if opcode == mcap.CHANNEL and len(content) >= 8:
        first = struct.unpack_from("<I", content, 4)[0]
        if 12 + first <= len(content):
            second = struct.unpack_from("<I", content, 8 + first)[0]
            if 12 + first + second <= len(content):
                channels.add(struct.unpack_from("<H", content)[0])
    elif opcode == mcap.MESSAGE and len(content) >= 22:
        channel, _, time_ns = struct.unpack_from("<HIQ", content)
        if channel in channels and time_ns <= _LAST_TIME:
            found[identity(time_ns, content[22:])] += 1


def _chunk_records(content: bytes) -> bytes:
    size, name_size = struct.unpack_from("<16xQ4xI", content)
    packed = content[40 + name_size :]
    (packed_size,) = struct.unpack_from("<Q", content, 32 + name_size)
    if packed_size != len(packed):
        raise ValueError("another size")
    # Whatever its checksum: each record in it counts that holds.
    return mcap.unpacked(packed, content[32 : 32 + name_size], size)


def rosbag1_messages(data: bytes) -> Messages:
    """Return the messages of a ROS 1 bag, of connections that are defined anywhere."""
    connections: set[int] = set()
    messages: list[tuple[int, Identity]] = []

    def walk(data: bytes, at: int, top: bool) -> None:
        while at < len(data):
            held = rosbag1.record(data, at)
            if held is None:
                return
            node, at = held
            fields = dict(node.fields)
            op, number, time = fields.get(b"op"), fields.get(b"conn", b""), fields.get(b"time", b"")
            if op == b"\7" and len(number) == 4:
                connections.add(int.from_bytes(number, "little"))
            elif op == b"\5" and top:
                with suppress(Exception):
                    records = rosbag1.unpacked(node.content, fields.get(b"compression", b""))
                    if fields.get(b"size") == rosbag1.u32(len(records)):
                        walk(records, 0, False)
            elif op == b"\2" and len(number) == 4 and len(time) == 8:
                seconds, nanoseconds = struct.unpack("<II", time)
                key = identity(seconds * 10**9 + nanoseconds, node.content)
                messages.append((int.from_bytes(number, "little"), key))
            elif op is None:
                return

    walk(data, len(rosbag1.MAGIC), True)
    return Messages(key for connection, key in messages if connection in connections)


def sqlite_messages(path: Path) -> Messages:
    """Return the rows of rosbag2's table that SQLite gives in the order of their ids, of ids that come once."""
    found: dict[int, Identity] = {}
    seen: set[object] = set()
    doubtful: set[object] = set()
    with (
        suppress(*_SQLITE_ERRORS),
        closing(sqlite3.connect(f"file:{quote(str(path))}", uri=True)) as database,
    ):
        database.text_factory = bytes
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _MOST_BYTES)
        database.set_progress_handler(lambda: 1, 10**8)
        tables = {name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        if {b"messages", b"topics"} <= tables:
            topics = {i for i, *texts in database.execute("SELECT id, name, type FROM topics") if None not in texts}
            with suppress(*_SQLITE_ERRORS):
                for row, topic, time_ns, data in database.execute("SELECT id, topic_id, timestamp, data FROM messages"):
                    doubtful |= {row} & seen  # ids are unique: which of the two holds cannot be told
                    seen.add(row)
                    whole = isinstance(time_ns, int) and isinstance(data, bytes) and isinstance(row, int)
                    if whole and topic in topics and 0 <= time_ns <= _LAST_TIME:
                        found.setdefault(row, identity(time_ns, data))
    return Messages(key for row, key in found.items() if row not in doubtful)


def unpacked_identity(time_ns: int, data: bytes | memoryview) -> Identity:
    """Return the identity of a message that may be compressed by itself."""
    if bytes(data[:4]) == b"\x28\xb5\x2f\xfd":
        with suppress(ValueError):
            return identity(time_ns, decompressed(bytes(data), _MOST_BYTES))
    return identity(time_ns, data)
