# SPDX-License-Identifier: Apache-2.0
"""SQLite files of others: nothing in them runs, nothing is written beside them, and what is there is read."""

from __future__ import annotations

import os
import shutil
import sqlite3
import struct
import subprocess
import time
from contextlib import closing
from pathlib import Path

import pytest

from imgu_ros.bags import sqlite_storage
from imgu_ros.bags.reading import open_bag
from imgu_ros.bags.salvage import sqlite_pages
from imgu_ros.bags.sqlite_file import SqliteFile
from imgu_ros.bags.storage import WarningLog
from imgu_ros.config.parameters import LimitsParameters
from imgu_ros.errors import BagError

TOPICS = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)"
MESSAGES = "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"
INDEX = "CREATE INDEX timestamp_idx ON messages (timestamp ASC)"


def cdr(value: str) -> bytes:
    return b"\0\1\0\0" + struct.pack("<I", len(value) + 1) + value.encode() + b"\0"


TWO = ((1, 5, cdr("a")), (1, 6, cdr("b")))


def database(path, *statements, rows=TWO, page=4096):
    """A bag of std_msgs/String on /text; `statements` instead of the table of messages and its index."""
    connection = sqlite3.connect(path)
    connection.execute(f"PRAGMA page_size = {page}")
    connection.execute(TOPICS)
    connection.execute("INSERT INTO topics VALUES(1, '/text', 'std_msgs/msg/String', 'cdr')")
    for statement in statements or (MESSAGES, INDEX):
        connection.execute(statement)
    connection.commit()
    if rows:
        connection.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)", rows)
    connection.commit()
    return connection


def read(path, **limits):
    began = time.process_time()
    with open_bag([path], limits=LimitsParameters(**limits)) as bag:
        found = [(message.time_ns, message.message.data) for message in bag.messages()]
        assert time.process_time() - began < 8
        return found, bag.warnings


def refused(path) -> str:
    began = time.process_time()
    with pytest.raises(BagError) as error:
        open_bag([path])
    assert time.process_time() - began < 8
    return str(error.value)


ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i"


@pytest.mark.parametrize(
    "view",
    [
        f"CREATE VIEW messages AS {ENDLESS} id, 1 topic_id, i timestamp, zeroblob(1000000000) data FROM n",
        f"CREATE VIEW Messages(id, topic_id, timestamp, data) AS {ENDLESS}, 1, i, x'00' FROM n",
    ],
)
@pytest.mark.parametrize("is_forged", [False, True])
def test_a_view_is_no_table(tmp_path, view, is_forged):
    connection = database(tmp_path / "x.db3", view, rows=())
    if is_forged:
        connection.execute("PRAGMA writable_schema = ON")
        connection.execute("UPDATE sqlite_master SET type = 'table' WHERE type = 'view'")
        connection.commit()
    connection.close()
    assert "is no plain table; need rosbag2's tables" in refused(tmp_path / "x.db3")


def test_a_view_that_has_the_name_of_the_topics(tmp_path):
    connection = sqlite3.connect(tmp_path / "x.db3")
    connection.execute(f"CREATE VIEW topics AS {ENDLESS} id, '/t' name, 'a/B' type FROM n")
    connection.execute(MESSAGES)
    connection.close()
    assert "'topics' is no plain table" in refused(tmp_path / "x.db3")


def test_a_virtual_table_is_no_table(tmp_path):
    try:
        database(
            tmp_path / "x.db3", "CREATE VIRTUAL TABLE messages USING fts5(topic_id, timestamp, data)", rows=()
        ).close()
    except sqlite3.OperationalError as error:
        pytest.skip(str(error))
    assert "'messages' is no plain table" in refused(tmp_path / "x.db3")


@pytest.mark.parametrize(
    "columns",
    [
        "id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB AS (zeroblob(200000000))",
        "id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER AS (id) VIRTUAL, data BLOB",
    ],
)
def test_computed_columns_are_refused(tmp_path, columns):
    database(tmp_path / "x.db3", f"CREATE TABLE messages({columns})", rows=()).close()
    assert "computed columns; need recorded messages" in refused(tmp_path / "x.db3")


