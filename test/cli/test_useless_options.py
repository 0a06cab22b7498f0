# SPDX-License-Identifier: Apache-2.0
"""An option that a command would ignore is refused, before any work."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from imgu_ros.cli.main import main


@pytest.fixture
def picture(tmp_path: Path) -> str:
    path = str(tmp_path / "grey.png")
    assert cv2.imwrite(path, np.full((32, 48), 90, np.uint8))
    return path


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(list(arguments)) == 1
    out, error = capsys.readouterr()
    assert not out
    assert error.count("\n") == 1
    return error


def test_demosaic(picture: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ("demosaic", picture, str(tmp_path / "out.png"), "--pattern", "rggb")
    assert "preprocess.gamma: not used by this command" in refused(capsys, *command, "-p", "preprocess.gamma:=0.5")
    assert "raw.bands: not used by this command" in refused(capsys, *command, "-p", "raw.bands:=[1]")
    parameters = tmp_path / "params.yaml"  # the whole pipeline's file is fine
    assert main(["params", "--yaml"]) == 0
    parameters.write_text(capsys.readouterr().out)
    assert main([*command, "--params-file", str(parameters)]) == 0


def test_calibrate(picture: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ("--board", "9x6", "--square", "0.03", "--out", str(tmp_path / "camera.yaml"))
    error = refused(capsys, "calibrate", picture, *command, "--topic", "/image_raw")
    assert "image_topic: '/image_raw' for image files" in error
    bag = tmp_path / "a.mcap"
    bag.touch()
    assert "--pattern: rggb for a bag" in refused(capsys, "calibrate", str(bag), *command, "--pattern", "rggb")
    assert "tracking.enabled: not used" in refused(
        capsys, "calibrate", picture, *command, "-p", "tracking.enabled:=true"
    )
    assert "none.png: No such file" in refused(capsys, "calibrate", picture, str(tmp_path / "none.png"), *command)


def test_simulate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    error = refused(capsys, "simulate", "--out", str(tmp_path / "bag"), "--pixel-pitch-um", "5")
    assert "pixel pitch: 5 um without an f-number" in error


def test_match(picture: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "suffix '.txt'" in refused(capsys, "match", picture, picture, "--draw", str(tmp_path / "a.txt"))
    missing = str(tmp_path / "none" / "a.json")
    assert "its folder does not exist" in refused(capsys, "match", picture, picture, "--json", missing)


def test_bench(capsys: pytest.CaptureFixture[str]) -> None:
    for given in ("camera.info_file:=camera.yaml", "raw.encoding:=bayer_rggb8"):
        name = given.partition(":")[0]
        assert f"{name}: not used by this command" in refused(capsys, "bench", "-p", given)
