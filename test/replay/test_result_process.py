# SPDX-License-Identifier: Apache-2.0
"""Results written by another process are those that a thread writes, and whatever ends either, files are whole."""

from __future__ import annotations

import csv
import io
import json
import os
import pickle
import re
import signal
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from imgu_ros.bags.reading import open_bag
from imgu_ros.config.components import RecordedFramesParameters
from imgu_ros.config.files import read_parameter_file
from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import BagError, FileError
from imgu_ros.files.target_images import load_target_images
from imgu_ros.localizer import Localizer
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.replay import result_process, result_sink
from imgu_ros.replay.frame_source import FrameSource
from imgu_ros.replay.output_folder import output_folder
from imgu_ros.replay.recording import record_simulation
from imgu_ros.replay.replay import replay
from imgu_ros.replay.result_files import ReplayOutput, ResultItem, replay_contents
from imgu_ros.replay.result_process import ResultProcess, serve
from imgu_ros.replay.result_sink import ResultThread
from imgu_ros.simulate.sequence import Simulation
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.stop_signals import Stopped, held, stop_signals

FRAMES = 40


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("simulated") / "bag"
    poster = TargetImage("poster", procedural_texture(640, 480), 0.5)
    record_simulation(path, Simulation(width=320, height=240, frames=FRAMES), targets=[poster])
    return path


@pytest.fixture(scope="module")
def parameters(bag: Path) -> Parameters:
    return parameters_from(read_parameter_file(bag / "params.yaml"))


@pytest.fixture
def written(bag: Path, parameters: Parameters) -> list[ResultItem]:
    """Three frames' results."""
    chain = Localizer(parameters, prepare_references(load_target_images(parameters.targets), parameters))
    with open_bag([bag]) as source:
        frames = FrameSource(source, RecordedFramesParameters.of(parameters)).frames()
        return [ResultItem(chain.process(next(frames).frame), index) for index in range(3)]


@pytest.fixture
def in_a_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(result_sink, "_MIN_FRAMES_FOR_PROCESS", 1)
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1})


@contextmanager
def files(out: Path, parameters: Parameters, record: tuple[str, ...] = ()) -> Iterator[ReplayOutput]:
    with output_folder(out, replay_contents(["poster"]), overwrite=False) as folder:
        yield ReplayOutput(folder, parameters, ("poster",), record, FRAMES)


