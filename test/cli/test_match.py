# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image as Pillow

from imgu_ros.cli.main import main
from imgu_ros.cli.match import INTERPOLATIONS
from imgu_ros.files.camera_info_file import write_camera_info
from imgu_ros.image_files.images import read_image, write_image
from imgu_ros.simulate.geometry import image_from_template, rotation_about, target_from_template
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.simulate.truth import corner_error
from imgu_ros.vision.camera.intrinsics import make_camera
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.formation.cfa import BayerPattern, mosaic
from imgu_ros.vision.processing.interpolation import Interpolation

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
    assert corner_error(found["H"], H, TEMPLATE, SIZE) < 0.04
    assert found["pose_status"] == "metric"
    assert np.linalg.norm(np.array(found["pose"]["position_m"]) - POSE.t) < 0.003
    assert len(found["matches"]["inlier"]) == found["n_matches"]
    assert read_image(tmp_path / "m.png").shape == (480, 640, 3)


@pytest.mark.parametrize(
    ("suffix", "start"), [(".svg", b"<?xml"), (".pdf", b"%PDF"), (".eps", b"%!PS"), (".jpg", b"\xff\xd8")]
)
def test_drawn_in_other_formats(scene: Path, tmp_path: Path, suffix: str, start: bytes) -> None:
    path = tmp_path / f"m{suffix}"
    assert main(["match", str(scene / "poster.png"), str(scene / "view.png"), "--draw", str(path)]) == 0
    assert path.read_bytes().startswith(start)
    if suffix == ".svg":
        content = path.read_text(encoding="utf-8")
        assert content.count("<image") == 1
        assert "points agree" in content


def test_a_width_in_centimetres_is_said(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--width-m", str(100 * WIDTH_M), "--camera-info", str(scene / "camera.yaml")]
    assert main(["match", str(scene / "poster.png"), str(scene / "view.png"), *options]) == 0
    said = capsys.readouterr().err
    assert said.startswith("imgu: warning: targets.widths_m 30: poster would be 30 m wide and 45")
    assert "did you mean 0.3 (30 cm)" in said


@pytest.mark.parametrize("error", [0.0, 0.06])
def test_a_calibration_that_does_not_fit_is_said(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], error: float
) -> None:
    wrong = make_camera(CAMERA.K * [[1 + error, 1, 1], [1, 1 + error, 1], [1, 1, 1]], (), "plumb_bob", *SIZE)
    write_camera_info(tmp_path / "camera.yaml", wrong)
    document = tmp_path / "found.json"
    options = ["--width-m", str(WIDTH_M), "--camera-info", str(tmp_path / "camera.yaml"), "--json", str(document)]
    assert main(["match", str(scene / "poster.png"), str(scene / "view.png"), *options]) == 0
    assert ("camera_info does not fit what is seen" in capsys.readouterr().err) == bool(error)
    calibration = json.loads(document.read_text())["calibration"]
    assert calibration["views"] == 1
    assert bool(calibration["warning"]) == bool(error)


def test_without_a_camera_there_is_no_pose(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["match", str(scene / "poster.png"), str(scene / "view.png")]) == 0
    out = capsys.readouterr().out
    assert "no pose" in out
    assert "position" not in out


@pytest.mark.parametrize("name", ["tagged.png", "tagged.jpg", "tagged.tif"])
@pytest.mark.parametrize("orientation", [3, 6, 7])
def test_an_orientation_tag_does_not_turn_the_sensor(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, orientation: int
) -> None:
    """The target is turned as viewers show it; the photo's pixels belong to the camera and stay."""
    exif = Pillow.Exif()
    exif[0x0112] = orientation
    Pillow.fromarray(read_image(scene / "view.png")).save(tmp_path / name, exif=exif)
    options = [
        "--camera-info",
        str(scene / "camera.yaml"),
        "--width-m",
        str(WIDTH_M),
        "--json",
        str(tmp_path / "m.json"),
    ]
    assert main(["match", str(scene / "poster.png"), str(tmp_path / name), *options]) == 0
    assert capsys.readouterr().err.count(f"{name}: orientation tag {orientation} ignored") == 1
    found = json.loads((tmp_path / "m.json").read_text())
    assert np.linalg.norm(np.array(found["pose"]["position_m"]) - POSE.t) < 0.003
    # A poster that was photographed upside down, and says so.
    exif[0x0112] = 3
    Pillow.fromarray(read_image(scene / "poster.png")[::-1, ::-1]).save(tmp_path / "poster.png", exif=exif)
    assert main(["match", str(tmp_path / "poster.png"), str(scene / "view.png"), *options]) == 0
    found = json.loads((tmp_path / "m.json").read_text())
    assert np.linalg.norm(np.array(found["pose"]["position_m"]) - POSE.t) < 0.003
    assert capsys.readouterr().err == ""


