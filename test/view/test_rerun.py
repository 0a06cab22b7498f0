# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import dataclasses
import io
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from imgu_ros.bags.messages import make_message
from imgu_ros.bags.reading import open_bag
from imgu_ros.bags.writing import BagWriter
from imgu_ros.cli.main import main
from imgu_ros.config.files import read_parameter_file
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import FileError
from imgu_ros.files.frames_csv import read_rows
from imgu_ros.replay.recording import record_simulation
from imgu_ros.replay.replay import replay
from imgu_ros.simulate.sequence import Simulation, default_targets
from imgu_ros.view.view import view_with_rerun

pytest.importorskip("rerun")
from rerun.chunk import RrdReader

Recorded = dict[str, list[tuple[int | None, dict[str, Any]]]]


def read(path: Path) -> Recorded:
    """Read a recording by Rerun's own reader: entity -> (frame; None: static) and its components."""
    found: Recorded = {}
    for chunk in RrdReader(path).store().stream():
        table = chunk.to_record_batch()
        columns = {name: table.column(name) for name in table.schema.names if ":" in name}
        frames = table.column("frame").to_pylist() if "frame" in table.schema.names else [None] * table.num_rows
        for row, frame in enumerate(frames):
            values = {name: column[row].as_py() for name, column in columns.items() if column[row].is_valid}
            found.setdefault(chunk.entity_path, []).append((frame, values))
    return found


