# SPDX-License-Identifier: Apache-2.0
"""An untrusted SQLite file, opened for reading: nothing is written beside it, and nothing in it runs.

A hostile file may hold views, virtual tables, generated columns and recursive queries under the names of the expected
tables, a b-tree whose pages reference the same pages again (endless rows), and texts of any size. Therefore only real
tables with plain columns are read, and each statement has a budget of steps.
"""

from __future__ import annotations

import os
import re
import sqlite3
import stat
import struct
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import quote

from imgu_ros.bags.compression import TemporarySpace
from imgu_ros.bags.storage import WarningLog
from imgu_ros.config.parameters import DEFAULT_LIMITS, LimitsParameters
from imgu_ros.errors import BagError

#: Steps of SQLite's virtual machine: for the schema, of which a bag has a handful; for each byte of the file (a row has
#: 10 bytes at least, of rosbag2 37, and takes less than 40 steps in all); and after how many they are counted.
_SCHEMA_STEPS, _STEPS_PER_BYTE, _STEPS_PER_ROW, _COUNTED_STEPS = 200_000, 6, 60, 10_000
_MOST_COLUMNS = 100
_JOURNAL_MAGIC = bytes.fromhex("d9d505f920a163d7")
_WAL_MAGIC = (bytes.fromhex("377f0682"), bytes.fromhex("377f0683"))
_WAL_HEADER, _FRAME_HEADER = 32, 24
_BLOCK = 2**20
_REAL_TABLE = re.compile(r"CREATE\s+TABLE\b", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class TableColumn:
    """A column of a table: whether it is the table's only key, and whether it is stored, not computed."""

    name: str
    is_key: bool
    is_stored: bool


class SqliteFile:
    """An open SQLite file.

    Parameters
    ----------
    path : the file. With a write-ahead log or an unfinished transaction beside it, a temporary copy is read: SQLite
        would write files beside it, which on read-only media it cannot
    name : what warnings call it
    warnings : takes what is damaged
    limits : `message_mb`
    space : for a temporary copy; None: as much as `limits.temporary_mb` allows

    Raises
    ------
    BagError
        If the file cannot be opened.
    """

    def __init__(
        self,
        path: Path,
        name: str,
        warnings: WarningLog,
        limits: LimitsParameters = DEFAULT_LIMITS,
        space: TemporarySpace | None = None,
    ) -> None:
        self.given, self._name, self._warnings, self._limits = path, name, warnings, limits
        self._space = space or TemporarySpace(limits)
        self._resources = ExitStack()
        self._steps_left = _SCHEMA_STEPS
        try:
            self.path = self._whole(Path(os.path.realpath(path)))
            self._database = self._connected()
            self.size = self.path.stat().st_size  # a copy has now what its log held
        except (OSError, sqlite3.Error) as error:
            self.close()
            raise BagError(f"{path}: {error}; need a readable SQLite file") from None
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file, and remove the copy if there is one."""
        self._resources.close()

    def execute(self, query: str, values: tuple[object, ...] = ()) -> Iterator[Any]:
        """Yield the rows of a statement of our own; sqlite3.DatabaseError where they cannot be read."""
        try:
            yield from self._database.execute(query, values)
        except MemoryError:  # a forged length
            raise sqlite3.DatabaseError("it asks for more memory than there is") from None

    def begin(self, most_rows: int | None = None) -> None:
        """Begin a pass over a table, which may take steps again: as many as the file's size, or the rows, need."""
        steps = _STEPS_PER_BYTE * self.size if most_rows is None else _STEPS_PER_ROW * most_rows
        self._steps_left = _SCHEMA_STEPS + steps

    def fault(self, error: sqlite3.Error) -> str:
        """Return an error for people."""
        return "its pages lead to the same rows again and again" if self._steps_left <= 0 else str(error)

    def tables(self, *names: str) -> dict[str, tuple[TableColumn, ...]]:
        """Return the columns of those of the tables that are there.

        Raises
        ------
        BagError
            If what has the name is no table.
        """
        marks = ", ".join("?" * len(names))
        query = (
            f"SELECT name, sql FROM sqlite_master WHERE type IN ('table', 'view') AND name COLLATE NOCASE IN ({marks})"
        )
        found: dict[str, tuple[TableColumn, ...]] = {}
        for name, sql in islice(self.execute(query, names), 2 * len(names)):
            name = bytes(name).decode("ascii", "replace").lower()
            text = sql.decode("utf-8", "replace") if isinstance(sql, bytes) else ""
            if name in found or not _REAL_TABLE.match(text):
                raise BagError(f"{self.given}: {name!r} is no plain table; need rosbag2's tables topics and messages")
            found[name] = self._columns(name)
        return found

    def _columns(self, table: str) -> tuple[TableColumn, ...]:
        rows = list(self.execute(f"PRAGMA table_xinfo({table})"))
        keys = sum(bool(row[5]) for row in rows)
        return tuple(
            TableColumn(bytes(row[1]).decode("utf-8", "replace").lower(), bool(row[5]) and keys == 1, not row[6])
            for row in rows
        )

    def _connected(self) -> sqlite3.Connection:
        is_copy = self.path != Path(os.path.realpath(self.given))
        mode = "mode=rw" if is_copy else "immutable=1"
        # Quoted as bytes: names need not be UTF-8.
        database = sqlite3.connect(f"file:{quote(os.fsencode(self.path))}?{mode}", uri=True, check_same_thread=False)
        self._resources.callback(database.close)
        database.text_factory = bytes  # damaged text must not raise
        for limit, value in (
            (sqlite3.SQLITE_LIMIT_LENGTH, min(1_000_000 * self._limits.message_mb, 2**31 - 1)),
            (sqlite3.SQLITE_LIMIT_COLUMN, _MOST_COLUMNS),
        ):
            database.setlimit(limit, value)
        database.set_progress_handler(self._has_no_steps_left, _COUNTED_STEPS)
        database.execute("PRAGMA trusted_schema = OFF")
        # Lets SQLite open a file that has fewer pages than its header says.
        database.execute("PRAGMA writable_schema = ON")
        if is_copy:
            database.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
        database.execute("PRAGMA query_only = ON")
        return database

    def _has_no_steps_left(self) -> bool:
        self._steps_left -= _COUNTED_STEPS
        return self._steps_left <= 0

    def _whole(self, real: Path) -> Path:
        """Return the file, or a copy with what is in a log beside it; warn of what is missing."""
        log, journal = (real.with_name(real.name + end) for end in ("-wal", "-journal"))
        is_logged, is_unfinished = _begins(log, *_WAL_MAGIC), _begins(journal, _JOURNAL_MAGIC)
        if not is_logged and not is_unfinished:
            self._check_pages(real)
            return real
        beside = log if is_logged else journal
        try:
            size = _log_size(log) if is_logged else journal.stat().st_size
            needed = real.stat().st_size + size
            folder = Path(self._resources.enter_context(TemporaryDirectory(prefix="imgu_bag_")))
            reason = self._space.take(needed, folder)
            if reason:
                reason = f"a temporary copy takes {needed / 1e6:.0f} MB; {reason}"
            else:
                copy = folder / "bag.db3"
                _copy(real, copy, real.stat().st_size)
                _copy(beside, folder / f"{copy.name}{beside.name[len(real.name) :]}", size)
        except OSError as error:
            reason = f"no temporary copy: {error.strerror}"
        if reason:
            self._warnings.add(f"{self._name}: what is in {beside.name} is not read: {reason}")
            return real
        if is_unfinished:
            self._warnings.add(f"{self._name}: its last transaction was not finished ({journal.name}); it is left out")
        return copy

    def _check_pages(self, real: Path) -> None:
        """Warn of a file that has fewer pages than its header says."""
        with real.open("rb") as file:
            header = file.read(100)
        if len(header) < 100 or header[24:28] != header[92:96]:
            return  # the count is not valid
        (page,), (count,) = struct.unpack_from(">H", header, 16), struct.unpack_from(">I", header, 28)
        page = 65536 if page == 1 else page
        size = real.stat().st_size
        if count * page > size:
            self._warnings.add(
                f"{self._name}: cut short: its header says {count} pages of {page} bytes ({count * page} bytes), "
                f"the file has {size}"
            )


def _begins(path: Path, *magics: bytes) -> bool:
    """Return whether a regular file is there and begins with one of some bytes."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    except OSError:
        return False
    with open(descriptor, "rb") as file:
        return stat.S_ISREG(os.fstat(descriptor).st_mode) and file.read(len(magics[0])) in magics


def _copy(source: Path, target: Path, size: int) -> None:
    """Copy the first `size` bytes, or as many as there are."""
    with source.open("rb") as given, target.open("wb") as copy:
        while size > 0 and (block := given.read(min(size, _BLOCK))):
            copy.write(block)
            size -= len(block)


def _log_size(path: Path) -> int:
    """Return how many bytes of a write-ahead log belong to its last beginning: what is behind them is of older ones."""
    with path.open("rb") as log:
        header = log.read(_WAL_HEADER)
        page = int.from_bytes(header[8:12], "big")
        end = _WAL_HEADER
        while (frame := log.read(_FRAME_HEADER))[:4] > bytes(4) and frame[8:16] == header[16:24]:
            end = log.seek(end + _FRAME_HEADER + page)
        return end