def test_a_photo_with_transparency_is_composed(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    view = read_image(scene / "view.png")
    clear = (view == 90).all(axis=2)
    hidden = np.where(clear[..., None], np.random.default_rng(0).integers(0, 255, view.shape, np.uint8), view)
    Pillow.fromarray(np.dstack((hidden, np.where(clear, 0, 255).astype(np.uint8)))).save(tmp_path / "view.png")
    assert (
        main(["match", str(scene / "poster.png"), str(tmp_path / "view.png"), "--json", str(tmp_path / "m.json")]) == 0
    )
    assert capsys.readouterr().err == f"imgu: warning: {tmp_path / 'view.png'}: transparent: composed on white\n"
    assert corner_error(json.loads((tmp_path / "m.json").read_text())["H"], H, TEMPLATE, SIZE) < 0.04


def test_parameters_give_the_camera_and_the_pattern_too(scene: Path, tmp_path: Path) -> None:
    """`--camera-info` and `--pattern` are short for them; the short form counts where both are given."""
    short = ["--camera-info", str(scene / "camera.yaml"), "--pattern", "gbrg"]
    long = ["-p", f"camera.info_file:={scene / 'camera.yaml'}", "-p", "raw.encoding:=bayer_gbrg8"]
    over = ["-p", f"camera.info_file:={tmp_path / 'none.yaml'}", *short]
    found = []
    for index, options in enumerate((short, long, over)):
        out = tmp_path / f"{index}.json"
        arguments = [str(scene / "poster.png"), str(scene / "raw.png"), "--width-m", str(WIDTH_M), "--json", str(out)]
        assert main(["match", *arguments, *options]) == 0
        found.append(json.loads(out.read_text()))
    assert found[0]["pose_status"] == "metric"
    assert found[0]["pose"] == found[1]["pose"] == found[2]["pose"]


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["-p", "raw.encoding:=bayer_gbrg16"], "1 channel of uint8; need 1 of uint16 for raw.encoding bayer_gbrg16"),
        (["-p", "raw.encoding:=rgb8"], "1 channel of uint8; need 3 of uint8 for raw.encoding rgb8"),
        (["-p", "raw.encoding:=bayer_rggb8", "--pattern", "gbrg"], "--pattern: gbrg with raw.encoding bayer_rggb8"),
        (["-p", "camera.info_file:=no.yaml"], "no.yaml: No such file"),
    ],
)
def test_what_an_image_cannot_be(
    scene: Path, capsys: pytest.CaptureFixture[str], options: list[str], text: str
) -> None:
    assert main(["match", str(scene / "poster.png"), str(scene / "raw.png"), *options]) == 1
    assert text in capsys.readouterr().err


def test_a_mosaic(scene: Path, tmp_path: Path) -> None:
    options = ["--pattern", "gbrg", "--json", str(tmp_path / "m.json")]
    assert main(["match", str(scene / "poster.png"), str(scene / "raw.png"), *options]) == 0
    assert corner_error(json.loads((tmp_path / "m.json").read_text())["H"], H, TEMPLATE, SIZE) < 0.1


def psnr(picture: np.ndarray, truth: np.ndarray) -> float:
    """Without a margin of 8 px, where the view's surroundings come in."""
    difference = (picture.astype(float) - truth)[8:-8, 8:-8]
    return float(20 * np.log10(255 / np.sqrt((difference**2).mean())))


def test_warp_draws_the_target_straight_on(scene: Path, tmp_path: Path) -> None:
    truth = read_image(scene / "poster.png")
    blurred = {}
    for name in ("area", "cubic"):
        path = tmp_path / f"{name}.png"
        options = ["--warp", str(path), "--interpolation", name]
        assert main(["match", str(scene / "poster.png"), str(scene / "view.png"), *options]) == 0
        rectified = read_image(path)
        assert rectified.shape == truth.shape and rectified.dtype == truth.dtype
        # The view is the smaller of the two: what it lost in detail is lost.
        blurred[name] = psnr(rectified, truth)
        by_truth = cv2.warpPerspective(read_image(scene / "view.png"), np.linalg.inv(H), TEMPLATE)
        assert psnr(rectified, by_truth) > 34
    assert min(blurred.values()) > 20
    assert blurred["area"] != blurred["cubic"]


