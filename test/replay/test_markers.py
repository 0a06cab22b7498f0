# SPDX-License-Identifier: Apache-2.0
"""A marker beside a picture, named in a parameter file: from a recording to poses."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest

from imgu_ros.config.files import read_parameter_file
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import ParameterError
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
