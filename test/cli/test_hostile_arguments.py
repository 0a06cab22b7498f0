# SPDX-License-Identifier: Apache-2.0
"""Names and numbers that people and programs give to commands: whatever they are, one line, and no traceback.

Each command runs in a process of its own that has been made by a fork: its memory and its time are bounded.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import os
import re
import resource
import select
import signal
import socket
import sys
import time
import traceback
import unicodedata
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from imgu_ros.cli.main import COMMANDS, main
from imgu_ros.file_access import bounded_reading as reading

BOUND_S = 60.0
MEMORY = 6 << 30
Run = Callable[..., tuple[int, str]]

#: A command for each place where a name of a file to read stands.
READS = (
    "replay {} --out OUT",
    "replay missing --truth {} --out OUT -p targets.images:=[good.png]",
    "replay missing --params-file {} --out OUT",
    "view {} --foxglove",
    "match {} good.png",
    "match good.png {}",
    "match good.png good.png --camera-info {}",
    "demosaic {} OUT.png --pattern rggb --width 64 --height 64 --dtype uint8",
    "warp {} OUT.png --scale 0.5",
    "calibrate {} --board 9x6 --square 0.02 --out OUT.yaml",
    "params --yaml --params-file {}",
    "params {}",
    "simulate --out OUT --frames 1 --size 64x64 --template {}",
    "node {}",
    "{}",
)
WRITES = (
    "replay missing --out {} -p targets.images:=[good.png]",
    "simulate --frames 1 --size 64x64 --out {}",
    "match good.png good.png --json {}",
    "match good.png good.png --warp {}.png",
    "warp good.png {}.png --scale 0.5",
)
NUMBERS = (
    "simulate --out OUT --size 64x64 --frames={}",
    "simulate --out OUT --size 64x64 --frames 1 --seed={}",
    "simulate --out OUT --frames 1 --size={0}x{0}",
    "simulate --out OUT --frames 1 --size 64x64 --rate={}",
    "simulate --out OUT --frames 1 --size 64x64 --row-padding={}",
    "simulate --out OUT --frames 1 --size 64x64 --ev={}",
    "demo --out OUT --frames={}",
    "match good.png good.png --width-m={}",
    "calibrate missing --board 9x6 --square={} --out OUT.yaml",
    "calibrate missing --board 9x6 --square 1 --out OUT.yaml --max-views={}",
    "bench --suite negatives --sizes={0}x{0} --negatives 1",
    "bench --suite tracking --sizes 320x240 --frames={}",
    "warp good.png OUT.png --scale={}",
    "warp good.png OUT.png --whole --scale={}",
    "warp good.png OUT.png --scale 0.5 --size={0}x{0}",
    "filter good.png OUT.png --method mean --size={}",
    "filter good.png OUT.png --method gaussian --sigma={}",
    "demosaic raw OUT.png --pattern rggb --dtype uint8 --width={} --height 64",
    "match good.png good.png -p seed:={}",
    "match good.png good.png -p homography.threshold_px:={}",
    "match good.png good.png -p raw.gains:=[{},1,1]",
)
STRANGE = (
    "loop", "loop/x", "folder", "missing", "pipe", "text/x", "/dev/zero", "/proc/self/mem", "a" * 300, "x\x1b\n\u202e",
    "", "half\ud800", "nul\0", "caf\udce9\x1b\n.png",
)  # fmt: skip
PLACES = ("loop/x", "missing/x", "text/x", "a" * 300, "nul\0", "x\x1b\n\udce9/y")
SIZES = ("1" + "0" * 400, "9" * 5000, "1e999", "nan", "\u0663x", str(2**63), "1\x1b[31m", "1" * 70000)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Return what runs a command and gives its exit code and what it said."""
    place = tmp_path_factory.mktemp("strange")
    for module in COMMANDS.values():
        importlib.import_module(module)
    for module in (
        "replay.replay",
        "replay.recording",
        "localizer",
        "report.overlay",
        "cli.board_views",
        "bench.suites",
    ):
        importlib.import_module(f"imgu_ros.{module}")
    noise = np.random.default_rng(0).integers(0, 255, (120, 160, 3), np.uint8)
    data = cv2.imencode(".png", noise)[1].tobytes()
    for name in ("good.png", "caf\udce9\x1b\n.png", " sp \"q'.png", "=x.png", "g" * 251 + ".png"):
        (place / name).write_bytes(data)
    (place / "raw").write_bytes(bytes(4096))
    (place / "text").write_text("hello: [world\n")
    (place / "empty").touch()
    (place / "folder").mkdir()
    (place / "loop").symlink_to("loop")
    (place / "dangling").symlink_to("nowhere")
    os.mkfifo(place / "pipe")
    with socket.socket(socket.AF_UNIX) as bound, contextlib.chdir(place):
        bound.bind("socket")

    def run_one(argv: list[str], bound_s: float = BOUND_S) -> tuple[int, str]:
        said, saying = os.pipe()
        child = os.fork()
        if not child:
            _become(place, saying, argv)
        os.close(saying)
        with open(said, "rb") as stream:
            text = _read(stream.fileno(), time.monotonic() + bound_s)
        if text is None:
            os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        assert text is not None, f"{argv}: still at work after {bound_s} s"
        return os.waitstatus_to_exitcode(status), text.decode(errors="surrogateescape")

    cv2.setNumThreads(0)  # threads do not live on in a fork
    gc.freeze()  # what is never looked at is never copied
    return run_one


def _become(place: Path, saying: int, argv: list[str]) -> None:
    code = 99
    try:
        os.chdir(place)
        reading._PATIENCE_S = 0.1
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        for descriptor in (1, 2):
            os.dup2(saying, descriptor)
        sys.stdout, sys.stderr = (os.fdopen(descriptor, "w", closefd=False) for descriptor in (1, 2))
        code = main(argv)
        sys.stdout.flush()
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(code)


def _read(descriptor: int, end: float) -> bytes | None:
    text = b""
    while True:
        left = end - time.monotonic()
        if left <= 0 or not select.select([descriptor], [], [], left)[0]:
            return None
        piece = os.read(descriptor, 1 << 16)
        if not piece:
            return text
        text += piece


def check(run: Run, command: str, value: str) -> None:
    argv = [part.format(value) for part in command.split(" ")]
    code, said = run(argv)
    where = f"{argv!r:.300}\n{said[-600:]}"
    assert code in (0, 1, 2), f"exit code {code}: {where}"
    assert "Traceback" not in said, where
    assert not code or re.search(r"^imgu( \w+)?: error: ", said, re.MULTILINE), where
    for line in said.split("\n"):
        assert len(line) <= 2100, where
        # \r of a progress bar is no part of what is piped.
        assert not [c for c in line if unicodedata.category(c) in ("Cc", "Cs") or c == "\u202e"], where


@pytest.mark.parametrize("command", READS)
def test_names_of_files_to_read(run: Run, command: str) -> None:
    for value in STRANGE:
        check(run, command, value)


@pytest.mark.parametrize("command", WRITES)
def test_names_of_files_to_write(run: Run, command: str) -> None:
    for value in (
        "loop",
        "loop/x",
        "missing/x",
        "text/x",
        "/dev/null/x",
        "/proc/self/x",
        "a" * 300,
        "nul\0",
        "x\x1b\n\udce9/y",
    ):
        check(run, command, value)


@pytest.mark.parametrize("command", NUMBERS)
def test_numbers_of_any_size(run: Run, command: str) -> None:
    for value in SIZES:
        check(run, command, value)