def test_warp_of_a_mosaic_through_a_lens(scene: Path, tmp_path: Path) -> None:
    camera = make_camera(CAMERA.K, (-0.25, 0.05), "plumb_bob", *SIZE)
    y, x = np.mgrid[0 : SIZE[1], 0 : SIZE[0]].reshape(2, -1).astype(float)
    ideal = camera.ideal_pixels(np.column_stack((x, y)))[0].astype(np.float32).reshape(SIZE[1], SIZE[0], 2)
    bent = cv2.remap(read_image(scene / "view.png"), ideal, None, cv2.INTER_CUBIC, borderValue=(90, 90, 90))
    write_image(tmp_path / "bent.png", mosaic(bent, BayerPattern.RGGB).astype(np.uint16) * 257)
    write_camera_info(tmp_path / "lens.yaml", camera)
    options = ["--pattern", "rggb", "-p", "demosaic.method:=residual", "-p", "raw.significant_bits:=16"]
    options += ["--camera-info", str(tmp_path / "lens.yaml"), "--warp", str(tmp_path / "warped.tif")]
    assert main(["match", str(scene / "poster.png"), str(tmp_path / "bent.png"), *options]) == 0
    rectified = read_image(tmp_path / "warped.tif")
    assert rectified.dtype == np.uint16 and rectified.shape == (*TEMPLATE[::-1], 3)
    by_truth = cv2.warpPerspective(read_image(scene / "view.png"), np.linalg.inv(H), TEMPLATE)
    assert psnr(rectified / 257, by_truth) > 28


def test_warp_of_a_grey_picture_is_grey_and_none_is_written_when_nothing_is_found(scene: Path, tmp_path: Path) -> None:
    grey = cv2.cvtColor(read_image(scene / "view.png"), cv2.COLOR_RGB2GRAY)
    write_image(tmp_path / "grey.png", grey)
    out = tmp_path / "warped.pgm"
    assert main(["match", str(scene / "poster.png"), str(tmp_path / "grey.png"), "--warp", str(out)]) == 0
    assert read_image(out).shape == TEMPLATE[::-1]
    out.unlink()
    assert main(["match", str(scene / "poster.png"), str(scene / "blank.png"), "--warp", str(out)]) == 1
    assert not out.exists()


def test_interpolations_are_those_of_the_library() -> None:
    assert set(INTERPOLATIONS) == set(Interpolation)


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
        ("poster.png", "view.png", ["--draw", "m.xyz"], "need one of .png"),
        ("poster.png", "view.png", ["--draw", "no/such/folder/m.svg"], "m.svg"),
        ("poster.png", "view.png", ["--warp", "w.svg"], "need one of .png"),
        ("poster.png", "view.png", ["--warp", "w.pgm"], "need (H, W) in a .pgm file"),
        ("poster.png", "view.png", ["--warp", "no/such/folder/w.png"], "w.png"),
        ("poster.png", "view.png", ["--interpolation", "cubic"], "need --warp"),
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


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ((r"image_width: \d+", "image_width: 320"), "need the same size"),
        ((r"data: \[\d[^\]]*\]", "data: [1, 0, 0, 0, 1, 0, 0, 0, 1]"), "K is the identity"),
        ((r"distortion_model: \w+", "distortion_model: ds"), "distortion_model 'ds' is not computed"),
    ],
)
def test_an_unusable_calibration_costs_the_pose_alone(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: tuple[str, str], says: str
) -> None:
    text = (scene / "camera.yaml").read_text()
    text = re.sub(*change, text, count=1)
    text = re.sub(r"(distortion_coefficients:\s+rows: 1\s+cols: 5\s+data: )\[[^\]]*\]", r"\1[0.1, 0.1, 0, 0, 0]", text)
    (tmp_path / "odd.yaml").write_text(text)
    options = ["--camera-info", str(tmp_path / "odd.yaml"), "--width-m", "0.5", "--json", str(tmp_path / "m.json")]
    assert main(["match", str(scene / "poster.png"), str(scene / "view.png"), *options]) == 0
    said = capsys.readouterr()
    assert [says in line for line in said.err.splitlines()] == [True]
    found = json.loads((tmp_path / "m.json").read_text())
    assert (found["pose"], found["pose_status"]) == (None, "uncalibrated")
    assert says in found["reason"]
    assert found["H"] is not None
