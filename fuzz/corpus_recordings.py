# SPDX-License-Identifier: Apache-2.0
"""Named recordings."""

from __future__ import annotations

import os
import shutil
import sqlite3
import struct
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

from fuzz import mcap, rosbag1, sqlite, texts
from fuzz.corpus_entry import Entry, file_of
from fuzz.kinds import RECORDING
from fuzz.mcap import (
    CHANNEL,
    CHUNK,
    FOOTER,
    MAGIC,
    MESSAGE,
    SCHEMA,
    Layout,
    Node,
    joined,
    mcap_file,
    parsed,
    seeds,
    string,
)
from fuzz.messages import Recorded, recorded
from fuzz.zstd import compressed, repeated

_BOMB = 3 * 2**30
_ALL = 18


def _edited(edit: Callable[[list[Node]], None], seed: int = 0) -> Callable[[Path], Path]:
    """Return a builder of a seed that `edit` changed."""

    def content() -> bytes:
        nodes = parsed(seeds()[seed])
        edit(nodes)
        return joined(nodes)

    return file_of("bag.mcap", content)


def _chunks(nodes: list[Node]) -> list[Node]:
    return [node for node in nodes if node.inside is not None]


def _bomb_chunk(nodes: list[Node]) -> None:
    chunk = _chunks(nodes)[1]
    head = struct.pack("<QQQI", *chunk.times, _BOMB, 0) + string(b"zstd") + struct.pack("<Q", len(repeated(_BOMB)))
    nodes.insert(nodes.index(chunk), Node(CHUNK, head + repeated(_BOMB)))


def _message(data: bytes, channel: int = 4, time_ns: int = 10**11) -> Node:
    return Node(MESSAGE, struct.pack("<HIQQ", channel, 0, time_ns, time_ns) + data)


def _overlapping(nodes: list[Node], count: int = 12, size: int = 100_000_000) -> None:
    """Many chunks of one time, each legal by itself, that are all open together."""
    records = joined([_message(bytes(size - 31))])
    packed = compressed(records)
    head = struct.pack("<QQQI", 10**11, 2 * 10**11, len(records), 0) + string(b"zstd") + struct.pack("<Q", len(packed))
    at = nodes.index(_chunks(nodes)[1])
    nodes[at:at] = [Node(CHUNK, head + packed)] * count


def _schema_of(text: str) -> Callable[[Path], Path]:
    """Return a builder of a file whose /text has another definition."""
    return _holding(lambda: _with_texts(definition=text))


def _holding(messages: Callable[[], tuple[Recorded, ...]]) -> Callable[[Path], Path]:
    """Return a builder of a file of these messages."""
    return file_of("bag.mcap", lambda: mcap_file(Layout(messages=messages())))


def _with_texts(**fields: Any) -> tuple[Recorded, ...]:
    return tuple(replace(m, **fields) if m.topic == "/text" else m for m in recorded(3))


def _with_a_bomb() -> tuple[Recorded, ...]:
    return (*recorded(3), replace(recorded(1)[3], data=repeated(_BOMB)))


def _frame_id(data: bytes, text: bytes) -> bytes:
    """Return a message of an Image with another frame_id, padded so that what follows stays aligned."""
    old = b"\x07\0\0\0camera\0\0"
    size = len(text) + 1
    return data.replace(old, struct.pack("<I", size) + text + bytes(1 + (-size) % 4), 1)


def _frame_ids(text: bytes) -> Callable[[Path], Path]:
    return _holding(lambda: tuple(replace(m, data=_frame_id(m.data, text)) for m in recorded(3)))


def _tiny_gaps(count: int = 18_000) -> bytes:
    """Small chunks with junk between that looks as if records began in it: every search must stay local."""
    junk = b"\x06\x40\0\0\0\0\0\0\0" * 6 + b"\x05\x30\0\0\0\0\0\0\0" * 2
    chunk = Node(CHUNK, inside=[_message(recorded(1)[3].data)], times=(10**11, 10**11)).data()
    return seeds()[0][:-40] + (junk + chunk) * count


