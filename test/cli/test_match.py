from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from imgu_ros.cli.main import main
from imgu_ros.files.camera_info_file import write_camera_info
from imgu_ros.files.images import read_image, write_image
from imgu_ros.simulate.geometry import image_from_template, rotation_about, target_from_template
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.simulate.truth import corner_error
from imgu_ros.vision.camera.intrinsics import make_camera
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.formation.cfa import BayerPattern, mosaic

SIZE = (640, 480)
TEMPLATE = (480, 360)
WIDTH_M = 0.3
CAMERA = make_camera([[600, 0, 322], [0, 600, 238], [0, 0, 1]], (), "plumb_bob", *SIZE)
TURN = rotation_about(np.array([1.0, 0.4, 0.0]), 0.6) @ np.diag([1.0, -1.0, -1.0])
POSE = RigidTransform(TURN, np.array([0.02, -0.01, 0.45]))
H = image_from_template(CAMERA.K, POSE, target_from_template(TEMPLATE, WIDTH_M))


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scene")
    picture = procedural_texture(*TEMPLATE, seed=3)
    view = cv2.warpPerspective(picture, H, SIZE, flags=cv2.INTER_AREA, borderValue=(90, 90, 90))
    write_image(folder / "poster.png", picture)
    write_image(folder / "view.png", view)
    write_image(folder / "raw.png", mosaic(view, BayerPattern.GBRG))
    write_image(folder / "blank.png", np.full((480, 640), 128, np.uint8))
    write_camera_info(folder / "camera.yaml", CAMERA)
    return folder


def test_homography_pose_json_and_drawing(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--json", str(tmp_path / "m.json"), "--draw", str(tmp_path / "m.png"), "--width-m", str(WIDTH_M)]
    options += ["--camera-info", str(scene / "camera.yaml")]
    assert main(["match", str(scene / "poster.png"), str(scene / "view.png"), *options]) == 0
    out = capsys.readouterr().out
    assert out.startswith("poster: detected")
    found = json.loads((tmp_path / "m.json").read_text())
    assert found["status"] == "detected"
    assert corner_error(found["H"], H, TEMPLATE, SIZE) < 0.5
    assert found["pose_status"] == "metric"
    assert np.linalg.norm(np.array(found["pose"]["position_m"]) - POSE.t) < 0.003
    assert len(found["matches"]["inlier"]) == found["n_matches"]
    assert read_image(tmp_path / "m.png").shape == (480, 640, 3)


@pytest.mark.parametrize(("suffix", "start"), [(".svg", b"<?xml"), (".pdf", b"%PDF"), (".jpg", b"\xff\xd8")])
def test_drawn_in_other_formats(scene: Path, tmp_path: Path, suffix: str, start: bytes) -> None:
    path = tmp_path / f"m{suffix}"
    assert main(["match", str(scene / "poster.png"), str(scene / "view.png"), "--draw", str(path)]) == 0
    assert path.read_bytes().startswith(start)
    if suffix == ".svg":
        content = path.read_text(encoding="utf-8")
        assert content.count("<image") == 1
        assert "points agree" in content


def test_without_a_camera_there_is_no_pose(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["match", str(scene / "poster.png"), str(scene / "view.png")]) == 0
    out = capsys.readouterr().out
    assert "no pose" in out
    assert "position" not in out


def test_a_mosaic(scene: Path, tmp_path: Path) -> None:
    options = ["--pattern", "gbrg", "--json", str(tmp_path / "m.json")]
    assert main(["match", str(scene / "poster.png"), str(scene / "raw.png"), *options]) == 0
    assert corner_error(json.loads((tmp_path / "m.json").read_text())["H"], H, TEMPLATE, SIZE) < 0.5


def test_not_found_exits_1_with_the_reason(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["match", str(scene / "poster.png"), str(scene / "blank.png")]) == 1
    said = capsys.readouterr()
    assert said.out.startswith("poster: ")
    assert said.err.startswith("imgu: error: ")
    assert "poster not found: " in said.err
    assert said.err.count("\n") == 1


@pytest.mark.parametrize(
    ("target", "image", "options", "said"),
    [
        ("no_such.png", "view.png", [], "no_such.png"),
        ("poster.png", "no_such.png", [], "no_such.png"),
        ("camera.yaml", "view.png", [], "camera.yaml"),
        ("blank.png", "view.png", [], "blank"),
        ("poster.png", "view.png", ["--width-m", "-1"], "widths_m"),
        ("poster.png", "view.png", ["--camera-info", "poster.png"], "poster.png"),
        ("poster.png", "view.png", ["--pattern", "rggb"], "--pattern"),
        ("poster.png", "poster.png", ["--camera-info", "camera.yaml"], "need the same size"),
        ("poster.png", "view.png", ["--draw", "m.xyz"], "need one of .png"),
        ("poster.png", "view.png", ["--draw", "no/such/folder/m.svg"], "m.svg"),
        ("poster.png", "view.png", ["--json", "no/such/folder/m.json"], "m.json"),
        ("poster.png", "view.png", ["-p", "matching.ratio:=2.0"], "matching.ratio"),
    ],
)
def test_bad_input_is_one_line(
    scene: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    target: str,
    image: str,
    options: list[str],
    said: str,
) -> None:
    monkeypatch.chdir(scene)
    assert main(["match", target, image, *options]) == 1
    err = capsys.readouterr().err
    assert err.startswith("imgu: error: ")
    assert err.count("\n") == 1
    assert said in err
