# SPDX-License-Identifier: Apache-2.0
"""`imgu check`: exit codes, what it prints, its JSON document and its page."""

from __future__ import annotations

import json
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

from imgu_ros.cli.main import main
from imgu_ros.image_files.images import write_image

needs_aruco = pytest.mark.skipif(not hasattr(cv2, "aruco"), reason="this OpenCV has no aruco module")
#: Few and small keypoints: what is looked at here is not how well targets are found.
QUICK = ("-p", "search.thorough:=false")


def patchwork(seed: int = 3) -> np.ndarray:
    rng = np.random.default_rng(seed)
    picture = np.full((280, 360, 3), 128, np.uint8)
    for _ in range(160):
        x, y = rng.integers((0, 0), (360, 280)).tolist()
        size = rng.integers(6, 42, 2).tolist()
        cv2.rectangle(picture, (x, y), (x + size[0], y + size[1]), rng.integers(256, size=3).tolist(), -1)
    return picture


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("targets")
    write_image(folder / "good.png", patchwork())
    half = patchwork(8)[:140]
    write_image(folder / "turned.png", np.vstack((half, half[::-1, ::-1])))
    return folder


def check(*arguments: object) -> int:
    return main(["check", *map(str, arguments), *QUICK])


def test_exit_codes_say_whether_all_are_dependable(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert check(folder / "good.png") == 0
    good = capsys.readouterr()
    assert "good: score " in good.out
    assert ", dependable" in good.out
    assert "widths away" in good.out
    assert good.err == ""
    assert check(folder / "good.png", folder / "turned.png", "--width-m", 0.3) == 1
    both = capsys.readouterr().out
    assert "turned: score " in both
    assert ", not dependable" in both
    assert "looks the same turned by 180 degrees" in both


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        ((), 1, "TARGET: none"),
        (("nothing.png",), 1, "nothing.png"),
        (("tag36h11:9999",), 1, "tag36h11"),
        (("a.png", "--width-m", "0"), 1, "--width-m"),
        (("a.png", "--width-m", "nan"), 1, "--width-m"),
        (("a.png", "--camera-info", "none.yaml"), 1, "none.yaml"),
        (("a.png", "--score"), 2, "--score"),
        (("a.png", "-p", "raw.black_level:=5"), 1, "not used by this command"),
    ],
)
def test_wrong_input_is_one_line(
    arguments: tuple[str, ...], code: int, said: str, capsys: pytest.CaptureFixture[str], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert main(["check", *arguments]) == code
    err = capsys.readouterr().err
    assert said in err
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


@needs_aruco
def test_json_has_every_number(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "check.json"
    assert check(folder / "good.png", "tag36h11:7", "--width-m", 0.2, "--json", path) == 0
    capsys.readouterr()
    document = json.loads(path.read_text())
    assert document["schema"] == 1
    assert set(document) == {
        "schema", "imgu_ros", "dependable_from", "found_share", "tilt_deg", "camera", "targets",
    }  # fmt: skip
    picture, marker = document["targets"]
    for target, entry in ((picture, str(folder / "good.png")), (marker, "tag36h11:7")):
        assert set(target) == {
            "name", "entry", "score", "dependable", "width_m", "reasons", "looks_like", "smallest_width_px", "farthest",
            "found", "errors", "picture",
        }  # fmt: skip
        assert target["entry"] == entry
        assert isinstance(target["score"], int)
        assert target["dependable"] == (target["score"] >= document["dependable_from"])
        # Pinhole: width in px times distance is focal length times width.
        assert target["smallest_width_px"] * target["farthest"] == pytest.approx(600 * 0.2)
        for error in target["errors"]:
            assert error["width_px"] * error["distance"] == pytest.approx(600 * 0.2)
        assert len(target["found"]["views"]) > 20
    assert picture["picture"]["width_px"] == 360
    assert marker["reasons"] == []


@needs_aruco
def test_a_chessboard_and_a_family(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of a family one marker stands for all; a board is drawn at any size."""
    (tmp_path / "wall.yaml").write_text("chessboard: {columns: 9, rows: 6, square: 0.02}", encoding="utf-8")
    path = tmp_path / "check.json"
    assert check(tmp_path / "wall.yaml", "tag36h11:*", "--width-m", 0.18, "--json", path) == 0
    capsys.readouterr()
    wall, family = json.loads(path.read_text())["targets"]
    assert wall["entry"].endswith("wall.yaml") and "few_pixels" not in {each["kind"] for each in wall["reasons"]}
    assert (family["name"], family["entry"], family["reasons"]) == ("tag36h11", "tag36h11:*", [])


def test_json_on_stdout_stands_alone(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    check(folder / "turned.png", "--json", "-")
    (target,) = json.loads(capsys.readouterr().out)["targets"]
    assert target["picture"]["turns_deg"] == [180]
    assert "symmetric" in [reason["kind"] for reason in target["reasons"]]


def test_targets_of_a_parameter_file_are_checked(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(
        "/**:\n  ros__parameters:\n    targets:\n"
        f"      images: [{folder / 'good.png'}]\n      names: [poster]\n      widths_m: [0.5]\n"
    )
    assert main(["check", "--params-file", str(path), *QUICK]) == 0
    said = capsys.readouterr().out
    assert said.startswith("poster: score")
    assert " m away" in said


def test_camera_of_a_file_sees_from_its_own_distance(folder: Path, tmp_path: Path) -> None:
    info = tmp_path / "camera.yaml"
    info.write_text(
        "image_width: 800\nimage_height: 600\ncamera_name: c\ndistortion_model: plumb_bob\n"
        "camera_matrix: {rows: 3, cols: 3, data: [1200, 0, 400, 0, 1200, 300, 0, 0, 1]}\n"
        "distortion_coefficients: {rows: 1, cols: 5, data: [-0.2, 0.05, 0, 0, 0]}\n"
        "rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}\n"
        "projection_matrix: {rows: 3, cols: 4, data: [1200, 0, 400, 0, 0, 1200, 300, 0, 0, 0, 1, 0]}\n"
    )
    path = tmp_path / "check.json"
    assert check(folder / "good.png", "--width-m", 0.2, "--camera-info", info, "--json", path) == 0
    document = json.loads(path.read_text())
    assert document["camera"]["width"] == 800
    (target,) = document["targets"]
    assert target["smallest_width_px"] * target["farthest"] == pytest.approx(1200 * 0.2)
    assert all(error["position"] is not None for error in target["errors"][:-1])


class Page(HTMLParser):
    """Checks that tags are closed in turn, and gathers what the page would load, and its text."""

    VOID = ("meta", "img", "br", "link", "input", "hr")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.sources: list[str] = []
        self.ids: list[str] = []
        self.text = ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert tag != "script"
        for name, value in attrs:
            assert not name.startswith("on")
            if name in ("src", "href"):
                self.sources.append(value or "")
            if name == "id":
                self.ids.append(value or "")
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] != "style":
            self.text += data


def test_page_is_well_formed_self_contained_and_escapes_names(folder: Path, tmp_path: Path) -> None:
    hostile = tmp_path / "<img src=x onerror=alert(1)>&\x1b[31m'\".png"
    hostile.write_bytes((folder / "turned.png").read_bytes())
    page = tmp_path / "page.html"
    assert check(hostile, folder / "good.png", "--report", page) == 1
    text = page.read_text(encoding="utf-8")
    parsed = Page(text)
    assert "<img src=x" not in text
    assert "\x1b" not in text
    assert parsed.sources
    assert all(source.startswith(("data:image/png;base64,", "#target-")) for source in parsed.sources)
    assert {source[1:] for source in parsed.sources if source.startswith("#")} <= set(parsed.ids)
    for words in ("What to change", "looks the same turned by 180 degrees", "How small it may be", "good"):
        assert words in parsed.text
    pictures = [source for source in parsed.sources if source.startswith("data:")]
    # Of the symmetric one also what tells which way round it is; of both two plots.
    assert len(pictures) >= 10


def test_a_transparent_picture_is_said(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pixels = np.dstack((patchwork()[:, :, ::-1], np.full((280, 360), 255, np.uint8)))
    pixels[:60, :60, 3] = 0
    cv2.imwrite(str(tmp_path / "sticker.png"), pixels)
    check(tmp_path / "sticker.png")
    said = capsys.readouterr()
    assert "transparent" in said.err
    assert "without transparency" in said.out


def test_blank_picture_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_image(tmp_path / "blank.png", np.full((200, 200, 3), 255, np.uint8))
    assert check(tmp_path / "blank.png") == 1
    assert "blank" in capsys.readouterr().err


@needs_aruco
def test_boards_and_bundles_are_checked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A board has an origin of its own; a bundle is checked marker by marker."""
    (tmp_path / "board.yaml").write_text(
        "family: tag36h11\nsize: 0.08\nmarkers:\n- {id: 3, x: 0.1, y: 0.2}\n- {id: 4, x: 0.3, y: 0.2}\n"
    )
    (tmp_path / "cube.yaml").write_text(
        "family: tag36h11\nsize: 0.08\nmarkers:\n- {id: 0, z: 0.05}\n- {id: 2, y: 0.05, roll_deg: -90}\n"
    )
    assert check(tmp_path / "board.yaml", tmp_path / "cube.yaml", "--json", tmp_path / "c.json") == 0
    capsys.readouterr()
    board, *faces = json.loads((tmp_path / "c.json").read_text())["targets"]
    assert board["width_m"] == pytest.approx(0.28)
    assert board["score"] > 80
    assert board["smallest_width_px"] * board["farthest"] == pytest.approx(600 * 0.28)
    assert board["errors"][0]["position"] < 0.001
    assert [face["name"] for face in faces] == ["cube/tag36h11:0", "cube/tag36h11:2"]
    assert {face["width_m"] for face in faces} == {0.08}
