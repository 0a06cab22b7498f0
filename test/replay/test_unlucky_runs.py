# SPDX-License-Identifier: Apache-2.0
"""Runs that end early: stopped, killed, on a full disk, without their folder. What they leave is whole."""

from __future__ import annotations

import csv
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from imgu_ros.bags.reading import open_bag
from imgu_ros.cli import progress
from imgu_ros.cli.main import main
from imgu_ros.config.files import read_parameter_file
from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import FileError
from imgu_ros.files.frames_csv import COLUMNS
from imgu_ros.reference.templates import TargetImage
from imgu_ros.replay import result_sink
from imgu_ros.replay.output_folder import check_output_folder
from imgu_ros.replay.recording import record_simulation
from imgu_ros.replay.replay import replay
from imgu_ros.replay.result_files import replay_contents
from imgu_ros.simulate.sequence import Simulation
from imgu_ros.simulate.texture import procedural_texture

FRAMES, LAST = 30, 12

#: Replays with a process that writes, and calls what is in an argument after every frame.
SCRIPT = """
import os, signal, sys
from pathlib import Path
from imgu_ros.replay import result_sink
from imgu_ros.cli import main, progress
result_sink._MIN_FRAMES_FOR_PROCESS, os.sched_getaffinity = 1, lambda pid: {0, 1}

def children():
    return [int(pid) for pid in Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()]

def on_progress(self, done, total):
    exec(sys.argv[2])
progress.Progress.__call__ = on_progress
exec(sys.argv[3])
sys.exit(main.main(["replay", sys.argv[1], "--params-file", sys.argv[1] + "/params.yaml", "--out", "out"]))
"""


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("simulated") / "bag"
    poster = TargetImage("poster", procedural_texture(320, 240), 0.5)
    record_simulation(path, Simulation(width=160, height=120, frames=FRAMES), targets=[poster])
    return path


@pytest.fixture(scope="module")
def parameters(bag: Path) -> Parameters:
    return parameters_from(read_parameter_file(bag / "params.yaml"))


@pytest.fixture
def after_frame(monkeypatch: pytest.MonkeyPatch):
    """Have a function called once, after frame `LAST`."""

    def install(function) -> None:
        def on_progress(self: progress.Progress, done: int, total: int | None) -> None:
            if done == LAST:
                function()

        monkeypatch.setattr(progress.Progress, "__call__", on_progress)

    return install


def rows(out: Path) -> int:
    """The rows of frames.csv, all of which are whole."""
    text = (out / "frames.csv").read_text()
    assert text.endswith("\n")
    lines = list(csv.reader(text.splitlines()))
    assert tuple(lines[0]) == COLUMNS
    assert {len(line) for line in lines} == {len(COLUMNS)}
    return len(lines) - 1


def frames_of(bag: Path) -> int:
    with open_bag([bag]) as source:
        assert source.warnings == ()
        return len({raw.time_ns for raw in source.raw_messages()})


def visible(out: Path) -> set[str]:
    return {path.name for path in out.iterdir() if path.name not in (".imgu_lock", ".imgu_files.json")}


STOPPED = {"frames.csv", "ambiguous.csv", "poses_poster.tum", "results"}


@pytest.mark.parametrize(
    ("number", "code", "said"),
    [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated"), (signal.SIGHUP, 129, "hung up")],
)
def test_a_signal_stops_a_replay_with_whole_files(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after_frame, capsys, number: int, code: int, said: str
) -> None:
    from imgu_ros.bags.compression import zstd

    packed = tmp_path / "bag.mcap.zstd"
    packed.write_bytes(zstd.compress((bag / "bag.mcap").read_bytes()))
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    seen = []

    def stop() -> None:
        seen.extend((tmp_path / "temporary").iterdir())
        os.kill(os.getpid(), number)

    after_frame(stop)
    out = tmp_path / "out"
    assert main(["replay", str(packed), "--params-file", str(bag / "params.yaml"), "--out", str(out)]) == code
    assert capsys.readouterr().err == f"imgu: {said}\n"
    assert visible(out) == STOPPED
    assert rows(out) == frames_of(out / "results") == LAST
    assert len(seen) == 1
    assert not list((tmp_path / "temporary").iterdir())
    check_output_folder(out, replay_contents(["poster"]), overwrite=True)


def run(bag: Path, tmp_path: Path, code: str, before: str = "") -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", SCRIPT, str(bag), code, before]
    return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)


def wait_for_the_other(out: Path) -> None:
    """The process that writes the bag outlives the one that was killed by a moment."""
    deadline = time.monotonic() + 60
    while True:
        try:
            check_output_folder(out, replay_contents(["poster"]), overwrite=True)
        except FileError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.05)
        else:
            return


