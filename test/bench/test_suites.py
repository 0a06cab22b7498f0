# SPDX-License-Identifier: Apache-2.0
"""The suites, small; tables; machine; memory."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from dataclasses import replace
from itertools import groupby, islice
from pathlib import Path

import cv2
import pytest

from imgu_ros.bench.figures import Figures
from imgu_ros.bench.machine import ProcessorTimes, processor_times, processor_use, this_machine
from imgu_ros.bench.memory import peak_memory, resident_mb
from imgu_ros.bench.methods import Answered, ChainMethod
from imgu_ros.bench.plots import write_plot
from imgu_ros.bench.suites import Growth, Options, Suite, run_suite
from imgu_ros.bench.tables import tables
from imgu_ros.errors import FileError, ParameterError
from imgu_ros.frame import Frame
from imgu_ros.simulate.conditions import PLAIN, condition_named
from imgu_ros.simulate.texture import procedural_texture

SMALL = Options(
    sizes=((320, 240),),
    frames=2,
    conditions=(PLAIN, condition_named("no-target")),
    negatives=1,
    photographs=(procedural_texture(320, 240, 9),),
    length_frames=40,
)


def rows_of(suite: Suite, options: Options = SMALL) -> list[Figures]:
    return [row for row in run_suite(suite, options) if isinstance(row, Figures)]


def test_there_is_a_row_for_each_condition_and_method() -> None:
    rows = rows_of(Suite.TRACKING, replace(SMALL, sift_every=2))
    assert [(r.kind, r.condition, r.method) for r in rows] == [
        ("sequence", condition, method)
        for condition in ("plain", "no-target")
        for method in ("tracking", "ORB", "SIFT")
    ]
    plain = rows[0]
    assert plain.found == 1.0 and plain.false == 0 and plain.size == "320x240"
    # Nothing to find: no share, only what is false.
    assert all(r.found is None for r in rows if r.condition == "no-target")
    assert [r.frames for r in rows[:3]] == [2, 2, 1]


def test_negatives_show_no_target() -> None:
    rows = rows_of(Suite.NEGATIVES)
    assert {r.method for r in rows} == {"tracking", "detection", "ORB"}
    assert all((r.kind, r.condition, r.found, r.frames) == ("absent", "photographs", None, 1) for r in rows)


def test_length_measures_the_growth() -> None:
    (growth,) = run_suite(Suite.LENGTH, SMALL)
    assert isinstance(growth, Growth)
    assert growth.frames == 40 and growth.early_mb > 20 and abs(growth.late_mb - growth.early_mb) < 100


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (replace(SMALL, sizes=((321, 240),)), "size: 321x240; need even"),
        (replace(SMALL, sizes=()), "one is empty"),
        (replace(SMALL, frames=0), "frames: 0"),
        (replace(SMALL, sift_every=0), "SIFT"),
        (replace(SMALL, seeds=(-1,)), "seed: -1"),
    ],
)
def test_impossible_options_are_refused(options: Options, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        next(run_suite(Suite.TABLE, options))


def row(method: str, ms: float, px: float | None, condition: str = "plain", cpu_ms: float = 0.0) -> Figures:
    return Figures(
        condition, "sequence", "640x480", method, 9, ms, 2 * ms, cpu_ms or ms, px, px, 0.5, 0.25, 3,
        None, None, None, None, None, {"refine": 1.5},
    )  # fmt: skip


def test_tables_show_figures_and_quotients() -> None:
    rows = [
        row("tracking", 2.0, 0.1, cpu_ms=1.0),
        row("ORB", 10.0, 1.0),
        row("SIFT", 100.0, None),
        Growth("640x480", 5, 1.0, 2.5),
    ]
    plain = tables(rows)
    ours = next(line for line in plain.splitlines() if "ours, tracking" in line)
    assert ours.split() == (
        "640x480 ours, tracking 2.0 4.0 1.0 5.0 / 10.0 / 10 50.0 / 100.0 / - 0.100 0.100 50.0% 25.0% 3 - - -".split()
    )
    assert "refine" in plain and "1.50" in plain and "+1.5" in plain
    for line in tables(rows, markdown=True).splitlines():
        assert not line or not line.startswith("|") or line.endswith("|")


def test_plot_is_a_picture(tmp_path: Path) -> None:
    rows = [row("tracking", 2.0, 0.1), row("ORB", 10.0, 1.0), row("ORB", 1.0, None, "blur-5")]
    assert write_plot(tmp_path / "plot.png", rows)
    drawn = cv2.imread(str(tmp_path / "plot.png"))
    assert drawn is not None and drawn.std() > 5
    assert not write_plot(tmp_path / "none.png", [])
    with pytest.raises(FileError, match="need a file"):
        write_plot(tmp_path / "no" / "plot.png", rows)


def test_machine_is_described() -> None:
    machine = this_machine()
    assert machine.opencv_threads == cv2.getNumThreads()
    assert machine.cores <= (os.cpu_count() or 1)
    assert machine.versions["opencv"] in machine.described()


def test_sizes_of_the_table_are_measured_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    """A moment in which the machine is slow makes no size look dear."""
    seen: list[int] = []
    answer = ChainMethod.answer

    def noted(self: ChainMethod, frame: Frame) -> Answered:
        seen.append(frame.image.pixels.shape[1])
        return answer(self, frame)

    monkeypatch.setattr(ChainMethod, "answer", noted)
    options = replace(SMALL, sizes=((320, 240), (160, 120)), frames=30, methods=("tracking",))
    list(islice(run_suite(Suite.TABLE, options), 2))
    assert [(width, len(list(same))) for width, same in groupby(seen)] == [(320, 24), (160, 24), (320, 6), (160, 6)]


@pytest.mark.parametrize(
    ("busy", "stolen", "own", "quiet", "words"),
    [
        (12.0, 0.0, 11.0, True, "other processes used 0.10"),
        (18.0, 0.0, 11.0, False, "TOO LOADED to compare wall times"),
        (11.0, 6.0, 11.0, False, "the host 0.60 of"),
        (10.9, 0.0, 11.0, True, "other processes used 0.00"),
    ],
)
def test_a_loaded_machine_is_told(
    busy: float, stolen: float, own: float, quiet: bool, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    use = processor_use(ProcessorTimes(5.0, 100.0, 1.0, 2.0), ProcessorTimes(15.0, 100 + busy, 1 + stolen, 2 + own))
    assert use.own == pytest.approx(1.1) and use.seconds == 10
    assert use.quiet is quiet and words in use.described()


@pytest.mark.skipif(not Path("/proc/stat").is_file(), reason="Linux only")
def test_another_process_is_counted_as_another() -> None:
    code = "import time; end = time.monotonic() + 20\nwhile time.monotonic() < end: pass"
    other = subprocess.Popen([sys.executable, "-c", code], start_new_session=True)
    try:
        time.sleep(0.2)
        before = processor_times()
        time.sleep(1.0)
        after = processor_times()
    finally:
        other.kill()
        other.wait()
    assert before is not None and after is not None
    use = processor_use(before, after)
    assert use.others > 0.3 and use.own < 0.3


@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="Linux only")
def test_memory_of_a_method() -> None:
    orb = peak_memory("ORB", 320, 240)
    assert 40 < orb.imports_mb < orb.peak_mb < 1000
    assert resident_mb() > 20
    with pytest.raises(ParameterError, match="method: 'surf'; need"):
        peak_memory("surf", 320, 240)