def test_triggers_and_computed_indexes_do_not_matter(tmp_path):
    statements = (
        MESSAGES,
        INDEX,
        "CREATE INDEX other ON messages(length(data) + 1) WHERE topic_id > 0",
        f"CREATE VIEW message_definitions_2 AS {ENDLESS} FROM n",
    )
    connection = database(tmp_path / "x.db3", *statements)
    connection.execute("CREATE TRIGGER t AFTER INSERT ON messages BEGIN DELETE FROM messages; END")
    connection.close()
    assert read(tmp_path / "x.db3") == ([(5, "a"), (6, "b")], ())


def test_a_table_with_other_columns_is_refused(tmp_path):
    statement = "CREATE TABLE messages(data BLOB, id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER)"
    database(tmp_path / "x.db3", statement).close()
    assert "messages has the columns data, id, topic_id, timestamp; need rosbag2's" in refused(tmp_path / "x.db3")
    database(tmp_path / "y.db3", "CREATE TABLE other(x)", rows=()).close()
    assert "no table 'messages'" in refused(tmp_path / "y.db3")


@pytest.mark.parametrize(
    "definition",
    [
        "messages(id INTEGER, topic_id INTEGER, timestamp INTEGER, data BLOB)",
        "messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB, extra TEXT) WITHOUT ROWID",
        "messages(id INT PRIMARY KEY, topic_id INT, timestamp INT, data)",
    ],
)
def test_tables_with_other_keys_are_read_in_linear_time(tmp_path, definition):
    connection = database(tmp_path / "x.db3", f"CREATE TABLE {definition}", rows=())
    rows = [(i, 1, i, cdr("a")) for i in range(20_000)]
    connection.executemany("INSERT INTO messages(id, topic_id, timestamp, data) VALUES(?, ?, ?, ?)", rows)
    connection.commit()
    connection.close()
    found, warnings = read(tmp_path / "x.db3")
    assert len(found) == 20_000
    assert warnings == ()


def test_rows_of_other_types_are_counted_and_skipped(tmp_path):
    rows = [
        (1, 1, cdr("a")),
        (1, 2, "text"),
        (1, 3, None),
        (1, 4, 5.5),
        (1, 5.5, cdr("b")),
        (1, 1e30, cdr("c")),
        (1, None, cdr("d")),
        ("topic", 6, cdr("e")),
        (b"\xff" * 100, "now", cdr("f")),
        (1, -7, cdr("g")),
        (99, 8, cdr("no topic")),
        (1, 2**63 - 1, cdr("last")),
    ]
    database(tmp_path / "x.db3", rows=rows).close()
    found, warnings = read(tmp_path / "x.db3")
    assert found == [(1, "a"), (2**63 - 1, "last")]
    assert any("6 rows of messages have no whole time or topic and are skipped" in line for line in warnings)
    assert any("its data are missing (and 1 others)" in line for line in warnings)


def test_rows_in_another_order_than_that_of_time(tmp_path):
    times = [5, 3, 9, 1, 9, 3]
    database(tmp_path / "x.db3", rows=[(1, t, cdr(str(i))) for i, t in enumerate(times)]).close()
    assert read(tmp_path / "x.db3")[0] == [(1, "3"), (3, "1"), (3, "5"), (5, "0"), (9, "2"), (9, "4")]


@pytest.mark.parametrize("statements", [(MESSAGES, INDEX), (MESSAGES,)])
@pytest.mark.parametrize("step", [1, -1])
def test_many_tiny_rows_are_within_the_budget(tmp_path, statements, step):
    rows = [(1, i, b"") for i in range(60_000)][::step]
    database(tmp_path / "x.db3", *statements, rows=rows).close()
    with open_bag([tmp_path / "x.db3"]) as bag:
        assert bag.message_count == 60_000
        assert sum(1 for _ in bag.raw_messages()) == 60_000
        assert bag.warnings == ()


