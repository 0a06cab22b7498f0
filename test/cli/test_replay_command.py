# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

from imgu_ros.bags.messages import make_message
from imgu_ros.bags.writing import BagWriter
from imgu_ros.cli.main import main
from imgu_ros.image_files.images import write_image
from imgu_ros.reference.templates import TargetImage
from imgu_ros.replay.recording import record_simulation
from imgu_ros.simulate.sequence import Simulation
from imgu_ros.simulate.texture import procedural_texture


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A good bag, and everything that can be wrong with a command's input."""
    root = tmp_path_factory.mktemp("inputs")
    poster = TargetImage("poster", procedural_texture(640, 480), 0.5)
    record_simulation(root / "good", Simulation(width=320, height=240, frames=2), targets=[poster])
    (root / "random.bag").write_bytes(np.random.default_rng(0).bytes(10_000))
    (root / "empty.mcap").touch()
    (root / "empty_folder").mkdir()
    with BagWriter(root / "no_messages"):
        pass
    with BagWriter(root / "no_image") as writer:
        writer.write("/chatter", make_message("std_msgs/msg/String", data="hello"), 1)
    (root / "random.png").write_bytes(b"not an image" * 100)
    write_image(root / "blank.png", np.full((200, 300, 3), 200, np.uint8))
    (root / "bad_truth.csv").write_text("a,b\n1,2\n")
    (root / "full").mkdir()
    (root / "full" / "something").touch()
    (root / "a_file").touch()
    return root


BAD = {
    "no such bag": (["nowhere"], "nowhere"),
    "random bytes": (["random.bag"], "random.bag"),
    "empty file": (["empty.mcap"], "empty.mcap"),
    "empty folder": (["empty_folder"], "empty_folder"),
    "empty bag": (["no_messages"], "no image topic"),
    "no image topic": (["no_image"], "no image topic among /chatter"),
    "no such topic": (["good", "-p", "image_topic:=/camera/image_rav"], "/camera/image_raw"),
    "target missing": (["good", "-p", "targets.images:=[gone.png]"], "gone.png"),
    "target no image": (["good", "-p", "targets.images:=[random.png]"], "random.png"),
    "target blank": (["good", "-p", "targets.images:=[blank.png]", "-p", "targets.names:=[blank]"], "blank"),
    "no target": (["good", "-p", "targets.images:=[]"], "targets"),
    "out of range": (["good", "-p", "matching.ratio:=3.0"], "matching.ratio: 3.0; need 0.1 to 1"),
    "wrong type": (["good", "-p", "seed:=1.5"], "seed: 1.5 (float); need an integer"),
    "unknown": (["good", "-p", "matching.ration:=0.5"], "nearest known: matching.ratio"),
    "no parameter file": (["good", "--params-file", "gone.yaml"], "gone.yaml"),
    "output not empty": (["good", "--out", "full"], "not empty"),
    "output is a file": (["good", "--out", "a_file"], "a_file: not a folder"),
    "output below a file": (["good", "--out", "a_file/out"], "a_file/out"),
    "output not writable": (["good", "--out", "/proc/imgu_out"], "/proc/imgu_out"),
    "truth missing": (["good", "--truth", "gone.csv"], "gone.csv"),
    "truth bad": (["good", "--truth", "bad_truth.csv"], "bad_truth.csv"),
    "no such output": (["good", "--record", "key_points"], "nearest: keypoints"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_one_line(
    name: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    argv, said = BAD[name]
    out = [] if "--out" in argv else ["--out", str(tmp_path / "out")]
    # A list without values replaces none: rcl cannot tell its type.
    file = [] if name == "no target" else ["--params-file", "good/params.yaml"]
    assert main(["replay", argv[0], *file, *out, *argv[1:]]) == 1
    captured = capsys.readouterr()
    errors = [line for line in captured.err.splitlines() if not line.startswith("imgu: warning: ")]
    assert len(errors) == 1
    assert errors[0].startswith("imgu: error: ")
    assert said in errors[0]
    assert captured.out == ""
    assert not (tmp_path / "out").exists()


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes everywhere")
def test_a_folder_without_permission(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "locked").mkdir(mode=0o500)
    argv = ["replay", str(folder / "good"), "--params-file", str(folder / "good" / "params.yaml")]
    assert main([*argv, "--out", str(tmp_path / "locked" / "out")]) == 1
    assert "locked" in capsys.readouterr().err


def test_a_good_replay(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good, out = folder / "good", tmp_path / "a" / "out"
    argv = ["replay", str(good), "--params-file", str(good / "params.yaml"), "--truth", str(good / "truth.csv")]
    assert main([*argv, "--out", str(out)]) == 0
    captured = capsys.readouterr()
    assert re.search(r"found / frames +2 / 2\n", captured.out)
    assert re.search(r"corner error px, p50 / p95 +0\.\d+ / 0\.\d+\n", captured.out)
    assert re.fullmatch(r"replay: 2 of 2 frames, [\d.]+ a second\n", captured.err)
    assert captured.out.rstrip().endswith(str(out / "report.html"))
    names = {path.name for path in out.iterdir()}
    hidden = {name for name in names if name.startswith(".")}
    assert hidden == {".imgu_files.json", ".imgu_lock"}
    assert names - hidden == {
        "frames.csv", "poses_poster.tum", "ambiguous.csv", "results", "report.html", "summary.json",
    }  # fmt: skip
    page = (out / "report.html").read_text()
    # Self-contained: nothing is fetched from anywhere.
    assert not re.search(r"""(src|href)\s*=\s*["'](?!data:)""", page)
    assert "@import" not in page
    assert page.count('"jpeg": "/9j/') == 2 and str(good) in page
    assert json.loads((out / "summary.json").read_text())["targets"][0]["found"] == 2
