# SPDX-License-Identifier: Apache-2.0
"""Messages of rosbag2's SQLite storage (.db3), whole or cut."""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

from rosbags.typesys.msg import normalize_msgtype

from imgu_ros.bags.storage import (
    DEFAULT_LIMITS,
    MAX_TIME_NS,
    Channel,
    RawMessage,
    Warnings,
    seconds,
    serialization_named,
)
from imgu_ros.bags.text import text_of
from imgu_ros.errors import BagError
from imgu_ros.params import LimitsParameters

_BY_TIME, _BY_ID = "timestamp, id", "id"
#: Rows of a damaged file that may come again, beyond as many as came once, before reading stops.
_MANY_REPEATED = 100


class SqliteStorage:
    """A SQLite file of rosbag2, of any of its schema versions.

    Parameters
    ----------
    path : the file
    name : what warnings call it
    warnings : takes what is damaged, now and while reading
    limits : `message_mb` bounds a message

    Raises
    ------
    BagError
        If the file cannot be opened, is no SQLite file, or has not rosbag2's tables.
    """

    def __init__(self, path: Path, name: str, warnings: Warnings, limits: LimitsParameters = DEFAULT_LIMITS) -> None:
        self._path, self._name, self._warnings = path, name, warnings
        self._database = _connected(path, limits)
        try:
            self._by_id = self._channels()
            self._order = self._order_of_rows()
            self._totals, self.start_ns, self.end_ns = self._summary()
        except sqlite3.DatabaseError as error:
            self.close()
            raise BagError(f"{path}: {error}; need a readable rosbag2 SQLite file") from None
        except BaseException:
            self.close()
            raise

    @property
    def counts(self) -> dict[Channel, int]:
        """Messages of each channel."""
        totals = dict.fromkeys(self._by_id.values(), 0)
        for identity, count in self._totals.items():
            if identity in self._by_id:
                totals[self._by_id[identity]] += count
        return totals

    def messages(self, topics: Collection[str] | None) -> Iterator[RawMessage]:
        """Yield the messages of `topics` (None: all) in time order."""
        wanted = {i: channel for i, channel in self._by_id.items() if topics is None or channel.topic in topics}
        for row, identity, time_ns in self._rows():
            channel = wanted.get(identity)
            if channel is None:
                continue
            data = self._data(row, time_ns)
            if data is not None:
                yield RawMessage(channel, time_ns, data)

    def close(self) -> None:
        """Close the database."""
        self._database.close()

    def _channels(self) -> dict[int, Channel]:
        query = "SELECT name FROM sqlite_master WHERE type = 'table'"
        tables = {_text(name) for (name,) in self._database.execute(query)}
        missing = {"topics", "messages"} - tables
        if missing:
            raise BagError(f"{self._path}: no table {sorted(missing)[0]!r}; need rosbag2's tables topics and messages")
        schemas = self._schemas() if "message_definitions" in tables else {}
        channels: dict[int, Channel] = {}
        # All columns: older files lack the last ones, and SQLite takes a column that is not there for a text.
        cursor = self._database.execute("SELECT * FROM topics ORDER BY id")
        for row in _rows_by_name(cursor):
            type_name = _text(row.get("type"))
            given = row.get("type_description_hash")
            form, text = schemas.get((type_name, _text(given)), schemas.get((type_name, ""), ("", "")))
            normal = normalize_msgtype(type_name) if "/" in type_name else type_name
            encoding = serialization_named(_text(row.get("serialization_format")))
            channels[row["id"]] = Channel(_text(row.get("name")), normal, encoding, form.lower(), text)
        return channels

    def _schemas(self) -> dict[tuple[str, str], tuple[str, str]]:
        """Return format and text of the definitions by type and by the type's hash; without a hash, the first counts.

        Types of two packages' versions have one name; whatever is wrong with this table, the messages are there.
        """
        schemas: dict[tuple[str, str], tuple[str, str]] = {}
        try:
            cursor = self._database.execute("SELECT * FROM message_definitions ORDER BY id")
            for row in _rows_by_name(cursor):
                definition = _text(row.get("encoding")), _text(row.get("encoded_message_definition"))
                for given in (_text(row.get("type_description_hash")), ""):
                    schemas.setdefault((_text(row.get("topic_type")), given), definition)
        except sqlite3.DatabaseError as error:
            self._warnings.add(f"{self._name}: its message definitions cannot be read ({error}); those of ROS 2 serve")
        return schemas

    def _summary(self) -> tuple[dict[int, int], int, int]:
        """Return the messages by topic's id, and the first and last time."""
        totals: dict[int, int] = {}
        first, last = MAX_TIME_NS, 0
        for _, identity, time_ns in self._rows():
            totals[identity] = totals.get(identity, 0) + 1
            first, last = min(first, time_ns), max(last, time_ns)
        return totals, first if totals else 0, last

    def _order_of_rows(self) -> str:
        """Return how rows are sorted: by time, or, in a cut file whose index is incomplete, as they were recorded."""
        try:
            for _ in self._database.execute(f"SELECT id, topic_id, timestamp FROM messages ORDER BY {_BY_TIME}"):
                pass
            return _BY_TIME
        except sqlite3.DatabaseError:
            return _BY_ID

    def _rows(self) -> Iterator[tuple[int, int, int]]:
        """Yield (row id, topic id, time) in order.

        Sorting takes these three alone: sorting whole messages would make SQLite copy the bag into temporary files.
        A cut file gives its rows until the first page that is missing. A damaged one may give rows again, without an
        end: each counts once.
        """
        by_time = self._order != _BY_ID
        last = (-1, -(2**63))
        given = repeated = 0
        cursor = self._database.cursor()
        try:
            cursor.execute(f"SELECT id, topic_id, timestamp FROM messages ORDER BY {self._order}")
            for row, identity, time_ns in cursor:  # not fetchmany: it loses the rows before a missing page
                if type(identity) is not int or type(time_ns) is not int or not 0 <= time_ns <= MAX_TIME_NS:
                    continue
                place = (time_ns if by_time else 0, row)
                if place > last:
                    last = place
                    given += 1
                    yield row, identity, time_ns
                    continue
                repeated += 1
                if repeated > given + _MANY_REPEATED:
                    raise sqlite3.DatabaseError("rows come again and again")
        except sqlite3.DatabaseError as error:
            self._warnings.add(f"{self._name}: cut short or damaged ({error}): what could be read was read")
        finally:
            cursor.close()

    def _data(self, row: int, time_ns: int) -> bytes | None:
        """Return a message's bytes; None, and a warning, when they cannot be read."""
        try:
            found = self._database.execute("SELECT data FROM messages WHERE id = ?", (row,)).fetchone()
            if found is None or not isinstance(found[0], bytes):
                raise sqlite3.DatabaseError("its data are missing")
            data: bytes = found[0]
            return data
        except (sqlite3.DatabaseError, MemoryError, OverflowError) as error:
            self._warnings.add(
                f"{self._name}: the message at {seconds(time_ns)} cannot be read and is skipped: {error}",
                kind=f"{self._name}: unreadable messages",
            )
            return None


