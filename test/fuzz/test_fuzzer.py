# SPDX-License-Identifier: Apache-2.0
"""The fuzzer itself: its seeds are whole, its scans right, and it catches a reader that is broken in any way."""

from __future__ import annotations

import json
import sys
from collections import Counter
from functools import partial

import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

import fuzz.__main__ as command
from fuzz import pool as pools
from fuzz.harness import fuzz_one
from fuzz.kinds import KINDS, RECORDING, generated, in_turn, write_case
from fuzz.pool import Pool
from fuzz.scan import identity, scanned
from fuzz.worker import Request

SEEDS = [(kind, index) for kind in KINDS for index in range(len(KINDS[kind].seeds()))]


@pytest.mark.parametrize(("kind", "index"), SEEDS)
def test_seed_is_read_whole(kind, index, tmp_path) -> None:
    path = write_case(generated(kind, 1, index), tmp_path)
    verdict, complete = fuzz_one(KINDS[kind].reader, path)
    complete()
    assert verdict.failures == []
    assert KINDS[kind].reader != RECORDING or verdict.messages in (15, 18, 36)


#: Those that rosbags reads, which wants an index.
INDEXED = [*(("mcap", i) for i in (0, 1, 2, 7, 8)), *(("rosbag1", i) for i in (0, 1, 2, 3, 5))]


@pytest.mark.parametrize(("kind", "index"), INDEXED)
def test_scan_gives_what_rosbags_gives(kind, index, tmp_path) -> None:
    path = write_case(generated(kind, 1, index), tmp_path)
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        theirs = Counter(identity(time_ns, data) for _, time_ns, data in reader.messages())
    assert len(theirs) in (15, 18)
    assert scanned(path) == theirs


@pytest.mark.parametrize("kind", KINDS)
def test_case_is_a_function_of_its_numbers(kind) -> None:
    cases = [generated(kind, 3, index) for index in range(40, 60)]
    assert cases == [generated(kind, 3, index) for index in range(40, 60)]
    assert cases != [generated(kind, 4, index) for index in range(40, 60)]
    assert generated(kind, 3, 40, rounds=0) in KINDS[kind].seeds()


def test_kinds_take_turns_by_their_shares() -> None:
    turns = list(in_turn([RECORDING], 5, 200))
    assert {name for name, _ in turns} == {name for name, kind in KINDS.items() if kind.reader == RECORDING}
    assert turns[0][1] == 5 and len(set(turns)) == 200


#: What a broken reader does, by the invariant that it breaks.
_BROKEN = {
    "traceback": "harness.open_bag = lambda paths: [][1]",
    "lost": """
given = reading.Bag.raw_messages
def raw_messages(self, topics=None):
    messages = given(self, topics)
    next(messages)
    self._warnings.add("one message less")
    yield from messages
reading.Bag.raw_messages = raw_messages""",
    "undecoded": """
given = reading.Bag.messages
def messages(self, topics=None):
    messages = given(self, topics)
    next(messages)
    self._warnings.add("one message less")
    yield from messages
reading.Bag.messages = messages""",
    "silent": "reading.Bag.message_count = property(lambda self: 1000)",
    "memory": """
given = harness.open_bag
def open_bag(paths):
    kept = bytearray(250_000_000)
    return given(paths)
harness.open_bag = open_bag""",
    "time": """
import time
given = harness.open_bag
def open_bag(paths):
    start = time.process_time()
    while time.process_time() < start + 2:
        pass
    return given(paths)
harness.open_bag = open_bag""",
    "crash": "import os\nharness.open_bag = lambda paths: os.kill(os.getpid(), 11)",
    "text": "reading.Bag.warnings = property(lambda self: ('x' * 6000,))",
    "warning": """
import warnings
given = harness.open_bag
def open_bag(paths):
    warnings.warn("overflow", RuntimeWarning)
    return given(paths)
harness.open_bag = open_bag""",
    "left behind": """
import tempfile
given = harness.open_bag
def open_bag(paths):
    tempfile.mkdtemp()
    return given(paths)
harness.open_bag = open_bag""",
}
_IMPORTS = "from fuzz import harness\nimport imgu_ros.bags.reading as reading\n"


@pytest.mark.parametrize("invariant", _BROKEN)
def test_broken_reader_is_caught(invariant, monkeypatch) -> None:
    monkeypatch.setattr(pools, "MOST_MB", 300)
    monkeypatch.setattr(pools, "MOST_SECONDS", 1.5)
    monkeypatch.setattr(pools, "STANDARD_SECONDS", 1000.0)  # the bound as it is, however slow the machine is just now
    with Pool(_IMPORTS + _BROKEN[invariant]) as pool:
        answer = pool.run(Request("mcap"))
        assert {failure.partition(":")[0] for failure in answer.failures} - {"silent"} <= {invariant, "lost"}
        assert any(failure.startswith(f"{invariant}:") for failure in answer.failures)


@pytest.mark.parametrize("wait", ["time.sleep(1000)", "time.process_time() and [0 for _ in iter(int, 1)]"])
def test_reader_that_does_not_end_is_ended(wait, monkeypatch) -> None:
    monkeypatch.setattr(pools, "_HANG_SECONDS", 3.0)
    monkeypatch.setattr(pools, "_MAKING_SECONDS", 1.0)
    monkeypatch.setattr(pools, "MOST_SECONDS", 1.0)
    with Pool(f"{_IMPORTS}import time\nharness.open_bag = lambda paths: {wait}") as pool:
        assert pool.run(Request("mcap")).failures[0].startswith("time: ended after")
        assert pool.run(Request("camera")).failures == []


def test_failure_is_saved_with_few_mutations_and_read_again(monkeypatch, tmp_path, capsys) -> None:
    def run(prepare: str, *arguments: str) -> int:
        monkeypatch.setattr(command, "Pool", partial(Pool, prepare))
        monkeypatch.setattr(sys, "argv", ["fuzz", *arguments])
        return command.main()

    out, figures = tmp_path / "out", tmp_path / "figures.json"
    broken = _IMPORTS + _BROKEN["traceback"]
    options = ("--kind", "rosbag1", "--seed", "7", "--first", "20", "--count", "2", "--out", str(out))
    assert run(broken, *options, "--figures", str(figures)) == 1
    assert "FAILED traceback: IndexError" in capsys.readouterr().out
    written = json.loads(figures.read_text())
    assert written["kinds"]["rosbag1"]["cases"] == written["recordings"] == 2
    assert written["kinds"]["rosbag1"]["failures"] == {"traceback": 2, "lost": 2}
    saved = out / "rosbag1-7-20"
    assert (saved / "bag.bag").read_bytes() in [case["bag.bag"] for case in KINDS["rosbag1"].seeds()]
    assert "IndexError" in (saved / "verdict.txt").read_text()
    assert run(broken, "--replay", str(saved)) == 1
    assert run("", "--replay", str(saved)) == 0
    assert run("", "--kind", "rosbag1", "--replay", str(saved / "bag.bag")) == 0
