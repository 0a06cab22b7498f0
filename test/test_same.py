# SPDX-License-Identifier: Apache-2.0
"""The comparisons of `scripts/same_numbers` and `scripts/same_inventory` find what changed, on small files."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
#: Parameters whose choices no recording can show: of live input and output, or with a single choice.
NOT_OF_REPLAY = {"reference", "image_transport", "compressed.format"}
#: Parameters that no case sets: of live nodes, or with one value.
WITHOUT_EFFECT = {"reference", "image_transport", "autostart"}


@pytest.fixture(scope="module", name="scripts")
def _scripts():
    sys.path.insert(0, str(REPOSITORY / "scripts"))
    try:
        yield {name: importlib.import_module(name) for name in ("same_numbers", "same_numbers_cases", "same_inventory")}
    finally:
        sys.path.remove(str(REPOSITORY / "scripts"))


ROWS = [
    "stamp_ns,frame_id,target,status,h11,t_total_ms",
    "1,camera,poster,detected,0.125,7.5",
    "2,camera,poster,lost,,8",
]
SUMMARY = {"frames": 2, "seconds": 0.5, "versions": {"numpy": "2"}, "targets": [{"name": "poster", "found": 1}]}
TRAJECTORY = ["0.1 1 2 3 0 0 0 1", "0.2 1 2 3 0 0 0 1"]


def results(folder: Path, rows=ROWS, summary=SUMMARY, trajectory=TRAJECTORY) -> Path:
    folder.mkdir()
    (folder / "frames.csv").write_text("\n".join(rows) + "\n")
    (folder / "summary.json").write_text(json.dumps(summary))
    (folder / "poses_poster.tum").write_text("\n".join(trajectory) + "\n")
    return folder


@pytest.fixture(name="compare")
def _compare(scripts, tmp_path):
    def compare(ignored=(), **changed):
        old, new = results(tmp_path / "old"), results(tmp_path / "new", **changed)
        difference = scripts["same_numbers"].compare_folders(old, new, frozenset(ignored))
        return None if difference is None else str(difference)

    return compare


def test_times_versions_and_additions_are_no_difference(compare) -> None:
    rows = [ROWS[0] + ",extra", ROWS[1].replace("7.5", "9.25") + ",1", ROWS[2] + ",2"]
    assert compare(rows=rows, summary=SUMMARY | {"seconds": 9.0, "versions": {}, "extra": 1}) is None


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (
            [ROWS[0], ROWS[1].replace("0.125", "0.12500000000000003"), ROWS[2]],
            "frames.csv, line 2 (1 camera poster), column h11: '0.125' became '0.12500000000000003'",
        ),
        (
            [ROWS[0], ROWS[1], ROWS[2].replace("lost", "degenerate")],
            "frames.csv, line 3 (2 camera poster), column status: 'lost' became 'degenerate'",
        ),
        (ROWS[:2], "frames.csv, number of rows: '2' became '1'"),
        ([*ROWS, ROWS[2]], "frames.csv, number of rows: '2' became '3'"),
        ([",".join(row.split(",")[:4]) for row in ROWS], "frames.csv, column h11: 'a column' became (missing)"),
    ],
    ids=["digit", "status", "row missing", "row added", "column missing"],
)
def test_first_difference_of_a_table_is_named(compare, rows, said) -> None:
    assert compare(rows=rows) == said


def test_digit_of_a_trajectory_and_entry_of_the_summary_count(scripts, tmp_path) -> None:
    compare_folders = scripts["same_numbers"].compare_folders
    old = results(tmp_path / "old")
    moved = results(tmp_path / "moved", trajectory=[TRAJECTORY[0], TRAJECTORY[1].replace("3", "3.5")])
    assert compare_folders(old, moved).place == "poses_poster.tum, line 2"
    shorter = results(tmp_path / "shorter", trajectory=TRAJECTORY[:1])
    assert compare_folders(old, shorter).place == "poses_poster.tum, number of lines"
    counted = results(tmp_path / "counted", summary=SUMMARY | {"targets": [{"name": "poster", "found": 2}]})
    assert str(compare_folders(old, counted)) == "summary.json, targets[0].found: '1' became '2'"
    (moved / "frames.csv").unlink()
    assert compare_folders(old, moved).place == "frames.csv"


def test_a_column_can_be_left_out(compare) -> None:
    assert compare(["h11"], rows=[ROWS[0], ROWS[1].replace("0.125", "0.25"), ROWS[2]]) is None


def test_a_changed_message_is_named_with_its_field(scripts, tmp_path) -> None:
    numbers, cases = scripts["same_numbers"], scripts["same_numbers_cases"]

    def bag(name: str, figure: str, time_ms: str) -> Path:
        values = [
            cases.make("diagnostic_msgs/msg/KeyValue", key=k, value=v)
            for k, v in (("rms_px", figure), ("t_ms", time_ms))
        ]
        status = cases.make(
            "diagnostic_msgs/msg/DiagnosticStatus", level=0, name="poster", message="", hardware_id="", values=values
        )
        stamp = cases.make("builtin_interfaces/msg/Time", sec=1, nanosec=0)
        header = cases.make("std_msgs/msg/Header", stamp=stamp, frame_id="camera")
        message = cases.make("diagnostic_msgs/msg/DiagnosticArray", header=header, status=[status])
        return cases.write_bag([cases.Recorded("/status", 5, message)], tmp_path / name, "mcap")

    old = bag("old", "0.125", "7")
    assert list(numbers.compare_bags(old, bag("same", "0.125", "8"))) == []
    (difference,) = numbers.compare_bags(old, bag("other", "0.126", "7"))
    assert str(difference) == (
        "old, topic /status, message 0: \"status[0].values[0](rms_px)='0.125'\" became "
        "\"status[0].values[0](rms_px)='0.126'\""
    )


def test_entry_point_is_that_of_setup_py(scripts) -> None:
    module, function = scripts["same_numbers"].entry_point(REPOSITORY)
    assert callable(getattr(importlib.import_module(module), function))


def test_every_case_has_a_recording(scripts) -> None:
    cases = scripts["same_numbers_cases"]
    names = [case.name for case in cases.CASES]
    assert len(set(names)) == len(names)
    assert {case.recording for case in cases.CASES} <= {*cases.SIMULATED, *cases.CHANGED, "chessboard"}
    assert len([case for case in cases.CASES if case.is_quick]) * 2 < len(names)


def test_every_choice_of_a_parameter_has_a_case(scripts) -> None:
    items = scripts["same_inventory"].parameter_items((REPOSITORY / "docs" / "parameters.md").read_text())
    choices = [item.removeprefix("parameter ").split(" choice ") for item in items if " choice " in item]
    options = " ".join(case.options for case in scripts["same_numbers_cases"].CASES) + " "
    assert len(choices) > 50
    missing = [
        f"{name}:={choice}"
        for name, choice in choices
        if name not in NOT_OF_REPLAY
        and items[f"parameter {name} default"] != f'`"{choice}"`'
        and f"{name}:={choice} " not in options
    ]
    assert missing == []


def test_every_parameter_has_a_case(scripts) -> None:
    items = scripts["same_inventory"].parameter_items((REPOSITORY / "docs" / "parameters.md").read_text())
    names = {item.split()[1] for item in items}
    options = " ".join(case.options for case in scripts["same_numbers_cases"].CASES)
    given = {"targets.images", "targets.widths_m", "targets.names"}  # by every recording's own parameter file
    missing = {name for name in names if f"{name}:=" not in options} - given
    assert {name for name in missing if not name.startswith(("limits.", "compressed."))} == WITHOUT_EFFECT


PARAMETERS = """
| name | type | default | values | |
|---|---|---|---|---|
| `seed` | integer | `0` | 0 to 100 | Seed of every random draw. |
| `pyramid.kind` | string | `"coarse"` | `coarse`, `fine` | *Fixed while running.* |
"""


@pytest.mark.parametrize(
    ("old", "new", "lost"),
    [
        ("| `seed` | integer | `0` | 0 to 100 | Seed of every random draw. |\n", "", "parameter seed: missing"),
        ("`0` | 0", "`1` | 0", "parameter seed default: `0` became `1`"),
        ("integer", "double", "parameter seed type: integer became double"),
        ("0 to 100", "0 to 99", "parameter seed maximum: 100 became 99"),
        ("0 to 100", "1 to 100", "parameter seed minimum: 0 became 1"),
        (", `fine`", "", "parameter pyramid.kind choice fine: missing"),
        ("draw. |", "*Fixed while running.* |", "parameter seed can be set: at any time became before the start"),
        ("0 to 100", "0 to 1000", None),
        ("0 to 100", "", None),
        ("`fine`", "`fine`, `laplacian`", None),
        ("| *Fixed while running.*", "| ", None),
    ],
)
def test_what_a_parameter_loses_is_found(scripts, old, new, lost) -> None:
    inventory = scripts["same_inventory"]
    assert old in PARAMETERS
    items, changed = (inventory.parameter_items(text) for text in (PARAMETERS, PARAMETERS.replace(old, new)))
    found = inventory.losses(items, changed)
    assert found[:1] == ([] if lost is None else [lost])


HELP = """usage: imgu warp [-h] [--scale S] IN OUT