def _one_long_gap(size: int = 40_000_000) -> bytes:
    """Nothing but beginnings of records that do not hold, each claiming all that follows."""
    return (
        seeds()[0][:-40] + b"".join(struct.pack("<BQ", 6, size - i)[:9] for i in range(0, size // 8, 9)) + bytes(1000)
    )


def _candidate_before(nodes: list[Node]) -> None:
    """Junk that begins like a chunk and claims to reach beyond the beginning of a whole one."""
    chunk = _chunks(nodes)[1]
    size = 9 + 40 + 200
    fake = struct.pack("<BQQQQI", CHUNK, size - 9, 0, 1, 200, 0) + string(b"") + struct.pack("<Q", 200)
    nodes.insert(nodes.index(chunk), Node(-1, b"\0" * 20 + fake + b"\0" * 11))


def _footer_inside(nodes: list[Node]) -> None:
    nodes.insert(nodes.index(_chunks(nodes)[1]), Node(FOOTER, struct.pack("<QQI", 0, 0, 0)))


def _changed_opcode(nodes: list[Node]) -> None:
    nodes[[node.opcode for node in nodes].index(7)].opcode = FOOTER


def _late_message(nodes: list[Node]) -> None:
    chunk = _chunks(nodes)[1]
    (chunk.inside or []).insert(0, _message(b"", time_ns=2**64 - 1))


def _without_statistics(nodes: list[Node]) -> None:
    nodes[:] = [node for node in nodes if node.opcode != 11]


def _nested(nodes: list[Node]) -> None:
    inner = _chunks(nodes)[0]
    for _ in range(60):
        inner = Node(CHUNK, inside=[inner], times=inner.times, compression=b"zstd")
    nodes.append(inner)


def _sql(script: str, seed: int = 0) -> Callable[[Path], Path]:
    def content() -> bytes:
        with closing(sqlite3.connect(":memory:")) as database:
            database.deserialize(sqlite.seeds()[seed])
            database.executescript(script)
            database.commit()
            return database.serialize()

    return file_of("bag.db3", content)


_AGAIN = "DROP TABLE messages; CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "


def _wal(folder: Path) -> Path:
    for end, data in sqlite.wal_seed().items():
        (folder / f"bag.db3{end}").write_bytes(data)
    return folder / "bag.db3"


def _wal_read_only(folder: Path) -> Path:
    path = _wal(folder)
    for file in folder.iterdir():
        file.chmod(0o444)
    folder.chmod(0o555)
    return path


def _all_in_the_log(folder: Path) -> Path:
    """A file of one page, and all messages in the log of a recorder that was killed."""
    path, work = folder / "bag.db3", folder / "work"
    work.mkdir()
    with closing(sqlite3.connect(work / path.name)) as database:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("PRAGMA wal_autocheckpoint = 0")
        with closing(sqlite3.connect(":memory:")) as seed:
            seed.deserialize(sqlite.seeds()[0])
            database.executescript("\n".join(seed.iterdump()))
        for end in ("", sqlite.WAL):
            path.with_name(path.name + end).write_bytes((work / f"{path.name}{end}").read_bytes())
    shutil.rmtree(work)
    return path


def _announcing_little(nodes: list[Node]) -> None:
    """Chunks that announce 100 bytes, and hold 8 MB in 300."""
    packed = repeated(2**23)
    head = struct.pack("<QQQI", 1, 2, 100, 0) + string(b"zstd") + struct.pack("<Q", len(packed))
    at = nodes.index(_chunks(nodes)[1])
    nodes[at:at] = [Node(CHUNK, head + packed)] * 400


def _endless_files() -> bytes:
    channel = Node(CHANNEL, struct.pack("<HH", 1, 1) + string(b"") * 2 + bytes(4))
    return seeds()[0] + joined([Node(-1, MAGIC), Node(1), channel]) * 20_000


def _definitions_of_files() -> bytes:
    """Files of 4 KB, each with a chunk of 60 MB of definitions."""
    files = []
    for number in range(30):
        texts_of_chunk = [bytes([65 + number]) * 3_900_000 for _ in range(16)]
        schemas = [
            Node(
                SCHEMA,
                struct.pack("<H", i + 1) + string(b"a/msg/B") + string(b"ros2msg") + string(bytes([48 + i]) + text),
            )
            for i, text in enumerate(texts_of_chunk)
        ]
        channel = Node(CHANNEL, struct.pack("<HH", 1, 1) + string(b"/t") + string(b"cdr") + bytes(4))
        files += [Node(-1, MAGIC), Node(1), channel, Node(CHUNK, inside=schemas, compression=b"zstd")]
    return seeds()[0] + joined(files)


def _folder(metadata: bytes | None = None, **files: bytes) -> Callable[[Path], Path]:
    def build(folder: Path) -> Path:
        given = files or {"bag_0.mcap": seeds()[0]}
        for name, data in given.items():
            (folder / name.replace("__", ".")).write_bytes(data)
        text = texts.metadata([name.replace("__", ".") for name in given], "mcap") if metadata is None else metadata
        (folder / "metadata.yaml").write_bytes(text)
        return folder

    return build


def _folder_with(make_metadata: Callable[[Path], object]) -> Callable[[Path], Path]:
    def build(folder: Path) -> Path:
        (folder / "bag_0.mcap").write_bytes(seeds()[0])
        make_metadata(folder / "metadata.yaml")
        return folder

    return build


def _metadata(old: bytes, new: bytes) -> bytes:
    return texts.metadata(["bag_0.mcap"], "mcap").replace(old, new)


def _count_of(digits: int) -> bytes:
    return _metadata(b"message_count: 18", b"message_count: " + b"9" * digits)


def _loop(folder: Path) -> Path:
    path = folder / "bag.mcap"
    path.symlink_to(path)
    return path


def _loop_inside(folder: Path) -> Path:
    (folder / "bag_0.mcap").write_bytes(seeds()[0])
    (folder / "bag_1.mcap").symlink_to(folder / "bag_1.mcap")
    (folder / "up").symlink_to(folder)
    return folder


def _fifo(folder: Path) -> Path:
    os.mkfifo(folder / "bag.mcap")
    return folder / "bag.mcap"


def _odd_name(folder: Path) -> Path:
    path = Path(str(folder) + "/\udcff\x1b[31m\udce4.mcap")
    path.write_bytes(seeds()[0][:5000])
    return path


def _rosbag1_bomb() -> bytes:
    nodes = rosbag1.parsed(rosbag1.seeds()[2])
    chunk = next(node for node in nodes if node.inside is not None)
    (chunk.inside or []).append(rosbag1.Node([(b"op", b"\2")], bytes(240_000_000)))
    return rosbag1.joined(nodes)


def _rosbag1_stray() -> bytes:
    """One message in a chunk is of a connection that nothing defines."""
    nodes = rosbag1.parsed(rosbag1.seeds()[0])
    message = next(node for chunk in nodes for node in chunk.inside or [] if dict(node.fields).get(b"op") == b"\2")
    message.fields = [(k, rosbag1.u32(77) if k == b"conn" else v) for k, v in message.fields]
    return rosbag1.joined(nodes)


def _rosbag1_twice() -> bytes:
    return rosbag1.seeds()[0] + rosbag1.seeds()[1][len(rosbag1.MAGIC) :]


def _zstd(content: Callable[[], bytes], name: str = "bag.mcap.zstd") -> Entry:
    return Entry(RECORDING, file_of(name, content))


def _mcap(build: Callable[[Path], Path], messages: int = 0, says: str = "", deep: bool = False) -> Entry:
    return Entry(RECORDING, build, messages=messages, says=says, is_read=True if messages else None, deep=deep)


_NEXT = "=" * 80 + "\n"
_DEEP = "".join(f"{_NEXT}MSG: my/T{i}\nmy/T{i + 1} a\nmy/T{i + 1} b\n" for i in range(40))
_FILES = b"  x0: &b0 [a, a]\n" + b"".join(
    b"  x%d: &b%d [%s]\n" % (i, i, b", ".join([b"*b%d" % (i - 1)] * 10)) for i in range(1, 10)
)
_GENERATED_BLOBS = f"{_AGAIN} n INTEGER, data BLOB AS (zeroblob(n)));" + (
    "INSERT INTO messages(topic_id, timestamp, n) VALUES(1, 5, 900000000);" * 20
)
_GENERATED_TIMES = f"{_AGAIN} data BLOB, t AS (hex(zeroblob(100000000))));" + (
    "INSERT INTO messages(topic_id, timestamp, data) VALUES(1, 5, x'00')"
)
_LONG_NAME = "UPDATE topics SET name = printf('%.*c', 100000000, 'x') WHERE id = 4"
_ENDLESS_VIEW = (
    "ALTER TABLE messages RENAME TO m; CREATE VIEW messages AS WITH RECURSIVE c(id) AS (SELECT 1 UNION ALL "
    "SELECT id + 1 FROM c) SELECT id, 1 AS topic_id, id AS timestamp, x'00' AS data FROM c"
)
_FIELDS = "".join(f"uint8 a{i}\n" for i in range(150_000))
_ESCAPES = "\x1b[31m\x07\x9b5n"

ENTRIES: dict[str, Entry] = {
    "zstd_file_of_3_gb": _zstd(lambda: seeds_zstd() + repeated(_BOMB)),
    "zstd_file_of_zeros": _zstd(lambda: repeated(_BOMB)),
    "zstd_database_of_3_gb": _zstd(lambda: compressed(sqlite.seeds()[0]) + repeated(_BOMB), "bag.db3.zstd"),
    "zstd_chunk_of_3_gb": _mcap(_edited(_bomb_chunk, 2), _ALL),
    "zstd_message_of_3_gb": _mcap(_holding(_with_a_bomb), _ALL),
    "zstd_row_of_3_gb": _mcap(_sql(f"INSERT INTO messages VALUES(99, 4, 5, x'{repeated(_BOMB).hex()}')"), _ALL),
    "chunks_that_overlap": _mcap(_edited(_overlapping), _ALL),
    "chunks_that_announce_little": _mcap(_edited(_announcing_little), _ALL),
    "endless_files_in_one": _mcap(file_of("bag.mcap", _endless_files), _ALL, "5000 files follow one another"),
    "definitions_of_files_in_one": _mcap(file_of("bag.mcap", _definitions_of_files), _ALL),
    "chunk_in_a_chunk": _mcap(_edited(_nested), _ALL),
    "schema_array_of_100_million": _mcap(_schema_of("uint8[100000000] data"), _ALL),
    "schema_arrays_of_arrays": _mcap(_schema_of(f"my/A[100000] a\n{_NEXT}MSG: my/A\nfloat64[100000] b"), _ALL),
    "schema_of_150000_fields": _mcap(_schema_of(_FIELDS), _ALL),
    "schema_of_itself": _mcap(_schema_of("std_msgs/String s"), _ALL),
    "schema_deep": _mcap(_schema_of("my/T0 a\n" + _DEEP), _ALL),
    "gaps_between_chunks": _mcap(file_of("bag.mcap", _tiny_gaps), _ALL),
    "one_long_gap": _mcap(file_of("bag.mcap", _one_long_gap), _ALL),
    "behind_a_footer": _mcap(_edited(_footer_inside), _ALL, "footer"),
    "concatenated": _mcap(file_of("bag.mcap", lambda: seeds()[0] + seeds()[2]), 2 * _ALL),
    "concatenated_without_magic": _mcap(file_of("bag.mcap", lambda: seeds()[3] + seeds()[0][len(MAGIC) :]), 2 * _ALL),
    "changed_opcode": _mcap(_edited(_changed_opcode), _ALL),
    "candidate_that_overlaps_a_chunk": _mcap(_edited(_candidate_before), _ALL),
    "message_beyond_all_time": _mcap(_edited(_late_message), _ALL),
    "topic_with_escapes": _mcap(_holding(lambda: _with_texts(topic=f"/{_ESCAPES}")), _ALL),
    "type_with_escapes": _mcap(_holding(lambda: _with_texts(type_name=f"a/msg/{_ESCAPES}")), _ALL),
    "type_of_a_megabyte": _mcap(_holding(lambda: _with_texts(type_name="a/msg/" + "b" * 10**6)), _ALL),
    "frame_id_of_a_megabyte": _mcap(_frame_ids(b"x" * 10**6), _ALL, deep=True),
    "frame_id_with_escapes": _mcap(_frame_ids(_ESCAPES.encode()), _ALL, deep=True),
    "frame_id_a_spreadsheet_runs": _mcap(_frame_ids(b'=HYPERLINK("http://x","y")'), _ALL, deep=True),
    "frame_id_not_utf8": _mcap(_frame_ids(b"\xff\xfe\x80"), _ALL, deep=True),
    "database_shorter_than_its_header": _mcap(file_of("bag.db3", lambda: sqlite.seeds()[0][:-4096]), 1, "short"),
    "database_of_generated_blobs": _mcap(_sql(_GENERATED_BLOBS)),
    "database_of_an_endless_view": _mcap(_sql(_ENDLESS_VIEW)),
    "database_of_generated_times": _mcap(_sql(_GENERATED_TIMES)),
    "database_name_of_100_mb": _mcap(_sql(_LONG_NAME), 9, "limits.text_mb"),
    "database_all_in_its_log": _mcap(_all_in_the_log, _ALL),
    "database_with_a_log": _mcap(_wal, 2 * _ALL),
    "database_with_a_log_read_only": _mcap(_wal_read_only, 2 * _ALL),
    "metadata_aliases": _mcap(_folder(texts.bomb(12, 10)), _ALL),
    "metadata_aliases_of_files": _mcap(_folder(_metadata(b"  files:", _FILES + b"  files: *b9\n  more:")), _ALL),
    "metadata_400_digits": _mcap(_folder(_count_of(400)), _ALL, "(400 characters)"),
    "metadata_5000_digits": _mcap(_folder(_count_of(5000)), _ALL, "(5000 characters)"),
    "metadata_infinite_count": _mcap(_folder(_metadata(b"message_count: 18", b"message_count: .inf")), _ALL),
    "metadata_overflowing_count": _mcap(_folder(_metadata(b"message_count: 18", b"message_count: 1e400")), _ALL),
    "metadata_deep": _mcap(_folder(b"a: " + b"[" * 500_000), _ALL),
    "metadata_large": _mcap(_folder(b"a: 1\n" * 5_000_000), _ALL),
    "metadata_fifo": _mcap(_folder_with(os.mkfifo), _ALL),
    "metadata_device": _mcap(_folder_with(lambda path: path.symlink_to("/dev/zero")), _ALL),
    "metadata_loop": _mcap(_folder_with(lambda path: path.symlink_to(path)), _ALL),
    "metadata_folder": _mcap(_folder_with(lambda path: path.mkdir()), _ALL),
    "metadata_file_elsewhere": _mcap(_folder(_metadata(b"    - bag_0.mcap", b"    - ../../../../../../dev/zero")), 0),
    "bag_loop": _mcap(_loop),
    "bag_loop_in_a_folder": _mcap(_loop_inside, _ALL),
    "bag_fifo": _mcap(_fifo),
    "bag_name_not_utf8": _mcap(_odd_name, 1),
    "bag_without_statistics": _mcap(_edited(_without_statistics), _ALL),
    "rosbag1_chunk_of_240_mb": _mcap(file_of("bag.bag", _rosbag1_bomb), 10),
    "rosbag1_message_of_no_connection": _mcap(file_of("bag.bag", _rosbag1_stray), 14, "definitions of 1 channels"),
    "rosbag1_concatenated": _mcap(file_of("bag.bag", _rosbag1_twice), 15),
}  # fmt: skip


def seeds_zstd() -> bytes:
    """Return a whole file, compressed."""
    return compressed(mcap.seeds()[0])
