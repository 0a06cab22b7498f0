# SPDX-License-Identifier: Apache-2.0
"""Read rosbag2's SQLite storage (.db3) by SQL; rows that a damaged file no longer leads to come from `salvage/`."""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from rosbags.typesys.msg import normalize_msgtype

from imgu_ros.bags.compression import TemporarySpace
from imgu_ros.bags.salvage.sqlite_pages import SqlitePages
from imgu_ros.bags.sqlite_file import SqliteFile, TableColumn
from imgu_ros.bags.storage import (
    MAX_TIME_NS,
    Channel,
    MessageBlock,
    RawMessage,
    WarningLog,
    seconds,
    serialization_named,
)
from imgu_ros.bags.text import text_of
from imgu_ros.config.parameters import DEFAULT_LIMITS, LimitsParameters
from imgu_ros.errors import BagError

#: Rows of the tables `topics` and `message_definitions`, and their texts together, in `limits.text_mb`.
_MOST_NAMED, _MOST_TEXT = 65_536, 16
_FIRST = -(2**63)
#: So often a damaged table is read from its first row for one to which it does not lead: each time may take as long.
_MOST_PASSES = 20


class SqliteStorage:
    """A SQLite file of rosbag2, of any of its schema versions.

    Parameters
    ----------
    path : the file
    name : what warnings call it
    warnings : takes what is damaged, now and while reading
    limits : `message_mb` bounds a message, `text_mb` a definition
    space : for a temporary copy, see `SqliteFile`

    Raises
    ------
    BagError
        If the file cannot be opened, is no SQLite file, or has not rosbag2's tables.
    """

    def __init__(
        self,
        path: Path,
        name: str,
        warnings: WarningLog,
        limits: LimitsParameters = DEFAULT_LIMITS,
        space: TemporarySpace | None = None,
    ) -> None:
        self._path, self._name, self._warnings, self._limits = path, name, warnings, limits
        self._is_sorted = self._is_damaged = self._is_walked = False
        self._pages: SqlitePages | None = None
        self._passes = 0
        self._file = SqliteFile(path, name, warnings, limits, space)
        try:
            tables = self._file.tables("topics", "messages", "message_definitions")
            self._key = self._key_of_messages(tables)
            self._data_query = f"SELECT data FROM messages WHERE {self._key} = ?"
            columns = (self._key, "topic_id", "timestamp")
            whole = " AND ".join(f"typeof({one}) = 'integer'" for one in columns)
            self._columns = ", ".join(f"CASE WHEN {whole} THEN {one} END" for one in columns)
            self._by_id = self._channels(tables)
            self._totals, self.start_ns, self.end_ns = self._summary()
        except sqlite3.DatabaseError as error:
            self.close()
            raise BagError(f"{path}: {self._file.fault(error)}; need a readable rosbag2 SQLite file") from None
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

    def parts(self, topics: Collection[str] | None) -> Iterator[MessageBlock]:
        """Yield one part: all messages of `topics` (None: all)."""
        yield MessageBlock(self.start_ns, partial(self.messages, topics))

    def messages(self, topics: Collection[str] | None) -> Iterator[RawMessage]:
        """Yield the messages of `topics` (None: all) in time order."""
        wanted = {i: channel for i, channel in self._by_id.items() if topics is None or channel.topic in topics}
        left = 2 * self._file.size
        is_walked = self._is_damaged and self._pages is not None
        for row, identity, time_ns in self._page_rows() if is_walked else self._rows():
            channel = wanted.get(identity)
            if channel is None:
                continue
            data = self._page_data(row, time_ns, "damaged") if is_walked else self._data(row, time_ns)
            if data is None:
                continue
            left -= len(data)
            if left < 0:
                self._warnings.add(f"{self._name}: its messages share their bytes: what comes after them is not read")
                return
            yield RawMessage(channel, time_ns, data)

    def close(self) -> None:
        """Close the database."""
        self._file.close()
        if self._pages is not None:
            self._pages.close()

    def _key_of_messages(self, tables: dict[str, tuple[TableColumn, ...]]) -> str:
        """Return by which column rows are found; check what the table is made of."""
        for missing in [name for name in ("topics", "messages") if name not in tables]:
            raise BagError(f"{self._path}: no table {missing!r}; need rosbag2's tables topics and messages")
        there = {column.name for column in tables["topics"]}
        for absent in [name for name in ("id", "name", "type") if name not in there]:
            raise BagError(f"{self._path}: topics has no column {absent!r}; need rosbag2's")
        columns = tables["messages"]
        names = [column.name for column in columns]
        # A number behind the data is read only after all of the data.
        if names[:4] != ["id", "topic_id", "timestamp", "data"]:
            raise BagError(f"{self._path}: messages has the columns {', '.join(names)[:80]}; need rosbag2's")
        if not all(column.is_stored for column in columns[:4]):
            raise BagError(f"{self._path}: messages has computed columns; need recorded messages")
        return "id" if columns[0].is_key else "rowid"

    def _channels(self, tables: dict[str, tuple[TableColumn, ...]]) -> dict[int, Channel]:
        schemas = self._schemas(tables)
        channels: dict[int, Channel] = {}
        wanted = ("id", "name", "type", "serialization_format", "type_description_hash")
        for identity, name, given_type, encoding, given in self._texts("topics", tables["topics"], wanted):
            type_name = _text(given_type)
            form, text = schemas.get((type_name, _text(given)), schemas.get((type_name, ""), ("", "")))
            normal = normalize_msgtype(type_name) if "/" in type_name else type_name
            if isinstance(identity, int):
                channels[identity] = Channel(
                    _text(name), normal, serialization_named(_text(encoding)), form.lower(), text
                )
        return channels

    def _schemas(self, tables: dict[str, tuple[TableColumn, ...]]) -> dict[tuple[str, str], tuple[str, str]]:
        """Return format and text of the definitions by type and by the type's hash; without a hash, the first counts.

        Types of two packages' versions have one name; whatever is wrong with this table, the messages are there.
        """
        schemas: dict[tuple[str, str], tuple[str, str]] = {}
        wanted = ("topic_type", "encoding", "encoded_message_definition", "type_description_hash")
        columns = tables.get("message_definitions", ())
        missing = {"topic_type", "encoding", "encoded_message_definition"} - {column.name for column in columns}
        if columns and missing:
            absent = sorted(missing)[0]
            self._warnings.add(
                f"{self._name}: its message definitions cannot be read (no column {absent}); those of ROS 2 serve"
            )
            return schemas
        for name, form, text, given_hash in self._texts("message_definitions", columns, wanted):
            definition = _text(form), _text(text)
            for given in (_text(given_hash), ""):
                schemas.setdefault((_text(name), given), definition)
        return schemas

    def _texts(self, table: str, columns: Sequence[TableColumn], wanted: Sequence[str]) -> Iterator[tuple[object, ...]]:
        """Yield the rows of a small table, None for columns that are not there; what cannot be read is said."""
        if not columns:
            return
        there = {column.name for column in columns if column.is_stored}
        names = ", ".join(name if name in there else "NULL" for name in wanted)
        key = next((column.name for column in columns if column.is_key), "rowid")
        found: dict[object, tuple[object, ...]] = {}
        faults: list[str] = []
        left = _MOST_TEXT * 1_000_000 * self._limits.text_mb

        def take(query: str, *values: object) -> None:
            nonlocal left
            try:
                for row, *cells in self._file.execute(query, values):
                    left -= sum(len(cell) for cell in cells if isinstance(cell, bytes))
                    if left < 0 or len(found) >= _MOST_NAMED:
                        raise sqlite3.DatabaseError("too many or too long (limits.text_mb)")
                    found.setdefault(row, tuple(cells))
            except sqlite3.DatabaseError as error:
                faults.append(self._file.fault(error))

        # Not by the file's size: in a sparse file, pages that are used again make very many rows.
        self._file.begin(_MOST_NAMED)
        take(f"SELECT {key}, {names} FROM {table} ORDER BY {key}")
        if faults and left > 0 and len(found) < _MOST_NAMED:  # a row that cannot be read ends it
            # Of a long row, the first columns may be whole.
            first = ", ".join(name if name in there and index < 3 else "NULL" for index, name in enumerate(wanted))
            for row in range(1, 1000):
                for columns_there in (names, first):
                    take(f"SELECT {key}, {columns_there} FROM {table} WHERE {key} = ?", row)
        if faults:
            self._warnings.add(f"{self._name}: its table {table} cannot be read whole: {faults[0]}")
        yield from found.values()

    def _summary(self) -> tuple[dict[int, int], int, int]:
        """Return the messages by topic's id, and the first and last time; decide whether rows are to be sorted."""
        totals: dict[int, int] = {}
        first, last, before, is_falling = MAX_TIME_NS, 0, 0, False
        for _, identity, time_ns in self._rows():
            totals[identity] = totals.get(identity, 0) + 1
            first, last = min(first, time_ns), max(last, time_ns)
            is_falling |= time_ns < before
            before = time_ns
        # Sorting reads all rows before it gives the first: of a damaged file, none.
        self._is_sorted = is_falling and not self._is_damaged
        pages = self._walked() if self._is_damaged else None
        if pages is not None:
            known = np.isin(pages.rows[:, 2], list(self._by_id))
            topics, counts = np.unique(pages.rows[known, 2], return_counts=True)
            if counts.sum() >= sum(count for identity, count in totals.items() if identity in self._by_id):
                times = pages.rows[known, 0]
                totals = dict(zip(topics.tolist(), counts.tolist(), strict=True))
                first, last = (int(times[0]), int(times[-1])) if len(times) else (0, 0)
            else:
                self._pages = None  # not as rosbag2 writes them
        return totals, first if totals else 0, last

    def _walked(self) -> SqlitePages | None:
        """Return the rows in the file's pages, for what the table does not lead to; the file is walked once."""
        if not self._is_walked:
            self._is_walked = True
            try:
                self._pages = SqlitePages(self._file.path)
            except BagError as error:
                self._warnings.add(f"{self._name}: {error}")
            if self._pages is not None and not self._pages.is_whole:
                self._warnings.add(
                    f"{self._name}: damaged, and more than {len(self._pages.rows)} rows in its pages: those behind "
                    "them are found only where the table still leads to them"
                )
        return self._pages

    def _page_rows(self) -> Iterator[tuple[int, int, int]]:
        """Yield (place, topic id, time) of the rows in the pages, by time."""
        rows = self._pages.rows if self._pages is not None else np.empty((0, 4), np.int64)
        for time_ns, _, identity, place in map(np.ndarray.tolist, rows):
            yield place, identity, time_ns

    def _page_data(self, place: int | None, time_ns: int, reason: str) -> bytes | None:
        """Return the bytes of a message in the pages; None, and a warning, when they cannot be read."""
        data = None
        if place is not None and self._pages is not None:
            try:
                data = self._pages.data(place, 1_000_000 * self._limits.message_mb)
            except BagError as error:
                reason = str(error)
        if data is None:
            self._warnings.add(
                f"{self._name}: the message at {seconds(time_ns)} cannot be read and is skipped: {reason}",
                kind=f"{self._name}: unreadable messages",
            )
        return data

    def _rows(self) -> Iterator[tuple[int, int, int]]:
        """Yield (row id, topic id, time) in order.

        The table itself is read, never an index, in which rows may be missing. Sorting takes these three alone: sorting
        whole messages would make SQLite copy the bag into temporary files. A damaged file may give
        rows again, without an end: each counts once. What the table does not lead to comes from its pages.
        """
        is_sorted = self._is_sorted
        order = f"timestamp, {self._key}" if is_sorted else self._key
        last = (_FIRST, _FIRST)
        odd = 0
        self._file.begin()
        try:
            # not fetchmany: it loses the rows before a missing page
            for row, identity, time_ns in self._file.execute(
                f"SELECT {self._columns} FROM messages NOT INDEXED ORDER BY {order}"
            ):
                if time_ns is None or not 0 <= time_ns <= MAX_TIME_NS:
                    odd += 1
                    continue
                place = (time_ns if is_sorted else 0, row)
                if place <= last:
                    raise sqlite3.DatabaseError("rows are out of order, or come again")
                last = place
                yield row, identity, time_ns
        except sqlite3.DatabaseError as error:
            self._is_damaged = True
            self._warnings.add(
                f"{self._name}: cut short or damaged ({self._file.fault(error)}): what could be read was read"
            )
            pages = self._walked()
            for time_ns, row, identity, _ in map(np.ndarray.tolist, () if pages is None else pages.rows):
                if (time_ns if is_sorted else 0, row) > last:
                    yield row, identity, time_ns
        if not odd and not self._is_damaged:
            self._columns = f"{self._key}, topic_id, timestamp"
        if odd:
            self._warnings.add(f"{self._name}: {odd} rows of messages have no whole time or topic and are skipped")

    def _passed(self, row: int) -> bytes | None:
        """Return the bytes of a row that a damaged table does not lead to, but is passed on the way from its first."""
        self._passes += 1
        if self._passes > _MOST_PASSES:
            return None
        try:
            # SQLite's own comparison would seek the row.
            for one, data in self._file.execute(f"SELECT {self._key}, data FROM messages NOT INDEXED"):
                if one == row:
                    return data if isinstance(data, bytes) else None
        except (sqlite3.DatabaseError, MemoryError, OverflowError):
            pass
        return None

    def _data(self, row: int, time_ns: int) -> bytes | None:
        """Return a message's bytes; None, and a warning, when they cannot be read."""
        place = None
        try:
            found = next(self._file.execute(self._data_query, (row,)), None)
            if found is not None and isinstance(found[0], bytes):
                data: bytes = found[0]
                return data
            reason = "its data are missing"
            is_lost = found is None
        except (sqlite3.DatabaseError, MemoryError, OverflowError) as error:
            reason = str(error)
            is_lost = not isinstance(error, sqlite3.DataError)  # not too large: pages or their order are damaged
        if is_lost and (pages := self._walked()) is not None:
            place = pages.place_of(row, time_ns)
        if is_lost and place is None and (passed := self._passed(row)) is not None:
            return passed
        return self._page_data(place, time_ns, reason)


def _text(value: object) -> str:
    if value is None:
        return ""
    return text_of(value) if isinstance(value, bytes) else str(value)
