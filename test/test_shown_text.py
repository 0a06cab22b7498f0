# SPDX-License-Identifier: Apache-2.0
"""Text from outside: what acts on a terminal becomes visible, what is endless short, and cells of tables read back."""

from __future__ import annotations

import pickle
import time
import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import BagError, ImguError, NoConsensus
from imgu_ros.shown_text import as_cell, cell_text, shown

#: Everything, lone surrogates too, and often what matters.
TEXT = st.text(st.one_of(st.characters(), st.sampled_from("=+-@'\\xuU01\t\r\n\x1b\x9b\u202e\u2066\ufeff\udcff\ud800")))
ALLOWED_FORMAT = "\u200c\u200d"  # joiners, with which emoji and scripts are written


@pytest.mark.parametrize(
    ("text", "want"),
    [
        ("\x1b[2J\x1b]0;title\x07", r"\x1b[2J\x1b]0;title\x07"),
        ("\x9b31m", r"\x9b31m"),
        ("a\nb\r\tc\0\x7f", r"a\nb\r\tc\x00\x7f"),
        ("invoice\u202egnp.exe", r"invoice\u202egnp.exe"),
        ("\u2066\u2069\u200b\ufeff\u2028\u2029", r"\u2066\u2069\u200b\ufeff\u2028\u2029"),
        ("caf\udce9", r"caf\udce9"),
        ("\U000e0041", r"\U000e0041"),
    ],
)
def test_what_acts_is_seen(text: str, want: str) -> None:
    assert shown(text) == want


@pytest.mark.parametrize(
    "text", ["é ñ ß", "漢字 かな 한글", "שלום عليكم", "👩‍👩‍👧 ❤️ 🏳️‍🌈", r"C:\x1b\data", "می‌خواهم", "a  b", ""]
)
def test_plain_text_stays(text: str) -> None:
    assert shown(text) == text


@given(TEXT, st.integers(60, 200))
def test_nothing_acting_is_left_and_twice_is_once(text: str, limit: int) -> None:
    once = shown(text, limit)
    assert len(once) <= limit
    assert shown(once, limit) == once
    for character in once:
        assert unicodedata.category(character) not in ("Cc", "Cs", "Zl", "Zp")
        assert unicodedata.bidirectional(character) not in (
            "RLO",
            "LRO",
            "RLE",
            "LRE",
            "PDF",
            "RLI",
            "LRI",
            "FSI",
            "PDI",
        )
    once.encode()


def test_twenty_megabytes_cost_nothing_and_both_ends_are_there() -> None:
    text = "begin\x1b" + "a\x1b" * 10_000_000 + "\x1bend"
    started = time.perf_counter()
    line = shown(text, 100)
    assert time.perf_counter() - started < 0.1
    assert line.startswith(r"begin\x1ba") and line.endswith(r"\x1bend") and "(20000010 characters)" in line


@given(TEXT)
def test_a_cell_reads_back_and_is_no_formula(text: str) -> None:
    cell = as_cell(text)
    assert cell_text(cell) == text
    assert not cell.startswith(("=", "+", "-", "@", "\t", "\r"))
    assert all(unicodedata.category(c) not in ("Cc", "Cs", "Zl", "Zp") for c in cell)


@pytest.mark.parametrize(
    ("text", "cell"),
    [
        ("=cmd|' /C calc'!A0", "'=cmd|' /C calc'!A0"), ("-1", "'-1"), ("'", "''"), ("a=b", "a=b"), (r"a\b", r"a\\b"),
        ("é漢😀", "é漢😀"),
    ],
)  # fmt: skip
def test_cells(text: str, cell: str) -> None:
    assert as_cell(text) == cell


def test_cells_of_others_are_text_whatever_is_in_them() -> None:
    assert cell_text(r"\U00110000 \xzz \q") == r"\U00110000 \xzz \q"


def test_errors_are_shown_text_for_everyone() -> None:
    error = BagError("camera\x1b[31m\n\u202e: no such topic")
    assert str(error) == r"camera\x1b[31m\n\u202e: no such topic"
    assert len(str(ImguError("x" * 10**6))) <= 2000
    again = pickle.loads(pickle.dumps(NoConsensus("a\x1b", 3)))
    assert str(again) == r"a\x1b"