def test_a_signal_to_all_processes_stops_a_replay_with_whole_files(bag: Path, tmp_path: Path) -> None:
    code = f"if done == {LAST}: [os.kill(pid, signal.SIGTERM) for _ in (1, 2) for pid in (*children(), os.getpid())]"
    done = run(bag, tmp_path, code)
    assert (done.returncode, done.stderr) == (143, "imgu: terminated\n")
    assert visible(tmp_path / "out") == STOPPED
    assert rows(tmp_path / "out") == frames_of(tmp_path / "out" / "results") == LAST


def test_a_replay_that_is_killed_has_every_row(bag: Path, tmp_path: Path) -> None:
    done = run(bag, tmp_path, f"if done == {LAST}: os.kill(os.getpid(), signal.SIGKILL)")
    assert done.returncode == -signal.SIGKILL
    out = tmp_path / "out"
    wait_for_the_other(out)
    assert rows(out) == LAST
    assert visible(out) == STOPPED
    # Whole, with what had reached its process: on a slow machine that may just have started.
    assert frames_of(out / "results") <= LAST


def test_a_replay_whose_processes_are_all_killed_has_every_row_and_can_be_replaced(
    bag: Path, parameters: Parameters, tmp_path: Path
) -> None:
    code = f"if done == {LAST}: [os.kill(pid, signal.SIGKILL) for pid in (*children(), os.getpid())]"
    assert run(bag, tmp_path, code).returncode == -signal.SIGKILL
    out = tmp_path / "out"
    assert rows(out) == LAST
    assert visible(out) <= STOPPED - {"results"} | {"results.part"}
    (out / "mine").write_text("mine")
    replay([bag], out, parameters, overwrite=True)
    assert visible(out) == STOPPED | {"mine", "report.html", "summary.json"}
    assert rows(out) == FRAMES


@pytest.mark.parametrize("in_a_process", [False, True])
def test_rows_are_there_before_the_next_frame(
    bag: Path, parameters: Parameters, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, in_a_process: bool
) -> None:
    if in_a_process:
        monkeypatch.setattr(result_sink, "_MIN_FRAMES_FOR_PROCESS", 1)
        monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1})
    out = tmp_path / "out"

    def on_progress(done: int, total: int | None) -> None:
        deadline = time.monotonic() + 20
        while rows(out) < done:  # a thread may need a moment
            assert not in_a_process
            assert time.monotonic() < deadline
            time.sleep(0.001)
        assert not (out / "summary.json").exists()
        assert not (out / "results").exists()

    replay([bag], out, parameters, on_progress=on_progress)
    assert (out / "summary.json").stat().st_mtime_ns >= (out / "report.html").stat().st_mtime_ns


@pytest.mark.parametrize("limit", [5_000, 20_000])
def test_a_full_disk_is_one_line(bag: Path, tmp_path: Path, limit: int) -> None:
    """Of a limit on the size of files, which acts as a full disk: the tables, or the bag, cannot grow."""
    code = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))"
    done = run(bag, tmp_path, "", code)
    assert done.returncode == 1
    assert re.fullmatch(r"imgu: error: [^\n]*File too large[^\n]*\n", done.stderr)
    out = tmp_path / "out"
    assert visible(out) <= STOPPED - {"results"} | {"results.part"}
    assert rows(out) <= FRAMES


def test_a_folder_that_is_removed_is_one_line(bag: Path, tmp_path: Path, after_frame, capsys) -> None:
    out = tmp_path / "out"
    after_frame(lambda: (shutil.rmtree(out), time.sleep(0.6)))
    assert main(["replay", str(bag), "--params-file", str(bag / "params.yaml"), "--out", str(out)]) == 1
    assert re.fullmatch(r"imgu: error: [^\n]*/out: No such file[^\n]*\n", capsys.readouterr().err)
    assert not out.exists()


def test_a_second_replay_into_the_folder_is_refused(bag: Path, parameters: Parameters, tmp_path: Path) -> None:
    out, refused = tmp_path / "out", []

    def on_progress(done: int, total: int | None) -> None:
        if done == LAST:
            with pytest.raises(FileError, match="another run writes there") as error:
                replay([bag], out, parameters, overwrite=True)
            refused.append(str(error.value))

    replay([bag], out, parameters, on_progress=on_progress)
    assert len(refused) == 1
    assert rows(out) == FRAMES


def test_an_interrupted_simulation_is_no_bag(tmp_path: Path, after_frame, capsys) -> None:
    after_frame(lambda: os.kill(os.getpid(), signal.SIGTERM))
    out = tmp_path / "bag"
    arguments = ["simulate", "--out", str(out), "--size", "64x48", "--frames", "20"]
    assert main(arguments) == 143
    assert capsys.readouterr().err == "imgu: terminated\n"
    assert visible(out) == {"poster.png", "params.yaml", "bag.part"}
    assert frames_of(out / "bag.part" / "bag") == LAST
    assert main([*arguments, "--overwrite", "--seed", "1"]) == 143
    after_frame(lambda: None)
    assert main([*arguments, "--overwrite"]) == 0
    assert visible(out) == {"poster.png", "params.yaml", "truth.csv", "exposure.csv", "bag.mcap", "metadata.yaml"}
