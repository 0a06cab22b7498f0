# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
from pathlib import Path

import pytest

from imgu_ros.cli.bench import SUITES
from imgu_ros.cli.main import main

SMALL = ["--sizes", "320x240", "--frames", "1", "--conditions", "plain,blur-5"]


def test_choices_are_the_suites() -> None:
    from imgu_ros.bench.suites import Suite

    assert tuple(Suite) == SUITES


def test_measures_prints_and_writes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert main(["bench", "--suite", "detection", *SMALL, "--out", str(out), "-p", "keypoints.max_count:=500"]) == 0
    printed = capsys.readouterr().out
    assert "ours, detecting" in printed and "SIFT recipe" in printed and "blur-5" in printed
    document = json.loads((out / "bench.json").read_text())
    assert set(document["processor_use"]) == {"seconds", "cores", "own", "others", "stolen", "quiet"}
    assert "other processes used" in (out / "bench.md").read_text()
    assert [(f["condition"], f["method"]) for f in document["figures"]] == [
        (c, m) for c in ("plain", "blur-5") for m in ("detection", "ORB", "SIFT")
    ]
    assert document["parameters_set"] == ["keypoints.max_count:=500"]
    assert document["machine"]["opencv_threads"] >= 1
    assert (out / "bench.png").stat().st_size > 5000
    assert "| plain | ours, detecting |" in (out / "bench.md").read_text()


def test_photographs_of_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["bench", "--suite", "negatives", "--sizes", "320x240", "--negatives", "1", "--photographs"]
    assert main([*command, str(tmp_path)]) == 1
    assert "no colour picture" in capsys.readouterr().err
    from imgu_ros.cli.bench import _photographs
    from imgu_ros.image_files.images import write_image
    from imgu_ros.simulate.texture import procedural_texture

    picture = procedural_texture(64, 48, 3)
    write_image(tmp_path / "photo.png", picture)
    write_image(tmp_path / "grey.png", picture[:, :, 0].copy())
    (found,) = _photographs(tmp_path)
    assert (found == picture).all()


@pytest.mark.parametrize(
    ("options", "code", "said"),
    [
        (["--sizes", "640"], 2, "need WIDTHxHEIGHT"),
        (["--seeds", "x"], 2, "need whole numbers"),
        (["--suite", "speed"], 2, "invalid choice"),
        (["--sizes", "641x480"], 1, "need even numbers"),
        (["--frames", "0"], 1, "frames: 0"),
        (["--conditions", "blur"], 1, "nearest known: blur-"),
        (["--methods", "surf"], 1, "need one of tracking"),
        (["-p", "no.such:=1"], 1, "unknown parameter"),
        (["-p", "camera.rectified:=true"], 1, "camera.rectified"),
    ],
)
def test_wrong_options(options: list[str], code: int, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", *options]) == code
    assert said in capsys.readouterr().err