def _connected(path: Path, limits: LimitsParameters) -> sqlite3.Connection:
    # `immutable` reads from read-only media too, but knows nothing of a write-ahead log that a recorder left behind.
    log = path.with_name(path.name + "-wal")
    mode = "mode=ro" if log.exists() and log.stat().st_size else "immutable=1"
    try:
        database = sqlite3.connect(f"file:{quote(str(path.absolute()))}?{mode}", uri=True, check_same_thread=False)
    except sqlite3.Error as error:
        raise BagError(f"{path}: {error}; need a readable SQLite file") from None
    try:
        database.text_factory = bytes  # damaged text must not raise
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, min(1_000_000 * limits.message_mb, 2**31 - 1))
        # Lets SQLite open a file that has fewer pages than its header says.
        database.execute("PRAGMA writable_schema = ON")
        return database
    except sqlite3.Error as error:
        database.close()
        raise BagError(f"{path}: {error}; need a readable SQLite file") from None


def _rows_by_name(cursor: sqlite3.Cursor) -> Iterator[dict[str, Any]]:
    names = [str(column[0]) for column in cursor.description]
    for row in cursor:
        yield dict(zip(names, row, strict=True))


def _text(value: object) -> str:
    if value is None:
        return ""
    return text_of(value) if isinstance(value, bytes) else str(value)