options:
  -h, --help            show this help message and exit
  --scale S             factor

positional arguments:
  IN                    image
  OUT                   image

more:
  -p NAME:=VALUE, --param NAME:=VALUE
                        set one parameter
  --border {reflected,constant}
                        what stands outside
"""


@pytest.mark.parametrize(
    ("old", "new", "lost"),
    [
        ("  --scale S             factor\n", "", "warp --scale: missing"),
        ("--scale S  ", "--scale    ", "warp --scale: with a value became without a value"),
        (",constant", "", "warp --border constant: missing"),
        ("-p NAME:=VALUE, ", "", "warp -p: missing"),
        ("  OUT                   image\n", "", "warp: positional arguments: 2 became 1"),
        ("factor", "factor of the size", None),
        (",constant", ",constant,mirrored", None),
    ],
)
def test_what_a_command_loses_is_found(scripts, old, new, lost) -> None:
    inventory = scripts["same_inventory"]
    assert old in HELP
    items, changed = (inventory.option_items("warp", text) for text in (HELP, HELP.replace(old, new)))
    assert inventory.losses(items, changed) == ([] if lost is None else [lost])


def test_topics_and_services_are_read_from_the_documentation(scripts) -> None:
    items = scripts["same_inventory"].topic_items((REPOSITORY / "docs" / "interfaces.md").read_text())
    assert items["topic targets/<name>/pose"] == "geometry_msgs/PoseWithCovarianceStamped"
    assert items["service ~/set_target_from_view"] == "std_srvs/Trigger"


def test_arguments_of_launch_files_are_read_without_ros(scripts) -> None:
    items = scripts["same_inventory"].launch_items(REPOSITORY)
    assert items["launch file replay.launch.py argument rate"] == "1.0"
    assert "launch file perception.launch.py argument target" in items
