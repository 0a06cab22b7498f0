# SPDX-License-Identifier: Apache-2.0
"""A marker beside a picture, named in a parameter file: from a recording to poses."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from imgu_ros.config.files import read_parameter_file
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import ParameterError
from imgu_ros.reference.marker import marker_image
from imgu_ros.reference.templates import TargetImage
from imgu_ros.replay.recording import record_simulation
from imgu_ros.replay.replay import replay
from imgu_ros.simulate.sequence import Simulation
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.simulate.truth import read_truth
from imgu_ros.vision.markers import marker_cells

pytestmark = pytest.mark.skipif(not hasattr(cv2, "aruco"), reason="this OpenCV has no aruco module")
WIDTH_M = 0.3


def test_a_list_in_yaml(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imgu_ros.replay.reporting.write_report", lambda path, *_: path.touch())
    cells = np.pad(marker_cells("tag36h11", 7), 1, constant_values=True)
    pixels = np.kron(cells, np.full((40, 40), 255, np.uint8))
    poster = TargetImage("poster", procedural_texture(640, 480), 0.4)
    # The simulator prints the whole sheet, with its margin.
    sheet = TargetImage("tag36h11_7", np.dstack([pixels] * 3), WIDTH_M * 10 / 8)
    bag = tmp_path / "bag"
    record_simulation(bag, Simulation(width=640, height=480, frames=40), targets=[poster, sheet])
    values = read_parameter_file(bag / "params.yaml")
    pictures = {Path(str(each)).stem: str(each) for each in values["targets.images"]}
    text = (
        "/**:\n  ros__parameters:\n"
        f"    targets.images: [{pictures['poster']}, 'tag36h11:7']\n    targets.widths_m: [0.4, {WIDTH_M}]\n"
    )
    (tmp_path / "perception.yaml").write_text(text, encoding="utf-8")
    out = tmp_path / "out"
    replay([bag], out, parameters_from(read_parameter_file(tmp_path / "perception.yaml")))
    with (out / "frames.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    found = {name: [row for row in rows if row["target"] == name] for name in ("poster", "tag36h11_7")}
    truth = [each for each in read_truth(bag / "truth.csv") if each.target == "tag36h11_7"]
    assert len(found["poster"]) == len(found["tag36h11_7"]) == len(truth) == 40
    for name in ("poster", "tag36h11_7"):
        statuses = [row["status"] for row in found[name]]
        assert statuses[0] == "detected" and "tracked" in statuses
        assert {row["pose_status"] for row in found[name]} == {"metric"}
    for row, true in zip(found["tag36h11_7"], truth, strict=True):
        t = np.array([float(row[name]) for name in ("tx", "ty", "tz")])
        assert np.linalg.norm(t - true.pose.t) < 2e-3 * np.linalg.norm(true.pose.t)
    assert (out / "poses_tag36h11_7.tum").exists()


def test_all_ids_of_a_family(tmp_path: Path) -> None:
    """Two of 587 are seen, the second one later; the same files come out twice, but for times."""
    images = [marker_image(f"tag36h11_{number}", "tag36h11", number, 0.1) for number in (7, 300)]
    bag = tmp_path / "bag"
    record_simulation(bag, Simulation(width=480, height=360, frames=24), targets=images)
    parameters = parameters_from({"targets.images": ["tag36h11:*"], "targets.widths_m": [0.1]})
    tables = []
    for run in range(2):
        out = tmp_path / f"out{run}"
        summary = replay([bag], out, parameters, truth=bag / "truth.csv")
        with (out / "frames.csv").open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        tables.append([{key: row[key] for key in row if not key.startswith("t_")} for row in rows])
    assert tables[0] == tables[1]
    names = {row["target"] for row in tables[0]}
    assert names - {"tag36h11"} == {"tag36h11_7", "tag36h11_300"}
    assert summary.frames == 24 and summary.total_ms is not None
    truth = {(each.stamp_ns, each.target): each for each in read_truth(bag / "truth.csv")}
    posed = [row for row in tables[0] if row["pose_status"] == "metric"]
    assert len(posed) > 24
    for row in posed:
        t = np.array([float(row[name]) for name in ("tx", "ty", "tz")])
        true = truth[int(row["stamp_ns"]), row["target"]].pose.t
        assert np.linalg.norm(t - true) < 5e-3 * np.linalg.norm(true)
    files = {path.name for path in out.iterdir()}
    assert {"poses_tag36h11_7.tum", "poses_tag36h11_300.tum"} <= files
    assert not {"poses_tag36h11.tum", "poses_tag36h11_8.tum"} & files
    with AnyReader([out / "results"], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        topics = {connection.topic for connection in reader.connections}
    assert {"/targets/tag36h11_7/pose", "/targets/tag36h11_300/odom"} <= topics
    # Later runs know the files that may be there.
    replay([bag], out, parameters_from({"targets.images": ["tag36h11:300"]}), overwrite=True)
    assert not (out / "poses_tag36h11_7.tum").exists()


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("", "marker"),
        ("grid: {family: tag36h11, rows: 1, columns: 2, size: 0.1, gap: 0.02}", "board"),
        ("markers: [{family: tag36h11, id: 0, size: 0.1, z: 0.1}]", "bundle"),
    ],
)
def test_stage_nodes_refuse_markers_and_boards(tmp_path: Path, text: str, kind: str) -> None:
    pytest.importorskip("rclpy")
    from imgu_ros.files.target_images import load_target_images
    from imgu_ros.ros.stages.matcher import MatcherStage

    (tmp_path / "wall.yaml").write_text(text, encoding="utf-8")
    entry, name = (str(tmp_path / "wall.yaml"), "wall") if text else ("tag36h11:7", "tag36h11_7")
    parameters = parameters_from({"targets.images": [entry]})
    with pytest.raises(ParameterError, match=f"{name} is a {kind}; stage nodes know pictures alone"):
        MatcherStage().use(parameters, load_target_images(parameters.targets))
