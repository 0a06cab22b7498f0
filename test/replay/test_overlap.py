# SPDX-License-Identifier: Apache-2.0
"""A replay whose stages overlap says what one frame after the other says, and ends whole whatever ends it."""

from __future__ import annotations

import csv
import os
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import cv2
import pytest

from imgu_ros.bags.reading import open_bag
from imgu_ros.cli.main import main
from imgu_ros.config.components import RecordedFramesParameters
from imgu_ros.config.files import read_parameter_file
from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import BagError
from imgu_ros.files.frames_csv import FramesWriter
from imgu_ros.files.target_images import load_target_images
from imgu_ros.localizer import Localizer
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.replay.frame_source import FrameSource
from imgu_ros.replay.recording import record_simulation
from imgu_ros.replay.replay import replay
from imgu_ros.simulate.sequence import Simulation
from imgu_ros.simulate.texture import procedural_texture

FRAMES = 12


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("simulated") / "bag"
    poster = TargetImage("poster", procedural_texture(640, 480), 0.5)
    record_simulation(path, Simulation(width=320, height=240, frames=FRAMES), targets=[poster])
    return path


@pytest.fixture(scope="module")
def parameters(bag: Path) -> Parameters:
    return parameters_from(read_parameter_file(bag / "params.yaml"))


@pytest.fixture(autouse=True)
def _no_report(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imgu_ros.replay.reporting.write_report", lambda path, *_: path.touch())


def untimed(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return [{k: v for k, v in row.items() if not k.startswith("t_")} for row in csv.DictReader(file)]


def own_threads() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name in ("prefetch", "background")]


def assert_whole(out: Path, least: int) -> None:
    """All files hold the same frames, from the first on, at least so many; none is cut."""
    rows = untimed(out / "frames.csv")
    stamps = [int(row["stamp_ns"]) for row in rows]
    assert len(rows) >= least
    assert (out / "frames.csv").read_text().endswith("\n")
    poses = (out / "poses_poster.tum").read_text().splitlines()
    assert len(poses) == sum(1 for row in rows if row["tx"])
    with open_bag([out / "results"]) as results:
        statuses = [m.message.header.stamp for m in results.messages(["/status"])]
        assert results.warnings == ()
    assert [s.sec * 10**9 + s.nanosec for s in statuses] == stamps


def test_the_same_as_one_frame_after_the_other(bag: Path, parameters: Parameters, tmp_path: Path) -> None:
    threads = cv2.getNumThreads()
    replay([bag], tmp_path / "out", parameters)
    assert cv2.getNumThreads() == threads
    chain = Localizer(parameters, prepare_references(load_target_images(parameters.targets), parameters))
    with open_bag([bag]) as source, FramesWriter(tmp_path / "serial.csv") as serial:
        for recorded in FrameSource(source, RecordedFramesParameters.of(parameters)).frames():
            serial.write(chain.process(recorded.frame))
    assert untimed(tmp_path / "out" / "frames.csv") == untimed(tmp_path / "serial.csv")
    assert len(untimed(tmp_path / "serial.csv")) == FRAMES
    assert own_threads() == []
    assert sys.getswitchinterval() == pytest.approx(0.005)


def interrupting(error: BaseException, after: int) -> Callable[[int, int | None], None]:
    def on_progress(done: int, total: int | None) -> None:
        assert total == FRAMES
        if done == after:
            raise error

    return on_progress


@pytest.mark.parametrize("error", [KeyboardInterrupt(), RuntimeError("in the middle")])
def test_an_interrupt_leaves_whole_files(
    bag: Path, parameters: Parameters, tmp_path: Path, error: BaseException
) -> None:
    with pytest.raises(type(error)):
        replay([bag], tmp_path / "out", parameters, on_progress=interrupting(error, 5))
    assert len(untimed(tmp_path / "out" / "frames.csv")) == 5
    assert_whole(tmp_path / "out", 5)
    assert own_threads() == []
    assert sys.getswitchinterval() == pytest.approx(0.005)


def test_an_error_of_the_chain_leaves_whole_files(
    bag: Path, parameters: Parameters, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    process, frames = Localizer.process, iter(range(FRAMES))

    def failing(*arguments: object, **named: object) -> object:
        if next(frames) == 7:
            raise MemoryError("frame 7")
        return process(*arguments, **named)

    monkeypatch.setattr(Localizer, "process", failing)
    with pytest.raises(MemoryError, match="frame 7"):
        replay([bag], tmp_path / "out", parameters)
    assert_whole(tmp_path / "out", 7)
    assert own_threads() == []


@pytest.mark.parametrize("when", [3, FRAMES - 1])
def test_an_error_of_the_writer_ends_the_replay(
    bag: Path, parameters: Parameters, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, when: int
) -> None:
    write, frames = FramesWriter.write, iter(range(FRAMES))

    def failing(self: FramesWriter, result: object) -> None:
        if next(frames) == when:
            raise OSError(28, "No space left on device")
        write(self, result)  # type: ignore[arg-type]

    monkeypatch.setattr(FramesWriter, "write", failing)
    with pytest.raises(OSError, match="No space"):
        replay([bag], tmp_path / "out", parameters)
    assert len(untimed(tmp_path / "out" / "frames.csv")) == when
    assert own_threads() == []


def test_an_error_of_the_reader_comes_after_the_frames_before_it(
    bag: Path, parameters: Parameters, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = FrameSource.frames

    def failing(self: FrameSource) -> object:
        for index, frame in enumerate(frames(self)):
            if index == 6:
                raise BagError("the disk is gone")
            yield frame

    monkeypatch.setattr(FrameSource, "frames", failing)
    with pytest.raises(BagError, match="the disk is gone"):
        replay([bag], tmp_path / "out", parameters)
    assert_whole(tmp_path / "out", 6)
    assert len(untimed(tmp_path / "out" / "frames.csv")) == 6
    assert own_threads() == []


def test_ctrl_c_ends_the_command(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    process, frames = Localizer.process, iter(range(FRAMES))

    def interrupted(*arguments: object, **named: object) -> object:
        if next(frames) == 4:
            os.kill(os.getpid(), signal.SIGINT)
        return process(*arguments, **named)

    monkeypatch.setattr(Localizer, "process", interrupted)
    argv = ["replay", str(bag), "--params-file", str(bag / "params.yaml"), "--out", str(tmp_path / "out")]
    # A shell starts what runs in the background with the signal ignored, and Python leaves that so.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        assert main(argv) == 130
    finally:
        signal.signal(signal.SIGINT, before)
    assert capsys.readouterr().err == "imgu: interrupted\n"
    assert_whole(tmp_path / "out", 4)
    assert own_threads() == []
