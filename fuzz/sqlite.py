# SPDX-License-Identifier: Apache-2.0
"""rosbag2's SQLite files: seeds, mutations by SQL, and mutations of pages (sqlite.org/fileformat2.html)."""

from __future__ import annotations

import sqlite3
from contextlib import closing, suppress
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from fuzz.messages import recorded
from fuzz.mutation import Case, Rng, chance, choice, mangled, number, overwritten, text
from fuzz.zstd import compressed

_SCHEMA = """
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL,
 offered_qos_profiles TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
 encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
 data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
"""
WAL = "-wal"


def _filled(database: sqlite3.Connection, packed: bool, page_size: int) -> None:
    database.execute(f"PRAGMA page_size = {page_size}")
    database.executescript(_SCHEMA)
    messages = recorded(3)
    topics = {m.topic: m for m in messages}
    ids = {topic: i for i, topic in enumerate(topics, 1)}
    for topic, m in topics.items():
        database.execute("INSERT INTO topics VALUES(?, ?, ?, 'cdr', '', 'h')", (ids[topic], topic, m.type_name))
        database.execute(
            "INSERT INTO message_definitions VALUES(NULL, ?, 'ros2msg', ?, 'h')", (m.type_name, m.definition)
        )
    for m in messages:
        data = compressed(m.data) if packed else m.data
        database.execute("INSERT INTO messages VALUES(NULL, ?, ?, ?)", (ids[m.topic], m.time_ns, data))
    database.commit()


@cache
def seeds() -> tuple[bytes, ...]:
    """Return whole files."""
    return tuple(_file(packed, size) for packed, size in ((False, 4096), (True, 4096), (False, 512)))


def _file(packed: bool, page_size: int) -> bytes:
    with closing(sqlite3.connect(":memory:")) as database:
        _filled(database, packed, page_size)
        return database.serialize()


