# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import FileError
from imgu_ros.files import pose_files
from imgu_ros.files.pose_files import AMBIGUOUS_COLUMNS, PoseFiles, seconds_text
from imgu_ros.frame import Frame
from imgu_ros.result import PoseStatus, ReferenceResult, Result, Status, by_name
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage

QUARTER_TURN_ABOUT_Z = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
POSE = Pose(QUARTER_TURN_ABOUT_Z, np.array([1.0, 2.0, 3.0]), np.diag([1.0, 2, 3, 4, 5, 6]), 0.5)


def result(pose_status: PoseStatus, name: str = "poster", later_s: int = 0) -> Result:
    image, stamp_ns = RawImage(np.zeros((2, 2), np.uint8), PixelLayout(ColorModel.MONO)), 1_000_000_005
    frame = Frame(image, stamp_ns + later_s * 1_000_000_000, "cam,era", None)
    pose = POSE if pose_status is PoseStatus.METRIC else None
    target = ReferenceResult(name, 0, Status.DETECTED, pose_status, pose=pose, solutions=(POSE, POSE), ambiguity=0.9)
    return Result(frame, by_name((target,)))


def test_metric_pose_is_inverted(tmp_path: Path) -> None:
    with PoseFiles(tmp_path, ["poster"]) as files:
        files.write(result(PoseStatus.METRIC))
    numbers = (tmp_path / "poses_poster.tum").read_text().split()
    assert numbers[0] == "1.000000005"
    # -R^T t by hand, and a quarter turn the other way.
    assert np.allclose(np.array(numbers[1:], float), [-2, 1, -3, 0, 0, -np.sqrt(0.5), np.sqrt(0.5)], atol=1e-15)
    assert (tmp_path / "ambiguous.csv").read_text().splitlines() == [",".join(AMBIGUOUS_COLUMNS)]


def test_ambiguous_pose_gives_both_solutions_and_no_trajectory(tmp_path: Path) -> None:
    with PoseFiles(tmp_path, ["poster"]) as files:
        files.write(result(PoseStatus.AMBIGUOUS))
    assert (tmp_path / "poses_poster.tum").read_text() == ""
    with (tmp_path / "ambiguous.csv").open(newline="") as file:
        got = list(csv.DictReader(file))
    assert [row["solution"] for row in got] == ["1", "2"]
    assert got[0]["frame_id"] == "cam,era"
    assert [float(got[0][name]) for name in ("rms_px", "tx", "ty", "tz", "c11", "c66", "c12")] == [
        0.5,
        1,
        2,
        3,
        1,
        6,
        0,
    ]


def test_targets_that_come_later_have_files_from_their_first_pose_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However many there are, few files are open."""
    monkeypatch.setattr(pose_files, "_MOST_OPEN", 2)
    names = [f"tag_{number}" for number in (1, 2, 3, 1, 3, 2)]
    with PoseFiles(tmp_path, []) as files:
        assert not list(tmp_path.glob("*.tum"))
        for number, name in enumerate(names):
            files.write(result(PoseStatus.METRIC, name, number))
    for name in set(names):
        lines = (tmp_path / f"poses_{name}.tum").read_text().splitlines()
        assert [line.split()[0] for line in lines] == [
            f"{number + 1}.000000005" for number, other in enumerate(names) if other == name
        ]


def test_unwritable(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="can be written"):
        PoseFiles(tmp_path / "missing", ["poster"])


@given(st.integers(-(2**62), 2**62))
def test_seconds_keep_every_digit(stamp_ns: int) -> None:
    text = seconds_text(stamp_ns)
    whole, decimals = text.removeprefix("-").split(".")
    assert len(decimals) == 9
    assert int(whole + decimals) * (-1 if text.startswith("-") else 1) == stamp_ns
