# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import io
import sys

import pytest

from imgu_ros.cli import progress as progress_module
from imgu_ros.cli.progress import Progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_plain_lines_now_and_then(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    now = [0.0]
    monkeypatch.setattr(progress_module.time, "monotonic", lambda: now[0])
    with Progress("replay") as progress:
        for done in range(1, 25):
            now[0] += 1.0
            progress(done, 24)
        progress.say("a word")
    lines = capsys.readouterr().err.splitlines()
    between = [f"replay: {n} of 24 frames, 1 a second, {24 - n} s left" for n in (5, 10, 15, 20)]
    assert lines == [*between, "a word", "replay: 24 of 24 frames, 1 a second"]


def test_nothing_more_after_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ValueError, match="x"), Progress("replay") as progress:
        progress(1, None)
        raise ValueError("x")
    assert capsys.readouterr().err == ""


def test_a_bar_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("COLUMNS", "80")
    with Progress("replay") as progress:
        progress(1, 2)
        progress.say("a word")
        progress(2, 2)
    text = terminal.getvalue()
    assert "a word\n" in text
    assert "2/2" in text
    assert "replay: 2 of 2" not in text
