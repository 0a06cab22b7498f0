# SPDX-License-Identifier: Apache-2.0
"""`imgu calibrate`, from simulated pictures and bags to the YAML, and one line for every bad input."""

from __future__ import annotations

import json
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from PIL import Image as Pillow

from imgu_ros.cli.board_views import find_board_views
from imgu_ros.cli.main import main
from imgu_ros.config.parameters import Parameters
from imgu_ros.errors import TooFewPoints
from imgu_ros.files.camera_info_file import read_camera_info, read_camera_name
from imgu_ros.image_files.images import read_image, write_image
from imgu_ros.simulate.chessboard import draw_chessboard, random_chessboard_view
from imgu_ros.vision.camera.chessboard import Chessboard
from imgu_ros.vision.camera.intrinsics import make_camera
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.camera.rotation import exp_so3
from imgu_ros.vision.formation.cfa import BayerPattern, mosaic

BOARD = Chessboard(7, 5, 0.03)
CAMERA = make_camera([[420, 0, 318], [0, 415, 243], [0, 0, 1]], (-0.2, 0.05), "plumb_bob", 640, 480)
OPTIONS = ["--board", "7x5", "--square", "0.03"]
COUNT = 6


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pictures")
    rng = np.random.default_rng(5)
    for index in range(COUNT):
        view = random_chessboard_view(BOARD, CAMERA, rng)
        write_image(folder / f"view{index}.png", draw_chessboard(BOARD, CAMERA, view.pose, 2.0, rng))
    return folder


def sheet(folder: Path, name: str, shape: tuple[int, ...] = (480, 640)) -> Path:
    write_image(folder / name, np.full(shape, 128, np.uint8))
    return folder / name


def calibrate(*arguments: object) -> int:
    return main(["calibrate", *(str(argument) for argument in arguments)])


