# SPDX-License-Identifier: Apache-2.0
"""Recordings made before their camera was calibrated, or by a driver that calls a mosaic grey, and `imgu replay`."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from itertools import compress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

from imgu_ros.bags.messages import make_message
from imgu_ros.bags.reading import open_bag
from imgu_ros.bags.writing import BagWriter
from imgu_ros.cli.main import main
from imgu_ros.files.camera_info_file import camera_info_text, read_camera_info
from imgu_ros.messages.compressed_image import compressed_image_message
from imgu_ros.messages.header import decode_header
from imgu_ros.messages.image import decode_image
from imgu_ros.reference.templates import TargetImage
from imgu_ros.replay.recording import record_simulation
from imgu_ros.simulate.chessboard import draw_chessboard, random_chessboard_view
from imgu_ros.simulate.sequence import Simulation
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.vision.camera.chessboard import Chessboard
from imgu_ros.vision.camera.intrinsics import make_camera
from imgu_ros.vision.formation.cfa import BayerPattern, mosaic

CAMERA = make_camera([[410, 0, 238], [0, 408, 181], [0, 0, 1]], (-0.26, 0.09, 0.0008, -0.0005), "plumb_bob", 480, 360)
FRAMES = 4
#: What a driver that was never calibrated says of a lens.
UNCALIBRATED = {"k": np.zeros(9), "d": np.zeros(0), "p": np.zeros(12)}

Change = Callable[[Any], Any | None]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("simulated") / "bag"
    poster = TargetImage("poster", procedural_texture(640, 480), 0.5)
    record_simulation(path, Simulation(width=480, height=360, frames=FRAMES, camera=CAMERA), targets=[poster])
    return path


@pytest.fixture(autouse=True)
def _no_report(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imgu_ros.replay.reporting.write_report", lambda path, *_: path.touch())


@pytest.fixture
def camera_file(tmp_path: Path) -> Path:
    path = tmp_path / "camera.yaml"
    path.write_text(camera_info_text(CAMERA))
    return path


def without_info(message: Any) -> Any | None:
    return None if hasattr(message, "distortion_model") else message


def with_zero_info(message: Any) -> Any | None:
    for name, value in UNCALIBRATED.items() if hasattr(message, "distortion_model") else ():
        setattr(message, name, value)
    return message


def with_wrong_info(message: Any) -> Any | None:
    if hasattr(message, "distortion_model"):
        message.k = message.k * np.array([0.7, 1, 1, 1, 0.7, 1, 1, 1, 1])
    return message


def called(encoding: str, change: Change = lambda message: message) -> Change:
    def renamed(message: Any) -> Any | None:
        if hasattr(message, "encoding"):
            message.encoding = encoding
        return change(message)

    return renamed


def compressed_mosaic(kind: str) -> Change:
    """A mosaic as compressed_image_transport sends it when the driver calls it mono8."""

    def change(message: Any) -> Any | None:
        if not hasattr(message, "encoding"):
            return message
        raw = decode_image(message).pixels
        header = decode_header(message)
        return compressed_image_message(make_message, header, raw, "mono8", file_format=kind, jpeg_quality=98)

    return change


def rewritten(bag: Path, out: Path, change: Change) -> Path:
    with open_bag([bag]) as source, BagWriter(out) as writer:
        for message in source.messages():
            changed = change(message.message)
            if changed is not None:
                suffix = "/compressed" if hasattr(changed, "format") else ""
                writer.write(message.topic + suffix, changed, message.time_ns)
    return out


def replayed(bag: Path, truth: Path, out: Path, *parameters: str) -> list[dict[str, str]]:
    given = [part for parameter in parameters for part in ("-p", parameter)]
    arguments = [str(bag), "--params-file", str(truth / "params.yaml"), "--truth", str(truth / "truth.csv")]
    assert main(["replay", *arguments, "--out", str(out), "--overwrite", *given]) == 0
    with (out / "frames.csv").open() as file:
        return list(csv.DictReader(file))


def poses(rows: list[dict[str, str]]) -> np.ndarray:
    return np.array([[float(row[axis]) for axis in ("tx", "ty", "tz")] for row in rows])


@pytest.mark.parametrize("change", [without_info, with_zero_info, with_wrong_info])
def test_a_bag_recorded_before_its_camera_was_calibrated(
    bag: Path, camera_file: Path, tmp_path: Path, change: Change, capsys: pytest.CaptureFixture[str]
) -> None:
    expected = replayed(bag, bag, tmp_path / "expected")
    assert [row["pose_status"] for row in expected] == ["metric"] * FRAMES
    changed = rewritten(bag, tmp_path / "changed", change)
    before = replayed(changed, bag, tmp_path / "out")
    if change is not with_wrong_info:
        assert {row["pose_status"] for row in before} == {"uncalibrated"}
    capsys.readouterr()
    rows = replayed(changed, bag, tmp_path / "out", f"camera.info_file:={camera_file}")
    said = capsys.readouterr().err
    assert "camera_info" not in said.replace(str(camera_file), "")
    timeless = [{key: value for key, value in row.items() if "ms" not in key} for row in rows]
    assert timeless == [{key: value for key, value in row.items() if "ms" not in key} for row in expected]
    source = json.loads((tmp_path / "out" / "summary.json").read_text())["source"]
    assert (source["camera_info_topic"], source["camera_info_file"]) == ("", str(camera_file))


def test_the_path_is_expanded(bag: Path, camera_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    changed = rewritten(bag, tmp_path / "changed", without_info)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("CAMERAS", str(tmp_path))
    for text in ("~/camera.yaml", "$CAMERAS/camera.yaml"):
        rows = replayed(changed, bag, tmp_path / "out", f"camera.info_file:={text}")
        assert {row["pose_status"] for row in rows} == {"metric"}


def test_a_file_of_another_resolution_costs_the_poses_and_says_both_sizes(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "full.yaml"
    path.write_text(camera_info_text(make_camera(2 * CAMERA.K - np.diag([0, 0, 1]), (), "plumb_bob", 960, 720)))
    rows = replayed(bag, bag, tmp_path / "out", f"camera.info_file:={path}")
    assert {row["pose_status"] for row in rows} == {"uncalibrated"}
    assert {row["status"] for row in rows} <= {"detected", "tracked"}
    assert f"{path}: size 960 x 720 px, image 480 x 360 px" in capsys.readouterr().err


def test_rectified_images_are_seen_by_the_files_projection(bag: Path, tmp_path: Path) -> None:
    """P[:3, :3] of the file and no lens, as of a message: the same as a file with that matrix as K."""
    projection = np.array([[400.0, 0, 240], [0, 400, 178], [0, 0, 1]])
    stereo, plain = tmp_path / "stereo.yaml", tmp_path / "plain.yaml"
    content = yaml.safe_load(camera_info_text(CAMERA))
    content["projection_matrix"]["data"] = np.column_stack((projection, (-20.0, 0, 0))).ravel().tolist()
    stereo.write_text(yaml.safe_dump(content))
    plain.write_text(camera_info_text(make_camera(projection, (), "plumb_bob", 480, 360)))
    changed = rewritten(bag, tmp_path / "changed", without_info)
    rows = replayed(changed, bag, tmp_path / "out", "camera.rectified:=true", f"camera.info_file:={stereo}")
    assert "metric" in {row["pose_status"] for row in rows}
    expected = replayed(changed, bag, tmp_path / "out", f"camera.info_file:={plain}")
    metric = [row["pose_status"] == "metric" for row in rows]
    assert [row["pose_status"] == "metric" for row in expected] == metric
    assert poses(list(compress(rows, metric))).tolist() == poses(list(compress(expected, metric))).tolist()


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (None, "No such file"),
        ("just: text\n", "need"),
        ("image_width: 480\nimage_height: 360\ncamera_matrix: {rows: 3, cols: 3, data: [0,0,0,0,0,0,0,0,0]}\n", "zero"),
        ("{", "YAML"),
    ],
)
def test_a_file_that_cannot_be_used_is_one_line_before_the_work(
    bag: Path, tmp_path: Path, content: str | None, expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "broken.yaml"
    if content is not None:
        path.write_text(content)
    arguments = [str(bag), "--params-file", str(bag / "params.yaml"), "--out", str(tmp_path / "out")]
    assert main(["replay", *arguments, "-p", f"camera.info_file:={path}"]) == 1
    error = [line for line in capsys.readouterr().err.splitlines() if line.startswith("imgu: error: ")]
    assert len(error) == 1
    assert "camera.info_file" in error[0]
    assert "broken.yaml" in error[0]
    assert expected in error[0]
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("claimed", ["mono8", "8UC1", "bayer_bggr8", "8SC1"])
def test_a_mosaic_by_another_name(bag: Path, tmp_path: Path, claimed: str) -> None:
    expected = replayed(bag, bag, tmp_path / "expected")
    changed = rewritten(bag, tmp_path / "changed", called(claimed))
    rows = replayed(changed, bag, tmp_path / "out", "raw.encoding:=bayer_rggb8")
    assert poses(rows).tolist() == poses(expected).tolist()
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert (
        summary["source"]["layout"] == json.loads((tmp_path / "expected/summary.json").read_text())["source"]["layout"]
    )


@pytest.mark.parametrize("kind", ["png", "jpeg"])
def test_a_compressed_mosaic_called_mono8(bag: Path, tmp_path: Path, kind: str) -> None:
    expected = replayed(bag, bag, tmp_path / "expected")
    changed = rewritten(bag, tmp_path / "changed", compressed_mosaic(kind))
    rows = replayed(changed, bag, tmp_path / "out", "raw.encoding:=bayer_rggb8")
    assert {row["pose_status"] for row in rows} == {"metric"}
    # PNG loses nothing.
    assert np.abs(poses(rows) - poses(expected)).max() <= (0 if kind == "png" else 0.01)
    assert "bayer rggb" in json.loads((tmp_path / "out" / "summary.json").read_text())["source"]["layout"]


@pytest.mark.parametrize(
    ("encoding", "expected"),
    [
        ("bayer_rggb16", "raw.encoding: bayer_rggb16 has 2 bytes a pixel, the message's bayer_rggb8 1"),
        ("rgb8", "raw.encoding: rgb8 has 3 bytes a pixel, the message's bayer_rggb8 1"),
    ],
)
def test_an_encoding_that_the_pixels_cannot_be(
    bag: Path, tmp_path: Path, encoding: str, expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [str(bag), "--params-file", str(bag / "params.yaml"), "--out", str(tmp_path / "out")]
    assert main(["replay", *arguments, "-p", f"raw.encoding:={encoding}"]) == 1
    assert expected in capsys.readouterr().err


@pytest.mark.parametrize("command", ["replay", "params", "demo", "match", "demosaic", "calibrate"])
def test_an_unknown_encoding_is_refused_with_those_that_are_known(
    tmp_path: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    needed = {
        "replay": ["x", "--out", str(tmp_path / "o")],
        "demo": ["--out", str(tmp_path / "o")],
        "match": ["a", "b"],
        "demosaic": ["a.png", "b.png"],
        "calibrate": ["a.png", "--board", "7x5", "--square", "0.03", "--out", str(tmp_path / "c.yaml")],
    }
    assert main([command, *needed.get(command, []), "-p", "raw.encoding:=bayer_rgbg8"]) == 1
    error = capsys.readouterr().err
    assert "raw.encoding: 'bayer_rgbg8' is unknown" in error
    assert all(name in error for name in ("mono8", "bayer_gbrg16", "rgb8", "yuyv", "16UC1"))


BOARD = Chessboard(7, 5, 0.03)


def board_bag(path: Path, claimed: str) -> None:
    """Views of a board as a driver sends them that calls its mosaic grey; no camera_info."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types, rng = store.types, np.random.default_rng(5)
    with Writer(path, version=9) as writer:
        connection = writer.add_connection("/camera/image_raw", "sensor_msgs/msg/Image", typestore=store)
        for index in range(10):
            view = random_chessboard_view(BOARD, CAMERA, rng)
            grey = draw_chessboard(BOARD, CAMERA, view.pose, 2.0, rng)
            # Red light: of a mosaic that is taken for grey, every second site is dark.
            color = np.dstack([cv2.convertScaleAbs(grey, alpha=gain) for gain in (1.0, 0.6, 0.3)])
            raw = mosaic(color, BayerPattern.RGGB)
            height, width = raw.shape
            stamp = types["builtin_interfaces/msg/Time"](sec=index, nanosec=0)
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="camera")
            message = types["sensor_msgs/msg/Image"](
                header=header, height=height, width=width, encoding=claimed, is_bigendian=0, step=width,
                data=raw.ravel(),
            )  # fmt: skip
            writer.write(connection, index * 10**9, store.serialize_cdr(message, "sensor_msgs/msg/Image"))


def test_the_whole_way_from_a_board_to_poses(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Calibrate a camera whose driver calls its mosaics mono8, then replay what it recorded before."""
    board_bag(tmp_path / "board", "mono8")
    out = tmp_path / "camera.yaml"
    options = ["--board", "7x5", "--square", "0.03", "--out", str(out), "-p", "raw.encoding:=bayer_rggb8"]
    assert main(["calibrate", str(tmp_path / "board"), *options]) == 0
    assert f"-p camera.info_file:={out}" in capsys.readouterr().out
    found = read_camera_info(out)
    assert found.K[0, 0] == pytest.approx(CAMERA.K[0, 0], rel=0.01)
    changed = rewritten(bag, tmp_path / "changed", called("mono8", without_info))
    rows = replayed(changed, bag, tmp_path / "out", f"camera.info_file:={out}", "raw.encoding:=bayer_rggb8")
    assert {row["pose_status"] for row in rows} == {"metric"}
    expected = replayed(bag, bag, tmp_path / "expected")
    distance = np.linalg.norm(poses(expected), axis=1)
    assert (np.linalg.norm(poses(rows) - poses(expected), axis=1) / distance).max() < 0.02