def untimed(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return [{k: v for k, v in row.items() if not k.startswith("t_")} for row in csv.DictReader(file)]


def messages(out: Path) -> list[tuple[str, int, bytes]]:
    with open_bag([out / "results"]) as bag:
        assert bag.warnings == ()
        # What `status` says of times differs.
        return [
            (raw.channel.topic, raw.time_ns, bytes(raw.data))
            for raw in bag.raw_messages()
            if raw.channel.topic != "/status"
        ]


def test_the_same_files(
    bag: Path, parameters: Parameters, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, in_a_process: None
) -> None:
    one, other = tmp_path / "process", tmp_path / "thread"
    in_process = replay([bag], one, parameters, truth=bag / "truth.csv")
    monkeypatch.setattr(result_sink, "_MIN_FRAMES_FOR_PROCESS", FRAMES + 1)
    in_thread = replay([bag], other, parameters, truth=bag / "truth.csv")
    assert sorted(path.name for path in one.iterdir()) == sorted(path.name for path in other.iterdir())
    assert untimed(one / "frames.csv") == untimed(other / "frames.csv")
    for name in ("poses_poster.tum", "ambiguous.csv"):
        assert (one / name).read_bytes() == (other / name).read_bytes()
    assert messages(one) == messages(other)
    assert in_process.targets == in_thread.targets
    summaries = [json.loads((out / "summary.json").read_text()) for out in (one, other)]
    assert summaries[0]["parameters"] == summaries[1]["parameters"]
    assert summaries[0]["source"] == summaries[1]["source"]
    # The drawn frames do not tell times.
    pictures = [re.findall('"jpeg": "([^"]*)"', (out / "report.html").read_text()) for out in (one, other)]
    assert len(pictures[0]) == FRAMES
    assert pictures[0] == pictures[1]


def chosen(tmp_path: Path, parameters: Parameters, record: tuple[str, ...] = ()) -> type[result_sink.ResultSink]:
    with files(tmp_path, parameters, record) as described, result_sink.result_sink(described) as sink:
        return type(sink)


def test_what_is_chosen(tmp_path: Path, parameters: Parameters) -> None:
    assert chosen(tmp_path, parameters) is ResultThread


def test_without_another_process_a_thread_does_it(
    monkeypatch: pytest.MonkeyPatch, in_a_process: None, tmp_path: Path, parameters: Parameters
) -> None:
    def refused(*_: object, **__: object) -> None:
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(subprocess, "Popen", refused)
    assert chosen(tmp_path, parameters) is ResultThread


def test_pictures_are_recorded_by_a_thread(in_a_process: None, tmp_path: Path, parameters: Parameters) -> None:
    assert chosen(tmp_path, parameters, ("debug_image",)) is ResultThread


def test_an_interrupt_leaves_whole_files(bag: Path, parameters: Parameters, tmp_path: Path, in_a_process: None) -> None:
    def on_progress(done: int, total: int | None) -> None:
        if done == 21:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        replay([bag], tmp_path / "out", parameters, on_progress=on_progress)
    rows = untimed(tmp_path / "out" / "frames.csv")
    assert len(rows) == 21
    assert len((tmp_path / "out" / "poses_poster.tum").read_text().splitlines()) == sum(1 for r in rows if r["tx"])
    assert len({time_ns for _, time_ns, _ in messages(tmp_path / "out")}) == 21
    assert not (tmp_path / "out" / "report.html").exists()


def test_an_error_before_the_first_frame_ends_the_process(tmp_path: Path, parameters: Parameters) -> None:
    with files(tmp_path, parameters) as described:
        sink = ResultProcess(described)
        with pytest.raises(ZeroDivisionError), sink:
            raise ZeroDivisionError
    assert sink._process.returncode == 0


def test_what_the_process_cannot_write_is_raised(
    parameters: Parameters, written: list[ResultItem], tmp_path: Path
) -> None:
    with files(tmp_path, parameters) as described:
        (tmp_path / "results.part").touch()
        with pytest.raises(FileError, match=r"results\.part: File exists"), ResultProcess(described) as sink:
            for item in written:
                sink.put(item)


def test_a_process_that_is_killed_is_told_of(parameters: Parameters, written: list[ResultItem], tmp_path: Path) -> None:
    with (
        pytest.raises(BagError, match="ended early, with code -9"),
        files(tmp_path, parameters) as described,
        ResultProcess(described) as sink,
    ):
        sink._process.kill()
        sink._process.wait()
        for _ in range(400):
            sink.put(written[1])


@pytest.mark.parametrize("is_full", [True, False])
def test_a_process_that_hangs_is_ended(
    parameters: Parameters, written: list[ResultItem], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_full: bool
) -> None:
    """Its pipe is full while frames are put, or it takes everything and never completes its files."""
    monkeypatch.setattr(result_process, "_PATIENCE_S", 1.0)
    with (
        pytest.raises(BagError, match=r"took no data for 1 s and was ended"),
        files(tmp_path, parameters) as described,
        ResultProcess(described) as sink,
    ):
        sink._process.send_signal(signal.SIGSTOP)
        for _ in range(3000 if is_full else 1):
            sink.put(written[1])
    assert sink._process.returncode == -signal.SIGKILL
    assert len(untimed(tmp_path / "frames.csv")) >= 1


def test_an_interrupt_ends_a_replay_whose_process_hangs(
    parameters: Parameters, written: list[ResultItem], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether the signal comes while `put` waits, which no signal interrupts, or between two frames."""
    monkeypatch.setattr(result_process, "_PATIENCE_S", 1.0)
    with (
        stop_signals(),
        pytest.raises((BagError, Stopped)),
        files(tmp_path, parameters) as described,
        ResultProcess(described) as sink,
    ):
        sink._process.send_signal(signal.SIGSTOP)
        threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
        while True:
            with held():
                sink.put(written[1])
    assert sink._process.returncode == -signal.SIGKILL


def test_an_input_that_breaks_off_leaves_whole_files(
    parameters: Parameters, written: list[ResultItem], tmp_path: Path
) -> None:
    with files(tmp_path, parameters) as described:
        stream = pickle.dumps(described) + pickle.dumps(written) + pickle.dumps(written)[:-100]
        assert serve(io.BytesIO(stream)) is None
    assert len({time_ns for _, time_ns, _ in messages(tmp_path)}) == 3