@cache
def wal_seed() -> dict[str, bytes]:
    """Return a file whose last messages are in its write-ahead log, by the ends of their names."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "bag.db3"
        with closing(sqlite3.connect(path)) as database:
            database.execute("PRAGMA journal_mode = WAL")
            _filled(database, False, 4096)
            database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            database.execute("INSERT INTO messages SELECT NULL, topic_id, timestamp + 1, data FROM messages")
            database.commit()
            return {"": path.read_bytes(), WAL: Path(f"{path}{WAL}").read_bytes()}


def mutate(rng: Rng, data: bytes) -> bytes:
    """Return a file with one mutation more."""
    roll = rng.random()
    if roll < 0.15 or not data:
        return mangled(rng, data)
    if roll < 0.55:
        # A message of SQLite may quote bytes that are no text.
        with suppress(sqlite3.Error, OverflowError, UnicodeDecodeError):
            return _by_sql(rng, data)
    return _page_mutated(rng, data)


def mutate_wal(rng: Rng, case: Case) -> Case:
    """Return a file and its write-ahead log with one mutation more."""
    name = choice(rng, list(case))
    if name.endswith(WAL):
        changed = mangled(rng, case[name])
        if chance(rng, 0.3):  # of the log's header and of a frame's
            at = choice(rng, (8, 12, 16, 20, 32, 36, 40))
            changed = overwritten(case[name], at, number(rng, 0, 32).to_bytes(4, "big"))
        return {**case, name: changed}
    return {**case, name: mutate(rng, case[name])}


def _page_mutated(rng: Rng, data: bytes) -> bytes:
    size = int.from_bytes(data[16:18], "big") or 4096
    size = size if size in (512, 1024, 4096) else 4096
    pages = [data[at : at + size] for at in range(0, len(data), size)]
    i, j = int(rng.integers(len(pages))), int(rng.integers(len(pages)))
    base = 100 if i == 0 else 0
    roll = int(rng.integers(10))
    if roll == 0:  # the file's header
        at, width = choice(
            rng, ((16, 2), (18, 1), (19, 1), (20, 1), (21, 1), (28, 4), (32, 4), (36, 4), (44, 4), (52, 4), (56, 4))
        )
        old = int.from_bytes(data[at : at + width], "big")
        return overwritten(data, at, number(rng, old, 8 * width).to_bytes(width, "big"))
    if roll == 1:
        pages[i] = pages[j]
    elif roll == 2:
        pages[i] = bytes(size)
    elif roll == 3:
        del pages[max(1, i) :]
    elif roll == 4:
        pages.insert(i, pages[j])
    elif roll == 5:  # a page's header: kind, free block, cells, content, right child
        at, width = choice(rng, ((0, 1), (1, 2), (3, 2), (5, 2), (8, 4)))
        kinds = (2, 5, 10, 13, 0)
        old = int.from_bytes(pages[i][base + at : base + at + width], "big")
        new = choice(rng, kinds) if at == 0 else choice(rng, (number(rng, old, 8 * width), int(rng.integers(1, 20))))
        pages[i] = overwritten(pages[i], base + at, (new % 2 ** (8 * width)).to_bytes(width, "big"))
    elif roll == 6:  # a pointer to a cell
        at = base + choice(rng, (8, 12)) + 2 * int(rng.integers(8))
        pages[i] = overwritten(pages[i], at, int(rng.integers(size)).to_bytes(2, "big"))
    elif roll == 7:  # in a cell: lengths, row ids, types
        at = int.from_bytes(pages[i][base + 8 : base + 10], "big") + int(rng.integers(12))
        pages[i] = overwritten(pages[i], at, choice(rng, (rng.bytes(1), b"\xff" * 9, b"\x80", b"\x81\0", b"\0")))
    elif roll == 8:  # the next page of a long message
        pages[i] = overwritten(pages[i], 0, number(rng, i, 32).to_bytes(4, "big"))
    else:
        pages[i] = mangled(rng, pages[i])[:size].ljust(size, b"\0")
    return b"".join(pages)


_VALUES = (
    "NULL", "-1", "0", "9223372036854775807", "-9223372036854775808", "1e300", "'text'", "x''", "x'00'",
    "zeroblob(1000000)", "zeroblob(60000000)", "char(27) || '[31m'", "'/a' || char(0) || 'b'",
    "CAST(x'ff80' AS TEXT)", "printf('%.*c', 100000, 'x')", "'std_msgs/msg/String'", "'=1+1'", "randomblob(20)", "id",
    "1.5",
)  # fmt: skip
_COLUMNS = {
    "topics": ("id", "name", "type", "serialization_format", "type_description_hash"),
    "messages": ("id", "topic_id", "timestamp", "data"),
    "message_definitions": ("id", "topic_type", "encoding", "encoded_message_definition"),
    "metadata": ("id", "metadata_version", "metadata"),
}
_STATEMENTS = (
    "DROP TABLE {table}", "DROP INDEX timestamp_idx", "DELETE FROM {table}", "DELETE FROM {table} WHERE id % 3 = 1",
    "ALTER TABLE {table} RENAME TO gone", "ALTER TABLE {table} RENAME COLUMN {column} TO other",
    "ALTER TABLE {table} DROP COLUMN {column}",
    "ALTER TABLE {table} ADD COLUMN more GENERATED ALWAYS AS (zeroblob(500000000)) VIRTUAL",
    "CREATE VIEW v AS SELECT * FROM {table}",
    ("ALTER TABLE messages RENAME TO m2;"
    " CREATE VIEW messages AS SELECT id, topic_id, timestamp, zeroblob(300000000) AS data FROM m2"),
    ("ALTER TABLE messages RENAME TO m2;"
    " CREATE VIEW messages AS WITH RECURSIVE c(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM c)"
    " SELECT id, 1 AS topic_id, id AS timestamp, x'00' AS data FROM c"),
    ("DROP TABLE messages; CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER,"
    " n INTEGER, data BLOB GENERATED ALWAYS AS (zeroblob(n)) VIRTUAL);"
    " INSERT INTO messages(topic_id, timestamp, n) VALUES(1, 5, 900000000), (1, 6, 100)"),
    ("INSERT INTO messages WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c WHERE x < 20000)"
    " SELECT NULL, 1, x, x'00010000' FROM c"),
    "INSERT INTO topics SELECT id + 1000, name, type, serialization_format, '', 'h' FROM topics",
    "CREATE TABLE WITHOUT_ROWID(a PRIMARY KEY) WITHOUT ROWID", "PRAGMA user_version = 5",
    ("DROP TABLE messages; CREATE TABLE messages(id TEXT, topic_id TEXT, timestamp TEXT, data TEXT);"
    " INSERT INTO messages VALUES('a', '1', '7', 'text')"),
    "PRAGMA writable_schema = ON; UPDATE sqlite_master SET sql = replace(sql, 'BLOB', 'TEXT') WHERE name = '{table}'",
    "PRAGMA writable_schema = ON; UPDATE sqlite_master SET rootpage = rootpage + 1 WHERE name = '{table}'",
    "PRAGMA writable_schema = ON; UPDATE sqlite_master SET sql = 'CREATE TABLE {table}(' WHERE name = '{table}'",
    "PRAGMA writable_schema = ON; UPDATE sqlite_master SET type = 'view' WHERE name = '{table}'",
)  # fmt: skip


def _by_sql(rng: Rng, data: bytes) -> bytes:
    with closing(sqlite3.connect(":memory:")) as database:
        database.deserialize(data)
        steps = 10**7
        database.set_progress_handler(lambda: 1, steps)  # no statement runs on without an end
        table = choice(rng, list(_COLUMNS) + ["messages", "topics"])
        column = choice(rng, _COLUMNS[table])
        if chance(rng, 0.55):
            value = choice(rng, _VALUES)
            where = "" if chance(rng, 0.3) else f" WHERE id % {choice(rng, (2, 3, 5))} = 1"
            if chance(rng, 0.1):
                word = text(rng, b"x")[:2000].hex()
                value = f"CAST(x'{word}' AS TEXT)"
            # Large blobs in one row alone: the case, not the fuzzer, is to be small.
            where = " WHERE id = 2" if "00000" in value else where
            database.execute(f"UPDATE OR IGNORE {table} SET {column} = {value}{where}")
        else:
            database.executescript(choice(rng, _STATEMENTS).format(table=table, column=column))
        database.commit()
        return database.serialize()