def test_pictures_to_yaml_json_and_picture(pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    blank = sheet(tmp_path, "blank.png")
    other = tmp_path / "small.png"
    write_image(other, cv2.resize(read_image(pictures / "view1.png"), (480, 360), interpolation=cv2.INTER_AREA))
    out, document, drawn = tmp_path / "camera.yaml", tmp_path / "c.json", tmp_path / "r.png"
    files = ["--out", out, "--json", document, "--picture", drawn]
    assert calibrate(pictures, blank, other, *OPTIONS, *files, "--name", "left") == 0
    said = capsys.readouterr().out
    assert f"{COUNT} of {COUNT + 2} pictures used" in said
    assert f"{blank}: no board found" in said
    assert "480 x 360 px; the others have 640 x 480" in said
    found = read_camera_info(out)
    assert read_camera_name(out) == "left"
    content = json.loads(document.read_text())
    assert content["names"][:5] == ["fx", "fy", "cx", "cy", "k1"]
    covariance = np.array(content["covariance"])
    error = np.array([found.K[i] - CAMERA.K[i] for i in ((0, 0), (1, 1), (0, 2), (1, 2))])
    assert error @ np.linalg.solve(covariance[:4, :4], error) < 25
    assert np.sqrt(np.diag(covariance)) == pytest.approx(content["sigma"])
    # The file brings it into every pose that is made with it.
    assert found.covariance == pytest.approx(covariance, rel=1e-12)
    assert content["rms_px"] < 0.1
    assert len(content["views"]) == COUNT
    assert {refused["reason"] for refused in content["refused"]} == {
        "no board found", "480 x 360 px; the others have 640 x 480"
    }  # fmt: skip
    assert read_image(drawn).shape[2] == 3
    assert calibrate(pictures, *OPTIONS, "--out", out) == 1
    assert "--overwrite" in capsys.readouterr().err
    assert calibrate(pictures, *OPTIONS, "--out", out, "--overwrite", "--model", "equidistant") == 0
    assert str(read_camera_info(out).model) == "equidistant"


def test_mosaics_in_files(pictures: Path, tmp_path: Path) -> None:
    for path in sorted(pictures.iterdir())[:4]:
        grey = read_image(path).astype(np.uint16) * 16
        write_image(tmp_path / path.name, mosaic(np.dstack((grey, grey, grey)), BayerPattern.GRBG))
    assert calibrate(tmp_path, *OPTIONS, "--pattern", "grbg", "--out", tmp_path / "c.yaml") == 0
    by_encoding = tmp_path / "d.yaml"
    assert calibrate(tmp_path, *OPTIONS, "-p", "raw.encoding:=bayer_grbg16", "--out", by_encoding) == 0
    assert by_encoding.read_text() == (tmp_path / "c.yaml").read_text()
    assert read_camera_info(tmp_path / "c.yaml").K[0, 0] == pytest.approx(420, rel=0.02)


def test_orientation_tags_do_not_turn_the_sensor(
    pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A telephone held upright in some of the pictures: their pixels are the sensor's all the same."""
    for index, path in enumerate(sorted(pictures.iterdir())):
        exif = Pillow.Exif()
        exif[0x0112] = (1, 6, 3, 8, 6, 1)[index]
        Pillow.fromarray(read_image(path)).save(tmp_path / path.name, exif=exif)
    for folder, name in ((pictures, "a.yaml"), (tmp_path, "b.yaml")):
        assert calibrate(folder, *OPTIONS, "--out", tmp_path / name) == 0
    said = capsys.readouterr().out
    assert f"warning: {tmp_path / 'view1.png'} and 1 other: orientation tag 6 ignored" in said
    assert said.count("ignored") == 3
    assert np.array_equal(read_camera_info(tmp_path / "a.yaml").K, read_camera_info(tmp_path / "b.yaml").K)


def test_a_bag_of_mosaics_with_still_stretches(
    pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = tmp_path / "bag"
    write_bag(bag, [read_image(path) for path in sorted(pictures.iterdir())], repeated=3)
    out = tmp_path / "c.yaml"
    assert calibrate(bag, *OPTIONS, "--out", out, "--topic", "/camera/image_raw") == 0
    assert f"{COUNT} of {3 * COUNT} pictures used" in capsys.readouterr().out
    assert read_camera_info(out).K[0, 0] == pytest.approx(420, rel=0.02)
    assert calibrate(bag, *OPTIONS, "--out", out, "--overwrite", "--topic", "/no") == 1
    assert "/no is not in the bag" in capsys.readouterr().err


def test_a_video(pictures: Path, tmp_path: Path) -> None:
    """Each view stays for a moment, as when the board is held by hand; the codec costs some of the accuracy."""
    with av.open(str(tmp_path / "board.mp4"), "w") as container:
        stream = container.add_stream("libx264", rate=30, options={"crf": "14"})
        stream.width, stream.height, stream.pix_fmt = 640, 480, "yuv420p"
        for path in sorted(pictures.iterdir()):
            grey = read_image(path)
            for _ in range(3):
                container.mux(stream.encode(av.VideoFrame.from_ndarray(np.dstack([grey] * 3), format="rgb24")))
        container.mux(stream.encode())
    assert calibrate(tmp_path / "board.mp4", *OPTIONS, "--out", tmp_path / "camera.yaml") == 0
    found = read_camera_info(tmp_path / "camera.yaml")
    assert found.covariance is not None
    error = np.array([found.K[i] - CAMERA.K[i] for i in ((0, 0), (1, 1), (0, 2), (1, 2))])
    assert error @ np.linalg.solve(found.covariance[:4, :4], error) < 40


def write_bag(path: Path, greys: list[np.ndarray], repeated: int) -> None:
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    types = store.types
    with Writer(path, version=9) as writer:
        connection = writer.add_connection("/camera/image_raw", "sensor_msgs/msg/Image", typestore=store)
        for index in range(len(greys) * repeated):
            grey = greys[index // repeated]
            stamp = types["builtin_interfaces/msg/Time"](sec=index, nanosec=0)
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="camera")
            raw = mosaic(np.dstack((grey, grey, grey)), BayerPattern.RGGB)
            height, width = raw.shape
            message = types["sensor_msgs/msg/Image"](
                header=header, height=height, width=width, encoding="bayer_rggb8", is_bigendian=0, step=width,
                data=raw.ravel(),
            )  # fmt: skip
            writer.write(connection, index * 10**9, store.serialize_cdr(message, "sensor_msgs/msg/Image"))


def test_copies_are_refused(pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same picture six times, as files and as the frames of a bag in which nothing moves."""
    one, rng = read_image(pictures / "view0.png"), np.random.default_rng(0)
    folders = {name: tmp_path / name for name in ("same", "jpeg", "noise")}
    for folder in folders.values():
        folder.mkdir()
    for index in range(6):
        (folders["same"] / f"{index}.png").write_bytes((pictures / "view0.png").read_bytes())
        write_image(folders["jpeg"] / f"{index}.jpg", one, quality=95 - 10 * index)
        noisy = np.clip(one + rng.normal(0, 4, one.shape), 0, 255).astype(np.uint8)
        write_image(folders["noise"] / f"{index}.png", noisy)
    write_bag(tmp_path / "bag", [one], repeated=30)
    for path, count in ((folders["same"], 6), (folders["jpeg"], 6), (folders["noise"], 6), (tmp_path / "bag", 30)):
        assert calibrate(path, *OPTIONS, "--out", tmp_path / "c.yaml") == 1
        assert f"{count} pictures show 1 different view of the 7x5 board; need at least 3" in capsys.readouterr().err
        assert not (tmp_path / "c.yaml").exists()


def test_one_tilt_is_warned_of(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(1)
    for index in range(9):
        R = exp_so3(rng.normal(0, 0.05, 3) + (0.6, 0, 0))
        t = np.array([0.12 * (index % 3 - 1), 0.07 * (index // 3 - 1), 0.45])
        centre = BOARD.corners().mean(axis=0)
        pose = RigidTransform(R, t - R[:, :2] @ centre)
        write_image(tmp_path / f"{index}.png", draw_chessboard(BOARD, CAMERA, pose, 2.0, rng))
    assert calibrate(tmp_path, *OPTIONS, "--out", tmp_path / "c.yaml") == 0
    assert "warning: the board's tilt differs by" in capsys.readouterr().out


def test_bad_input_is_one_line(pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    blank, empty = sheet(tmp_path, "blank.png"), tmp_path / "empty"
    empty.mkdir()
    text = tmp_path / "notes.png"
    text.write_text("no picture")
    views = [pictures / f"view{index}.png" for index in range(COUNT)]
    cases: list[tuple[list[object], str]] = [
        ([blank], "no 7x5 board found in 1 pictures"),
        ([views[0], "--board", "8x6"], "but a 7x5 one; need --board with the number of inner corners"),
        (views[:2], "views: 2 pictures show 2 different views of the 7x5 board; need at least 3"),
        ([views[0]] * 3, "views: 3 pictures show 1 different view of the 7x5 board; need at least 3"),
        ([views[0]] * 3, "tilted in different directions; 2 x like another view"),
        ([text], "none of 1 pictures can be read"),
        ([tmp_path / "no.png"], "no.png"),
        ([empty], "no image in it"),
        ([tmp_path / "no.mcap"], "no.mcap"),
        ([views[0], tmp_path / "x.bag"], "bags and images mixed"),
        ([*views, "--board", "2x5"], "need 3 to 100"),
        ([*views, "--out", tmp_path / "no" / "c.yaml"], "its folder does not exist"),
        ([*views, "--out", tmp_path], "a folder"),
        ([*views, "--picture", tmp_path / "r.xyz"], "need one of .png, .svg, .pdf, .eps, .ps"),
        ([*views, "-p", "no.such:=1"], "no.such"),
    ]
    for index, (arguments, expected) in enumerate(cases):
        options = [*OPTIONS, "--out", tmp_path / f"c{index}.yaml"]
        assert calibrate(*options, *arguments) == 1, arguments
        said = capsys.readouterr().err
        error = [line for line in said.splitlines() if line.startswith("imgu: error: ")]
        assert len(error) == 1
        assert expected in error[0]
    for arguments in (["--board", "9"], ["--square", "-1"], ["--max-views", "2"], ["--model", "fisheye"]):
        assert calibrate(*views, *OPTIONS, *arguments) == 2


def test_the_search_for_other_boards_says_how_far_it_is(pictures: Path) -> None:
    calls: list[tuple[int, int | None]] = []
    with pytest.raises(TooFewPoints, match="but a 7x5 one; need --board"):
        find_board_views(
            [pictures / "view0.png"],
            Chessboard(8, 6, 0.03),
            Parameters(),
            on_trial=lambda done, total: calls.append((done, total)),
        )
    # One more and two fewer along each side, but for the board itself: 15, the largest first.
    assert calls == [(index, 15) for index in range(len(calls))]
    assert len(calls) > 1
