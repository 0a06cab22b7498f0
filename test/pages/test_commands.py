# SPDX-License-Identifier: Apache-2.0
"""Every command on every page runs, or its page says why not."""

from __future__ import annotations

import csv
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from page_blocks import PAGES, ROOT, blocks, commands

#: Why a block may be left out, as the comments before blocks begin.
REASONS = (
    "installs from the package index",
    "needs a camera",
    "needs a display",
    "needs a webcam",
    "needs Docker",
    "needs ROS 2 from apt",
    "needs several hosts",
    "needs the extra view",
    "takes minutes",
    "works on the repository",
)
#: Pages whose blocks are terminals beside one another: test/ros/test_live_pages.py runs them.
LIVE = ("docs/how-to/live.md", "docs/tutorials/live-camera.md")
RUN = [page for page in PAGES if page not in LIVE and any(not block.reason for block in commands(page))]
#: What a page makes, so that it is not among its inputs.
MADE = {"docs/calibrate.md": "camera.yaml"}
#: What the commands of a page leave, where that is more than an exit code.
LEFT = {
    "README.md": ("imgu_demo/replay/report.html", "results/poses_poster.tum", "check.html", "poster.pdf", "tag.pdf"),
    "docs/tutorials/video-of-a-poster.md": ("chessboard.pdf", "phone.yaml", "results/report.html"),
    "docs/tutorials/docking-station.md": ("tag_4.pdf", "station.yaml", "results/poses_station.tum"),
}


def environment(place: Path) -> dict[str, str]:
    """Return the variables of a reader whose environment is this one."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    return {**os.environ, "PATH": path, "HOME": str(place), "PYTHONPATH": str(ROOT)}


@pytest.mark.soak
@pytest.mark.timeout(300)
@pytest.mark.parametrize("page", RUN)
def test_commands_run(page: str, workplace: Path) -> None:
    if page in MADE:
        (workplace / MADE[page]).unlink()
    script = "\n".join(["set -euo pipefail", *(block.text for block in commands(page) if not block.reason)])
    done = subprocess.run(
        ["bash", "-c", script],
        cwd=workplace,
        env=environment(workplace),
        capture_output=True,
        text=True,
        timeout=280,
    )
    assert done.returncode == 0, f"{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
    for name in LEFT.get(page, ()):
        assert (workplace / name).stat().st_size > 0, name
    for frames in workplace.glob("results*/frames.csv"):
        with frames.open(newline="") as file:
            rows = list(csv.DictReader(file))
        assert sum(row["pose_status"] == "metric" for row in rows) >= 0.9 * len(rows) > 0, frames


@pytest.mark.soak
def test_the_library_page_runs(workplace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import numpy as np

    monkeypatch.chdir(workplace)
    src = np.random.default_rng(0).uniform(0, 100, (40, 2))
    names = {"src": src, "dst": 2 * src + 3}
    (code,) = [block.text for block in blocks("docs/how-to/library.md") if block.language == "python"]
    exec(code, names)
    H = names["H"] / names["H"][2, 2]
    assert np.allclose(H, [[2, 0, 3], [0, 2, 3], [0, 0, 1]], atol=1e-6)
    assert (workplace / "picture.png").exists()


def test_pages_have_commands() -> None:
    assert {"README.md", "docs/tutorials/video-of-a-poster.md", "docs/good-targets.md"} <= set(RUN)
    assert all(any(not block.reason for block in commands(page)) for page in LIVE)


@pytest.mark.parametrize("page", PAGES)
def test_what_is_not_run_says_why(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    marked = [block.reason for block in blocks(page) if block.reason]
    assert len(re.findall("^ *<!-- not run:", text, re.MULTILINE)) == len(marked), "a comment that belongs to no block"
    for reason in marked:
        assert reason.startswith(REASONS), reason


def test_few_are_not_run() -> None:
    everything = [block for page in PAGES for block in commands(page)]
    left_out = [block for block in everything if block.reason and not block.reason.startswith("takes minutes")]
    assert len(left_out) <= 24, [(block.page, block.reason) for block in left_out]


@pytest.mark.parametrize("page", PAGES)
def test_options_of_benchmarks_exist(page: str) -> None:
    """Benchmarks take minutes to hours: their options are at least in their source."""
    for block in commands(page):
        text = block.text.replace("\\\n", " ")
        for script, rest in re.findall(r"^python (benchmarks/\w+\.py)(.*)$", text, re.MULTILINE):
            source = (ROOT / script).read_text(encoding="utf-8")
            for option in re.findall(r"(?<!\S)--[a-z-]+", rest.partition("#")[0]):
                assert f'"{option}"' in source, f"{script} {option}"
