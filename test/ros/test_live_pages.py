# SPDX-License-Identifier: Apache-2.0
"""The pages whose blocks are terminals beside one another: with all of them at work, the listener prints poses."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")

PAGES = Path(__file__).resolve().parents[1] / "pages"
sys.path.append(str(PAGES))
import inputs  # noqa: E402
from page_blocks import blocks, commands  # noqa: E402

#: Of three processes that import rclpy, on a busy machine.
PATIENCE_S = 90.0


@pytest.fixture(scope="module")
def workplace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("live") / "reader"
    folder.mkdir()
    inputs.make(folder)
    return folder


@pytest.fixture
def terminals(environment: dict[str, str], workplace: Path) -> Iterator[list[subprocess.Popen]]:
    """Shells; each and what it started ends with the test."""
    started: list[subprocess.Popen] = []
    yield started
    for process in started:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGTERM)
    for process in started:
        try:
            process.wait(20)
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)


@pytest.mark.soak
@pytest.mark.timeout(200)
@pytest.mark.parametrize(
    ("page", "printed"), [("docs/tutorials/live-camera.md", "z is good to"), ("docs/how-to/live.md", "position")]
)
def test_poses_come_out(page, printed, environment, workplace, terminals):
    (listener,) = [block.text for block in blocks(page) if block.language == "python"]
    (workplace / "listen.py").write_text(listener)
    variables = {**environment, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    output = workplace / "printed.txt"
    run = [block.text.strip() for block in commands(page) if not block.reason]
    assert len(run) >= 3 and "listen.py" in run[0]
    with output.open("w") as file:
        for text in run:
            # A player ends with its bag; another begins where the page says a camera goes on.
            shell = f"exec {text}" if "imgu play" not in text else f"while true; do {text}; done"
            terminals.append(
                subprocess.Popen(
                    ["bash", "-c", shell], cwd=workplace, env=variables, start_new_session=True,
                    stdout=file if text == run[0] else subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                )
            )  # fmt: skip
        end = time.monotonic() + PATIENCE_S
        while printed not in output.read_text():
            assert time.monotonic() < end, "no pose"
            assert all(process.poll() is None for process in terminals), "a terminal ended"
            time.sleep(0.1)