@pytest.fixture(scope="module")
def recorded(replayed: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    path = tmp_path_factory.mktemp("rrd") / "view.rrd"
    view_with_rerun(replayed[1], path)
    return read(path)


def test_poses_are_those_of_the_replay(replayed: tuple[Path, Path], recorded: Recorded) -> None:
    truth = [line.split() for line in (replayed[1] / "poses_poster.tum").read_text().splitlines() if line[0] != "#"]
    cameras = {frame: values for frame, values in recorded["/world/camera"] if "Transform3D:translation" in values}
    assert len(cameras) == len(truth) == 8
    for frame, (_, *numbers) in enumerate(truth):
        expected = np.array(numbers, float)
        assert np.allclose(cameras[frame]["Transform3D:translation"][0], expected[:3], atol=1e-5)
        turn = np.array(cameras[frame]["Transform3D:quaternion"][0])
        assert abs(turn @ expected[3:]) == pytest.approx(1, abs=1e-6)


def test_pictures_outlines_keypoints_and_curves(replayed: tuple[Path, Path], recorded: Recorded) -> None:
    pictures = [values["EncodedImage:blob"][0] for _, values in recorded["/world/camera/image"] if len(values) == 2]
    assert len(pictures) == 8
    assert {Image.open(io.BytesIO(bytes(blob))).size for blob in pictures} == {(480, 360)}
    for target in ("poster", "poster_2"):
        assert len(recorded[f"/world/camera/image/results/{target}"]) == 8
        for name, column in (("residual", "rms_px"), ("confirmed", "confirmed_share")):
            rows = [row for row in read_rows(replayed[1] / "frames.csv") if row["target"] == target and row[column]]
            points = recorded[f"/plots/{name}/{target}"]
            curve = [values["Scalars:scalars"][0] for frame, values in points if frame is not None]
            assert curve == [float(row[column]) for row in rows]
    assert len(recorded["/world/camera/image/results/keypoints"]) == 8
    for frame, values in recorded["/world/camera/image/results/inliers"]:
        rows = list(read_rows(replayed[1] / "frames.csv"))[2 * frame : 2 * frame + 2]
        points = np.array(values["Points2D:positions"])
        assert 20 < len(points) <= sum(float(row["n_matches"]) for row in rows)
        # They lie on the targets of the same frame.
        inside = np.zeros(len(points), bool)
        for target in ("poster", "poster_2"):
            ((_, drawn),) = [one for one in recorded[f"/world/camera/image/results/{target}"] if one[0] == frame]
            corners = np.array(drawn["LineStrips2D:strips"][0])
            edges, sides = np.diff(corners, axis=0), points[:, None] - corners[:-1]
            inside |= (edges[:, 0] * sides[..., 1] - edges[:, 1] * sides[..., 0] > -300).all(axis=1)
        assert inside.all()


def test_outline_is_where_the_pinhole_camera_projects_the_target(recorded: Recorded) -> None:
    """Pictures, poses and the pinhole camera agree, by Rerun's conventions: pixels begin at integers."""
    ((_, pinhole), *_) = [item for item in recorded["/world/camera/image"] if "Pinhole:image_from_camera" in item[1]]
    K = np.reshape(pinhole["Pinhole:image_from_camera"][0], (3, 3)).T  # column by column
    assert pinhole["Pinhole:resolution"][0] == [480, 360]
    half = np.array([0.25, 0.25 * 300 / 400, 0])
    for frame, values in recorded["/world/camera/image/results/poster"]:
        drawn = np.array(values["LineStrips2D:strips"][0])[:4]
        ((_, camera),) = [item for item in recorded["/world/camera"] if item[0] == frame]
        x, y, z, w = camera["Transform3D:quaternion"][0]
        R = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
        corners = half * [[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]
        seen = (corners - camera["Transform3D:translation"][0]) @ R @ K.T
        assert np.abs(seen[:, :2] / seen[:, 2:] - drawn).max() < 0.1


def test_targets_are_drawn_with_their_size(recorded: Recorded) -> None:
    for entity in ("/world/results/poster/target", "/around/poster_2/target"):
        ((_, drawn),) = recorded[entity]
        corners = np.array(drawn["LineStrips3D:strips"][0])[:4]
        assert np.allclose(
            corners, 0.25 * np.array([[-1, 0.75, 0], [1, 0.75, 0], [1, -0.75, 0], [-1, -0.75, 0]]), atol=1e-3
        )


def test_ellipsoids_have_the_spread_of_the_covariance(replayed: tuple[Path, Path], recorded: Recorded) -> None:
    """Draws of the pose by its own covariance, by the definition in the interfaces; 95 % of positions are inside."""
    from scipy.spatial.transform import Rotation

    (entity,) = [name for name in recorded if name.startswith("/world/results/poster/ellipsoids")]
    times = float(entity.rpartition("_x")[2])
    ((_, ellipsoids),) = recorded[entity]
    row = next(row for row in read_rows(replayed[1] / "frames.csv") if row["target"] == "poster")
    t = np.array([float(row[name]) for name in ("tx", "ty", "tz")])
    R = Rotation.from_quat([float(row[name]) for name in ("qx", "qy", "qz", "qw")])
    covariance = np.array([float(row[f"c{i}{j}"]) for i in range(1, 7) for j in range(1, 7)]).reshape(6, 6)
    draws = np.random.default_rng(1).multivariate_normal(np.zeros(6), covariance, 4000)
    positions = -(Rotation.from_rotvec(draws[:, 3:]) * R).inv().apply(t + draws[:, :3])
    axes = Rotation.from_quat(ellipsoids["Ellipsoids3D:quaternions"][0])
    center = np.array(ellipsoids["Ellipsoids3D:centers"][0])
    half_sizes = np.array(ellipsoids["Ellipsoids3D:half_sizes"][0]) / times
    local = axes.inv().apply(positions - (-R.inv().apply(t))) / half_sizes
    assert np.allclose(center, -R.inv().apply(t), atol=1e-5)
    assert ((local**2).sum(axis=1) < 1).mean() == pytest.approx(0.95, abs=0.012)


def test_recording_elsewhere_gone_or_another(
    replayed: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording, results = tmp_path / "moved", tmp_path / "results"
    shutil.copytree(replayed[0], recording)
    shutil.copytree(replayed[1], results)
    summary = json.loads((results / "summary.json").read_text())
    assert summary["source"]["recording"] == [str(replayed[0])]
    summary["source"]["recording"] = [str(tmp_path / "gone")]
    (results / "summary.json").write_text(json.dumps(summary))

    assert main(["view", str(results)]) == 0
    said = capsys.readouterr()
    assert "gone: not there any more, so there are no pictures" in said.err
    assert said.out.splitlines()[0] == str(results / "view.rrd")
    without = read(results / "view.rrd")
    assert "/world/camera" in without and "/world/camera/image" not in without

    before = {path: path.read_bytes() for path in recording.iterdir()}
    assert main(["view", str(results), "--recording", str(recording)]) == 0
    assert "/world/camera/image" in read(results / "view.rrd")
    assert {path: path.read_bytes() for path in recording.iterdir()} == before

    with pytest.raises(FileError, match=r"nowhere: does not exist"):
        view_with_rerun(results, tmp_path / "x.rrd", [tmp_path / "nowhere"])
    assert not (tmp_path / "x.rrd").exists()


def test_same_results_give_the_same_content(replayed: tuple[Path, Path], tmp_path: Path, recorded: Recorded) -> None:
    view_with_rerun(replayed[1], tmp_path / "again.rrd")
    again = read(tmp_path / "again.rrd")
    assert again.keys() == recorded.keys()
    for entity in again.keys() - {"/__properties"}:
        key = lambda item: (-1 if item[0] is None else item[0], sorted(item[1]))  # noqa: E731
        assert sorted(again[entity], key=key) == sorted(recorded[entity], key=key)


@pytest.mark.parametrize(
    ("name", "content", "complaint"),
    [
        ("summary.json", "{", "need what this version's"),
        ("summary.json", "[" * 100_000, "need what this version's"),
        ("summary.json", '{"source": {}}', "need what this version's"),
        ("summary.json", None, "need a folder that `imgu replay` has completed"),
        ("frames.csv", "a,b\n1,2\n", "need those of frames.csv"),
        ("results", None, "results"),
    ],
)
def test_what_is_no_result(
    replayed: tuple[Path, Path], tmp_path: Path, name: str, content: str | None, complaint: str
) -> None:
    results = tmp_path / "results"
    shutil.copytree(replayed[1], results)
    if content is not None:
        (results / name).write_text(content)
    elif (results / name).is_dir():
        shutil.rmtree(results / name)
    else:
        (results / name).unlink()
    with pytest.raises(Exception, match=complaint):
        view_with_rerun(results)
    assert not list(results.glob("*view.rrd*"))


def test_results_bag_of_a_stranger(replayed: tuple[Path, Path], tmp_path: Path) -> None:
    """Other types under the names of our topics, and numbers that are none: left out, and all else is shown."""
    results = tmp_path / "results"
    shutil.copytree(replayed[1], results)
    shutil.rmtree(results / "results")
    points = [make_message("geometry_msgs/msg/Point32", x=x, y=1.0, z=0.0) for x in (1.0, float("nan"), 2.0, 1e30)]
    outline = make_message("geometry_msgs/msg/PolygonStamped")
    outline.polygon.points += points
    text = make_message("std_msgs/msg/String", data="x")
    with BagWriter(results / "results") as writer:
        for number in range(8):
            writer.write("/status", text, number)
            writer.write("/targets/poster/outline", outline, number)
            for topic in ("/keypoints", "/annotations", "/targets/poster_2/outline"):
                writer.write(topic, text, number)
    view_with_rerun(results)
    found = read(results / "view.rrd")
    for target in ("poster", "poster_2"):
        assert not any("LineStrips2D:strips" in one for _, one in found[f"/world/camera/image/results/{target}"])
    assert len(found["/world/camera"]) == 8


def test_place_that_cannot_be_written(replayed: tuple[Path, Path], tmp_path: Path) -> None:
    with pytest.raises(FileError, match="can be written"):
        view_with_rerun(replayed[1], tmp_path / "no" / "view.rrd")


def test_frames_without_a_find(tmp_path: Path) -> None:
    """Frames 3 and 4 are dark: nothing of the frames before is left over them, and it is said why."""
    recording, results = tmp_path / "recording", tmp_path / "results"
    record_simulation(tmp_path / "whole", Simulation(width=320, height=240, frames=7), targets=default_targets(1, 0))
    with open_bag([tmp_path / "whole"]) as bag, BagWriter(recording) as writer:
        count = 0
        for message in bag.messages():
            data = dataclasses.asdict(message.message) | {"header": message.message.header}
            data.pop("__msgtype__", None)
            if message.topic == "/camera/image_raw":
                data["data"] = np.asarray(data["data"]) * np.uint8(count not in (3, 4))
                count += 1
            else:
                data["roi"] = message.message.roi
            writer.write(message.topic, make_message(message.type_name, **data), message.time_ns)
    replay([recording], results, parameters_from(read_parameter_file(tmp_path / "whole" / "params.yaml")))
    view_with_rerun(results)
    found = read(results / "view.rrd")
    states = {frame: values["StateChange:state"][0] for frame, values in found["/status/poster"] if frame is not None}
    assert states[3] == "lost" and 4 not in states and states[5] in ("tracked", "detected")
    outlines = dict(found["/world/camera/image/results/poster"])
    assert all(("LineStrips2D:strips" in values) is (frame not in (3, 4)) for frame, values in outlines.items())
    assert all("Clear:is_recursive" in outlines[frame] for frame in (3, 4))
    assert {frame for frame, _ in found["/world/camera"]} == {0, 1, 2, 5, 6}
    seen = found["/world/camera/image"]
    colors = {frame: values["Pinhole:color"][0] for frame, values in seen if "Pinhole:color" in values}
    assert colors[0] == colors[5] != colors[3]
    (reason,) = [values["TextLog:text"][0] for frame, values in found["/log/poster"] if frame == 3]
    assert reason.startswith("lost: ")
    # The path is in two parts: nothing joins where the target was lost.
    ((_, path),) = found["/world/results/poster/path"]
    assert [len(strip) for strip in path["LineStrips3D:strips"]] == [3, 2]
