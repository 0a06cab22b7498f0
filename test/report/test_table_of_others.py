# SPDX-License-Identifier: Apache-2.0
"""A frames.csv that somebody has changed is refused with its row, whatever is in it."""

from __future__ import annotations

import pytest

from imgu_ros.errors import FileError
from imgu_ros.files.frames_csv import COLUMNS
from imgu_ros.report.table import read_frame_table


def row(**cells: str) -> str:
    known = {"stamp_ns": "1", "target": "t", "status": "detected", "pose_status": ""} | cells
    return ",".join(known.get(column, "") for column in COLUMNS)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (row(stamp_ns="9" * 5000), "row 2: "),
        (row(stamp_ns=str(2**63)), "row 2: "),
        (row(stamp_ns=".inf"), "row 2: "),
        (row(status="nonsense"), "row 2: 'nonsense'"),
        (row(n_matches="many"), "row 2: "),
        (row(tx="1", ty="x"), "row 2: "),
        ("1,2,3", ":3: not a cell for each column"),
        (row() + ",more", ":3: not a cell for each column"),
        ("x" * 200_000, "field larger than field limit"),
        ("\xff", ""),
    ],
)
def test_rows_that_no_replay_writes(tmp_path, line, said):
    path = tmp_path / "frames.csv"
    path.write_text("\n".join((",".join(COLUMNS), row(), line, "")), encoding="latin-1")
    with pytest.raises(FileError) as error:
        read_frame_table(path)
    assert said in str(error.value)
    assert len(str(error.value).splitlines()) == 1


def test_rows_as_a_replay_writes_them(tmp_path):
    path = tmp_path / "frames.csv"
    path.write_text("\n".join((",".join(COLUMNS), row(), row(stamp_ns=str(2**63 - 1)), "")))
    assert read_frame_table(path).stamp_ns.tolist() == [1, 2**63 - 1]
