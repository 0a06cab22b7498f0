# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import re
from pathlib import Path

import pytest

from imgu_ros.cli.main import main


def test_demo_prints_the_table_and_can_be_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("imgu_ros.replay.reporting.write_report", lambda path, *_: path.touch())
    for _ in range(2):
        assert main(["demo", "--frames", "1"]) == 0
    out = capsys.readouterr().out
    assert "1 / 1" in out
    corner = re.search(r"corner error px, p50 / p95 +(\S+) / ", out)
    assert corner
    assert float(corner[1]) <= 0.5
    for words in ("rotation error deg", "translation error %", "frames/s", "ms, p50 / p95", "whole frame"):
        assert words in out
    assert (tmp_path / "imgu_demo" / "replay" / "report.html").resolve().as_uri() in out


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (["--out", "mine"], "no earlier demo"),
        (["--out", "mine/file"], "mine/file"),
        (["--frames", "0"], "need at least 1"),
        (["-p", "seeed:=1"], "nearest known: seed"),
    ],
)
def test_bad_input_is_one_line_and_touches_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], argv: list[str], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "file").write_text("kept")
    assert main(["demo", *argv]) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert said in err
    assert [path.name for path in tmp_path.rglob("*")] == ["mine", "file"]