def test_rows_that_an_index_does_not_have_are_read(tmp_path):
    connection = database(tmp_path / "x.db3", rows=[(1, i, cdr(str(i))) for i in range(100)])
    (root,) = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = 'timestamp_idx'").fetchone()
    (page,) = connection.execute("PRAGMA page_size").fetchone()
    connection.close()
    data = bytearray((tmp_path / "x.db3").read_bytes())
    # an empty leaf of an index
    data[(root - 1) * page : root * page] = struct.pack(">BHHHB", 10, 0, 0, 0, 0).ljust(page, b"\0")
    (tmp_path / "x.db3").write_bytes(data)
    assert len(read(tmp_path / "x.db3")[0]) == 100


def table_page(page: int, pointer: int, count: int) -> bytes:
    """An interior page of a table: `count` cells that all lead to the page `pointer`."""
    cells = [struct.pack(">I", pointer) + bytes((0x81, i)) for i in range(count)]
    offsets = [page - 6 * (i + 1) for i in range(count)]
    head = struct.pack(">BHHHBI", 5, 0, count, offsets[-1], 0, pointer) + struct.pack(f">{count}H", *offsets)
    return head.ljust(page - 6 * count, b"\0") + b"".join(reversed(cells))


def with_rows_again(path, table: str, levels: int) -> None:
    """Have the root of a table lead to its only page again and again: 100 ** levels times the rows."""
    with closing(sqlite3.connect(path)) as connection:
        (root,) = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = ?", (table,)).fetchone()
        (page,) = connection.execute("PRAGMA page_size").fetchone()
    data = path.read_bytes()
    pages = len(data) // page
    leaf = data[(root - 1) * page : root * page]
    chain = [table_page(page, pages + i + 2, 100) for i in range(levels - 1)]
    forged = bytearray(data + b"".join(chain) + leaf)
    forged[(root - 1) * page : root * page] = table_page(page, pages + 1, 100)
    forged[28:32] = struct.pack(">I", len(forged) // page)
    path.write_bytes(forged)


@pytest.mark.parametrize("levels", [3, 12])
@pytest.mark.parametrize("order", [1, -1])
def test_pages_that_lead_to_the_same_rows_again(tmp_path, levels, order):
    path = tmp_path / "x.db3"
    database(path, rows=[(1, i, cdr(str(i))) for i in range(20)][::order]).close()
    with_rows_again(path, "messages", levels)
    found, warnings = read(path)
    assert {value for _, value in found} == {str(i) for i in range(20)}
    assert any("again" in line for line in warnings)


def test_the_size_of_a_file_allows_no_endless_topics(tmp_path):
    """Nearly all of a gigabyte is a hole."""
    path = tmp_path / "x.db3"
    database(path).close()
    with_rows_again(path, "topics", 12)
    os.truncate(path, 10**9)
    found, warnings = read(path)
    assert found == [(5, "a"), (6, "b")]
    assert any("its table topics cannot be read whole" in line for line in warnings)


def test_messages_that_share_their_bytes(tmp_path):
    """Seven rows of a megabyte each, whose overflow pages are the same ones."""
    path = tmp_path / "x.db3"
    connection = database(path, MESSAGES, rows=[(1, 1, bytes(998_940))])
    (root,) = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'").fetchone()
    connection.close()
    data = bytearray(path.read_bytes())
    leaf = memoryview(data)[(root - 1) * 4096 : root * 4096]
    start = int.from_bytes(leaf[8:10], "big")
    cell = bytes(leaf[start:])
    assert cell[3] == 1  # the row's id, behind three bytes of length
    count = (4096 - 30) // len(cell)
    assert count >= 2
    cells = [cell[:3] + bytes((i + 1,)) + cell[4:] for i in range(count)]
    offsets = [4096 - len(cell) * (i + 1) for i in range(count)]
    head = struct.pack(">BHHHB", 13, 0, count, offsets[-1], 0) + struct.pack(f">{count}H", *offsets)
    leaf[:] = head.ljust(4096 - count * len(cell), b"\0") + b"".join(reversed(cells))
    path.write_bytes(data)
    with open_bag([path]) as bag:
        assert sum(1 for _ in bag.raw_messages()) == 2
        assert bag.warnings == ("x.db3: its messages share their bytes: what comes after them is not read",)


def test_a_loop_of_overflow_pages_ends(tmp_path):
    connection = database(tmp_path / "x.db3", MESSAGES, rows=[(1, 1, cdr("x" * 50_000)), (1, 2, cdr("b"))])
    (page,) = connection.execute("PRAGMA page_size").fetchone()
    connection.close()
    data = bytearray((tmp_path / "x.db3").read_bytes())
    first = next(i for i in range(page, len(data), page) if data[i + 4 : i + 1000] == b"x" * 996)
    data[first : first + 4] = struct.pack(">I", first // page + 1)
    (tmp_path / "x.db3").write_bytes(data)
    found, _ = read(tmp_path / "x.db3")
    assert found[-1] == (2, "b")


def test_a_message_beyond_the_bound_costs_itself_alone(tmp_path):
    rows = [(1, 1, cdr("a")), (1, 2, cdr("x" * 1_200_000)), (1, 3, cdr("y" * 900_000))]
    database(tmp_path / "x.db3", rows=rows).close()
    found, warnings = read(tmp_path / "x.db3", message_mb=1)
    assert [time_ns for time_ns, _ in found] == [1, 3]
    assert "the message at 0.000000002 s cannot be read and is skipped" in warnings[0]


def test_many_topics_and_long_texts(tmp_path):
    connection = database(tmp_path / "x.db3")
    connection.executemany("INSERT INTO topics VALUES(NULL, ?, 'a/msg/B', 'cdr')", [(f"/t{i}",) for i in range(70_000)])
    connection.commit()
    connection.close()
    with open_bag([tmp_path / "x.db3"]) as bag:
        assert len(bag.topics) == 65_536
        assert [message.message.data for message in bag.messages(["/text"])] == ["a", "b"]
        assert "its table topics cannot be read whole: too many or too long" in bag.warnings[0]


def test_a_topic_whose_row_goes_on_in_a_lost_page(tmp_path):
    """Its quality of service is long, and the hash behind it is lost: name and type are whole."""
    connection = sqlite3.connect(tmp_path / "x.db3")
    connection.execute(f"{TOPICS[:-1]}, offered_qos_profiles TEXT, type_description_hash TEXT)")
    for row in (("/other", "x"), ("/text", "q" * 9000), ("/third", "x")):
        connection.execute("INSERT INTO topics VALUES(NULL, ?, 'std_msgs/msg/String', 'cdr', ?, 'RIHS01_0')", row)
    connection.execute(MESSAGES)
    connection.executemany("INSERT INTO messages VALUES(NULL, ?, ?, ?)", [(2, 1, cdr("a")), (3, 2, cdr("b"))])
    connection.commit()
    connection.close()
    data = (tmp_path / "x.db3").read_bytes()
    second = data.index(b"q" * 4000, data.index(b"q" * 4000) + 4000) // 4096 * 4096
    (tmp_path / "x.db3").write_bytes(data[: second - 4096] + bytes(4096) + data[second:])
    found, warnings = read(tmp_path / "x.db3")
    assert found == [(1, "a"), (2, "b")]
    assert any("its table topics cannot be read whole" in line for line in warnings)


def test_a_schema_of_a_hundred_thousand_tables_is_refused(tmp_path):
    connection = database(tmp_path / "x.db3")
    connection.execute("PRAGMA writable_schema = ON")
    rows = ((f"t{i}", f"t{i}", f"CREATE TABLE t{i}(a)") for i in range(100_000))
    connection.executemany("INSERT INTO sqlite_master VALUES('table', ?, ?, 3, ?)", rows)
    connection.commit()
    connection.close()
    assert "need a readable" in refused(tmp_path / "x.db3")


@pytest.mark.parametrize("page", [512, 4096, 65536])
def test_a_file_shorter_than_its_header_says_is_named(tmp_path, page):
    connection = database(tmp_path / "x.db3", rows=[(1, i, cdr("x" * 3000)) for i in range(300)], page=page)
    connection.close()
    whole = (tmp_path / "x.db3").read_bytes()
    assert read(tmp_path / "x.db3")[1] == ()
    cut = len(whole) * 6 // 10
    (tmp_path / "x.db3").write_bytes(whole[:cut])
    found, warnings = read(tmp_path / "x.db3")
    times = [time_ns for time_ns, _ in found]
    assert times[:140] == list(range(140))  # of a page that is there in part, rows may be missing between others
    assert times == sorted(set(times))
    assert warnings[0] == (
        f"x.db3: cut short: its header says {len(whole) // page} pages of {page} bytes ({len(whole)} bytes), "
        f"the file has {cut}"
    )


@pytest.mark.parametrize("page", [512, 4096])
@pytest.mark.parametrize("is_in_order", [True, False])
def test_a_damaged_page_costs_what_is_in_it_alone(tmp_path, page, is_in_order):
    """Each page of the file in turn is zeros: of a b-tree's inner pages, all leaves are still found."""
    texts = [f"{i} " * (1 + i % 7 * 40) for i in range(120)]
    times = [i if is_in_order else i ^ 1 for i in range(120)]
    rows = [(1, t, cdr(text)) for t, text in zip(times, texts, strict=True)]
    database(tmp_path / "x.db3", rows=rows, page=page).close()
    whole = (tmp_path / "x.db3").read_bytes()
    expected = dict(zip(times, texts, strict=True))
    counts = []
    for start in range(2 * page, len(whole), page):
        (tmp_path / "x.db3").write_bytes(whole[:start] + bytes(page) + whole[start + page :])
        try:
            found, warnings = read(tmp_path / "x.db3")
        except BagError:
            continue  # the page of the table of topics
        assert [time_ns for time_ns, _ in found] == sorted({time_ns for time_ns, _ in found})
        # the end of one text may be zeros: pages have no checksum
        assert sum(expected[time_ns] != text for time_ns, text in found) <= 1
        assert len(found) == 120 or warnings
        counts.append(len(found))
    assert min(counts) >= 120 - page // 20
    assert counts.count(120) >= 2  # its index and its inner pages


def test_more_rows_than_are_sought_in_the_pages_of_a_damaged_file_are_said(tmp_path, monkeypatch):
    monkeypatch.setattr(sqlite_pages, "_MOST_ROWS", 100)
    database(tmp_path / "x.db3", rows=[(1, i, cdr(str(i))) for i in range(3000)], page=512).close()
    whole = (tmp_path / "x.db3").read_bytes()
    (tmp_path / "x.db3").write_bytes(whole[: len(whole) // 2])
    found, warnings = read(tmp_path / "x.db3")
    assert len(found) >= 100
    assert [line for line in warnings if "more than 100 rows in its pages" in line]


def test_a_row_in_two_pages_comes_once(tmp_path):
    database(tmp_path / "x.db3", rows=[(1, i, cdr(str(i))) for i in range(300)]).close()
    whole = (tmp_path / "x.db3").read_bytes()
    leaves = [i for i in range(0, len(whole), 4096) if whole[i] == 13]
    inner = [i for i in range(4096, len(whole), 4096) if whole[i] == 5]
    data = bytearray(whole) + whole[leaves[-1] : leaves[-1] + 4096]
    data[inner[0] : inner[0] + 4096] = bytes(4096)
    (tmp_path / "x.db3").write_bytes(data)
    found, warnings = read(tmp_path / "x.db3")
    assert found == [(i, str(i)) for i in range(300)]
    assert "cut short or damaged" in warnings[0]


def snapshot(folder):
    return {path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in folder.iterdir()}


def logged(folder, name="x.db3"):
    """A bag of ten messages, the last nine of them in the log, as a recorder that was killed leaves it."""
    work = folder.parent / "recorder"
    work.mkdir()
    connection = database(work / name, rows=[(1, 0, cdr("0"))])
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA wal_autocheckpoint = 0")
    for i in range(1, 10):
        connection.execute("INSERT INTO messages VALUES(NULL, 1, ?, ?)", (i, cdr(str(i))))
        connection.commit()
    folder.mkdir()
    for path in (work / name, work / f"{name}-wal"):
        shutil.copy(path, folder)
    connection.close()
    return folder / name


ALL = [(i, str(i)) for i in range(10)]


def test_messages_in_a_write_ahead_log_are_read_and_nothing_is_written(tmp_path, monkeypatch):
    path = logged(tmp_path / "bag")
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "tmp"))
    before = snapshot(path.parent)
    assert read(path) == (ALL, ())
    assert snapshot(path.parent) == before
    assert list((tmp_path / "tmp").iterdir()) == []
    (tmp_path / "link.db3").symlink_to(path)
    assert read(tmp_path / "link.db3") == (ALL, ())


def test_a_write_ahead_log_that_is_much_larger_than_the_file(tmp_path):
    connection = database(tmp_path / "x.db3", rows=())
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA wal_autocheckpoint = 0")
    rows = [(1, i, cdr("x" * 5000)) for i in range(300)]
    connection.executemany("INSERT INTO messages VALUES(NULL, ?, ?, ?)", rows)
    connection.commit()
    assert (tmp_path / "x.db3-wal").stat().st_size > 50 * (tmp_path / "x.db3").stat().st_size
    assert read(tmp_path / "x.db3") == ([(i, "x" * 5000) for i in range(300)], ())
    connection.close()


def test_a_write_ahead_log_on_read_only_media(tmp_path):
    path = logged(tmp_path / "bag")
    mount = ["mount", "--bind", "-o", "ro", str(path.parent), str(path.parent)]
    if subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("no read-only mount can be made here")
    try:
        with pytest.raises(OSError):
            (path.parent / "new").touch()
        assert read(path) == (ALL, ())
    finally:
        subprocess.run(["umount", str(path.parent)], check=True)


def test_a_write_ahead_log_that_cannot_be_copied_is_said(tmp_path, monkeypatch):
    path = logged(tmp_path / "bag")
    with path.open("ab") as file:
        file.truncate(5_000_000)
    found, warnings = read(path, temporary_mb=1)
    assert found == ALL[:1]
    assert (
        "what is in x.db3-wal is not read: a temporary copy takes 5 MB; "
        "need at most 1 MB of temporary copies (limits.temporary_mb)" in warnings[0]
    )
    # Of a disk of a terabyte, 500 MB stay free.
    monkeypatch.setattr("shutil.disk_usage", lambda folder: shutil._ntuple_diskusage(10**12, 10**12, 504_000_000))
    found, warnings = read(path)
    assert "has 504 MB left; need more" in warnings[0]
    monkeypatch.setattr("shutil.disk_usage", lambda folder: shutil._ntuple_diskusage(10**12, 10**12, 506_000_000))
    assert read(path) == (ALL, ())


def test_logs_of_several_files_share_the_temporary_space(tmp_path):
    """Two copies of 5 MB each, and room for one."""
    paths = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        paths.append(logged(tmp_path / name / "bag"))
        os.truncate(paths[-1], 5_000_000)
    with open_bag(paths, limits=LimitsParameters(temporary_mb=8)) as bag:
        assert bag.message_count == len(ALL) + 1
        assert [("limits.temporary_mb" in warning) for warning in bag.warnings] == [True]


def test_what_is_behind_a_log_is_not_copied(tmp_path):
    """A log of a terabyte, nearly all of it a hole, and one that is none."""
    path = logged(tmp_path / "bag")
    os.truncate(path.with_name("x.db3-wal"), 2**40)
    assert read(path) == (ALL, ())
    path.with_name("x.db3-wal").write_bytes(bytes(100))
    assert read(path)[0] == ALL[:1]
    path.with_name("x.db3-wal").unlink()
    os.mkfifo(path.with_name("x.db3-wal"))
    assert read(path)[0] == ALL[:1]


def test_an_unfinished_transaction_is_left_out(tmp_path):
    work, folder = tmp_path / "work", tmp_path / "bag"
    work.mkdir()
    folder.mkdir()
    connection = database(work / "x.db3", rows=[(1, i, cdr(str(i))) for i in range(10)])
    connection.execute("PRAGMA cache_size = 1")
    connection.execute("PRAGMA cache_spill = 1")
    connection.execute("BEGIN")
    connection.execute("UPDATE messages SET timestamp = timestamp + 1000")
    connection.executemany("INSERT INTO messages VALUES(NULL, 1, ?, ?)", [(9, cdr("x" * 9000))] * 500)
    for path in work.iterdir():
        shutil.copy(path, folder)
    connection.rollback()
    connection.close()
    if not (folder / "x.db3-journal").exists():
        pytest.skip("this SQLite keeps no journal file")
    before = snapshot(folder)
    found, warnings = read(folder / "x.db3")
    assert found == ALL
    assert "its last transaction was not finished (x.db3-journal); it is left out" in warnings[0]
    assert snapshot(folder) == before


def test_a_path_that_is_not_utf8(tmp_path):
    path = os.fsdecode(os.fsencode(tmp_path) + b"/b\xe4g %?#\xff.db3")
    database(tmp_path / "x.db3").close()
    os.rename(tmp_path / "x.db3", path)
    assert read(Path(path)) == ([(5, "a"), (6, "b")], ())


def test_memory_that_a_forged_length_asks_for_is_an_error_of_the_file(tmp_path, write_sqlite) -> None:
    """SQLite allocates what a row claims before it looks whether the file has it."""

    class Refusing:
        def execute(self, query, values=()):
            raise MemoryError

    path = tmp_path / "bag.db3"
    write_sqlite(path, 4, [("/text", "std_msgs/msg/String", "cdr", "", "")], [], [(1, 5, b"\0\1\0\0\2\0\0\0a\0")])
    whole = SqliteFile(path, "bag.db3", WarningLog())
    database, whole._database = whole._database, Refusing()
    with pytest.raises(sqlite3.DatabaseError, match="more memory"):
        list(whole.execute("SELECT 1"))
    whole._database = database
    whole.close()


def mislead(path, page: int, rows: int) -> list[int]:
    """Lower a separating key of the messages' root page, so that a search by id goes astray; return these ids.

    The b-tree's own order stays whole (SQLite's Database File Format, section 1.6).
    """
    with closing(sqlite3.connect(path)) as connection:
        (root,) = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'").fetchone()
    content = bytearray(path.read_bytes())
    start = (root - 1) * page
    assert content[start] == 5  # an interior page of a table
    cells = int.from_bytes(content[start + 3 : start + 5], "big")
    (cell,) = struct.unpack_from(">H", content, start + 12 + 2 * (cells // 2))
    at = start + cell + 4  # behind the child's number
    key = content[at]
    assert rows < key < 128  # one byte
    content[at] = key - rows
    path.write_bytes(content)
    return list(range(key - rows + 1, key + 1))


def many(tmp_path, count: int = 100):
    rows = [(1, 10 * index, cdr(f"number {index} " + "x" * 40)) for index in range(1, count + 1)]
    database(tmp_path / "x.db3", MESSAGES, rows=rows, page=512).close()
    return rows


def test_a_row_to_which_the_table_does_not_lead_is_found_on_the_way_from_the_first(tmp_path, monkeypatch):
    rows = many(tmp_path)
    lost = mislead(tmp_path / "x.db3", 512, 3)
    # Its pages are not all known.
    monkeypatch.setattr(sqlite_pages, "_MOST_ROWS", 1)
    with closing(sqlite3.connect(tmp_path / "x.db3")) as connection:
        for row in lost:
            assert connection.execute("SELECT data FROM messages WHERE id = ?", (row,)).fetchone() is None
    found, warnings = read(tmp_path / "x.db3")
    assert [time_ns for time_ns, _ in found] == [time_ns for _, time_ns, _ in rows]
    assert [data.endswith("x" * 40) and f"number {time_ns // 10} " in data for time_ns, data in found] == [True] * 100
    assert not any("skipped" in each for each in warnings)


def test_a_damaged_table_is_not_read_again_and_again_for_rows_to_which_it_does_not_lead(tmp_path, monkeypatch):
    rows = many(tmp_path)
    lost = mislead(tmp_path / "x.db3", 512, 4)
    monkeypatch.setattr(sqlite_pages, "_MOST_ROWS", 1)
    monkeypatch.setattr(sqlite_storage, "_MOST_PASSES", 3)
    found, warnings = read(tmp_path / "x.db3")
    assert [time_ns // 10 for time_ns, _ in found] == [row for row in range(1, len(rows) + 1) if row != lost[3]]
    assert any("skipped" in each for each in warnings)
