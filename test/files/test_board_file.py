# SPDX-License-Identifier: Apache-2.0
"""Board files: what they say, and what is wrong with them."""

from __future__ import annotations

import contextlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from imgu_ros.config.parameters import LimitsParameters, TargetsParameters
from imgu_ros.errors import FileError, ParameterError
from imgu_ros.files.board_file import board_of, markers_of, read_board
from imgu_ros.files.target_images import load_target_images
from imgu_ros.image_files.images import write_image
from imgu_ros.reference.bundle import BundleImage
from imgu_ros.reference.marker import BoardImage
from imgu_ros.reference.marker_layout import MarkerLayout

pytestmark = pytest.mark.skipif(not hasattr(cv2, "aruco"), reason="this OpenCV has no aruco module")

GRID = "grid: {family: tag36h11, rows: 2, columns: 3, size: 0.08, gap: 0.02, first_id: 4}\n"
TWO = "family: tag36h11\nsize: 0.1\nmarkers:\n- {id: 1}\n- {id: 2, x: 0.2, size: 0.05, turn_deg: -90}\n"


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "board.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def loaded(path: Path, *others: str, **more: object) -> BoardImage:
    image = load_target_images(TargetsParameters(images=(str(path), *others), **more))[0]  # type: ignore[arg-type]
    assert isinstance(image, BoardImage)
    return image


def test_a_list_of_markers(tmp_path: Path) -> None:
    layout = read_board(written(tmp_path, TWO))
    assert isinstance(layout, MarkerLayout)
    first, second = layout.markers
    assert (str(first), first.size, first.x, first.y, first.quarter_turns) == ("tag36h11:1", 0.1, 0, 0, 0)
    assert (str(second), second.size, second.x, second.y, second.quarter_turns) == ("tag36h11:2", 0.05, 0.2, 0, 3)


def test_a_grid_is_numbered_row_by_row_about_the_origin(tmp_path: Path) -> None:
    layout = read_board(written(tmp_path, GRID))
    assert isinstance(layout, MarkerLayout)
    assert [str(marker) for marker in layout.markers] == [f"tag36h11:{n}" for n in range(4, 10)]
    places = [(marker.x, marker.y) for marker in layout.markers]
    assert np.allclose(places, [(-0.1, 0.05), (0, 0.05), (0.1, 0.05), (-0.1, -0.05), (0, -0.05), (0.1, -0.05)])
    assert layout.width == pytest.approx(0.28)


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize(("columns", "rows"), [(5, 3), (4, 6), (3, 4)])
@pytest.mark.parametrize("family", ["aruco_4x4_50", "tag36h11"])
def test_a_charuco_board_is_opencvs(tmp_path: Path, family: str, columns: int, rows: int, legacy: bool) -> None:
    """Pixel by pixel what OpenCV draws; the legacy pattern is that of versions before 4.6."""
    entry = f"{{family: {family}, columns: {columns}, rows: {rows}, square: 0.04, size: 0.03, legacy: {legacy}}}"
    image = loaded(written(tmp_path, f"charuco: {entry}"))
    name = {"aruco_4x4_50": cv2.aruco.DICT_4X4_50, "tag36h11": cv2.aruco.DICT_APRILTAG_36h11}[family]
    if not hasattr(cv2.aruco, "ArucoDetector"):
        pytest.skip("boards of this OpenCV have another interface")
    board = cv2.aruco.CharucoBoard((columns, rows), 0.04, 0.03, cv2.aruco.getPredefinedDictionary(name))
    board.setLegacyPattern(legacy)
    height, width = image.pixels.shape
    assert np.array_equal(image.pixels, board.generateImage((width, height)))
    assert image.width_m == pytest.approx(0.04 * columns)


def test_a_width_scales_the_board(tmp_path: Path) -> None:
    """0, or none: as the file says."""
    path = written(tmp_path, GRID)
    assert loaded(path).width_m == loaded(path, widths_m=(0.0,)).width_m == pytest.approx(0.28)
    assert loaded(path, widths_m=(0.56,)).width_m == 0.56
    assert loaded(path).name == "board"


def test_boards_markers_and_pictures_in_one_list(tmp_path: Path) -> None:
    write_image(tmp_path / "poster.png", np.random.default_rng(0).integers(0, 256, (40, 60, 3), np.uint8))
    entries = (str(written(tmp_path, GRID)), str(tmp_path / "poster.png"), "tag36h11:3", "aruco_4x4_50:4")
    images = load_target_images(TargetsParameters(images=entries, widths_m=(0, 0.5, 0.1, 0.1)))
    assert [image.kind for image in images] == ["board", "", "marker", "marker"]


def test_a_marker_belongs_to_one_target(tmp_path: Path) -> None:
    path = written(tmp_path, GRID)
    other = tmp_path / "other.yaml"
    other.write_text("markers: [{family: tag36h11, id: 9, size: 0.1}]")
    for second, words in (
        ("tag36h11:9", "tag36h11:9 belongs to both board .*board.yaml and target tag36h11_9"),
        (str(other), "tag36h11:9 belongs to both board .*board.yaml and board .*other.yaml"),
    ):
        with pytest.raises(ParameterError, match=words):
            loaded(path, second)
    with pytest.raises(ParameterError, match="tag36h11:9 belongs to both target a and target b"):
        load_target_images(TargetsParameters(images=("tag36h11:9", "tag36h11:9"), names=("a", "b")))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "none of these keys; need a board file: one of markers, grid, charuco"),
        ("- 1", "none of these keys"),
        ("camera_matrix: 3", "none of these keys"),
        (GRID + TWO, "markers and grid; need a board file"),
        ("{", "no YAML"),
        ("grid: 3", "grid: '3'; need family, rows"),
        ("grid: {family: tag36h11, rows: 2, columns: 3, size: 0.08}", "grid: no gap; need family, rows, columns"),
        (GRID.replace("gap", "gab"), "grid: 'gab': no key of a board; did you mean gap?"),
        ("colour: red\n" + GRID, "'colour': no key of a board"),
        (GRID.replace("0.08", "0"), "grid.size: 0 m; need at least 0.0001 m"),
        (GRID.replace("0.08", "-0.1"), "grid.size: -0.1 m"),
        (GRID.replace("0.08", "wide"), "grid.size: 'wide'; need a number"),
        (GRID.replace("0.08", ".nan"), "grid.size: '.nan'; need a number"),
        (GRID.replace("0.08", "1e400"), "grid.size: '1e400'; need a number"),
        (GRID.replace("rows: 2", "rows: 2.5"), r"grid.rows: 2.5; need a whole number from 1 on"),
        (GRID.replace("rows: 2", "rows: 2000"), "6000 markers; need at most 1000"),
        (GRID.replace("first_id: 4", "first_id: 585"), "tag36h11:587: no such id; need 0 to 586"),
        (GRID.replace("first_id: 4", "first_id: -1"), "grid.first_id: -1; need a whole number from 0"),
        (GRID.replace("tag36h11", "tag36h12"), "tag36h12: no family of markers; did you mean tag36h11?"),
        (TWO.replace("id: 2", "id: 1"), "tag36h11:1: twice; need each marker once"),
        (TWO.replace("x: 0.2", "x: 0.07"), "tag36h11:1 and tag36h11:2 overlap"),
        (TWO.replace("-90", "45"), r"markers\[1\].turn_deg: 45; need a multiple of 90"),
        (TWO.replace("x: 0.2", "X: 0.2"), r"markers\[1\]: 'X': no key of a board; did you mean x?"),
        ("markers: []", "markers: need a list of at least one"),
        ("markers: {id: 3}", "markers: need a list"),
        ("markers: [{id: 3, size: 0.1}]", r"markers\[0\]: no family; need family, id, size"),
        ("markers: [7]", r"markers\[0\]: '7'; need family"),
        ("markers: [{family: aruco_original, id: 1023, size: 0.1}]", "turned, it looks like itself"),
        (TWO.replace("x: 0.2", "x: 400"), "400.075 m wide: cells of its smallest detail would have 0.12 px"),
        ("charuco: {family: aruco_4x4_50, columns: 5, rows: 7, square: 0.03, size: 0.03}", "charuco.size: 0.03"),
        ("charuco: {family: aruco_4x4_50, columns: 50, rows: 7, square: 0.03, size: 0.02}", "no such id; need 0 to 49"),
        ("charuco: {family: aruco_4x4_50, columns: 5, rows: 7, square: 0.03, size: 0.02, legacy: 2}", "true or false"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_file(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(FileError, match=words):
        read_board(written(tmp_path, text))


def test_reading_is_bounded(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"need a board file of at most 1 MB"):
        read_board(written(tmp_path, GRID + "#" * 1_000_001), LimitsParameters(text_mb=1))
    laughs = "a: &a [x,x,x,x,x,x,x,x,x,x]\n"
    for before, name in zip("abcdefg", "bcdefgh", strict=True):
        laughs += f"{name}: &{name} [{','.join(['*' + before] * 10)}]\n"
    with pytest.raises(FileError, match=r"limits\.text_mb"):
        read_board(written(tmp_path, laughs), LimitsParameters(text_mb=1))
    with pytest.raises(FileError, match="no text"):
        (tmp_path / "board.yaml").write_bytes(b"\xff\xfe\x00")
        read_board(tmp_path / "board.yaml")
    with pytest.raises(FileError, match="missing.yaml"):
        read_board(tmp_path / "missing.yaml")


BUNDLE = """
family: tag36h11
size: 0.08
markers:
- {id: 0, z: 0.05}
- {id: 1, x: 0.05, quaternion: [0, 0.70710678118, 0, 0.70710678118]}
- {id: 2, y: 0.05, roll_deg: -90, pitch_deg: 30, yaw_deg: 10}
"""


def test_a_bundle(tmp_path: Path) -> None:
    """SciPy's rotations are the second method."""
    (image,) = load_target_images(TargetsParameters(images=(str(written(tmp_path, BUNDLE)),)))
    assert isinstance(image, BundleImage)
    assert (image.kind, image.name, image.width_m) == ("bundle", "board", 0.08)
    first, second, third = image.markers
    assert [str(each.marker) for each in image.markers] == ["tag36h11:0", "tag36h11:1", "tag36h11:2"]
    assert np.allclose(first.place.transform.matrix, [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.05], [0, 0, 0, 1]])
    assert np.allclose(second.place.R[:, 2], (1, 0, 0)) and np.allclose(second.place.t, (0.05, 0, 0))
    assert np.allclose(third.place.R, Rotation.from_euler("xyz", (-90, 30, 10), degrees=True).as_matrix())
    assert not any(each.place.covariance.any() for each in image.markers)


def test_a_bundle_has_no_one_width(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=r"targets.widths_m: 0.1 of .*board.yaml: markers on several planes"):
        load_target_images(TargetsParameters(images=(str(written(tmp_path, BUNDLE)),), widths_m=(0.1,)))


def test_a_marker_of_a_bundle_belongs_to_one_target(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="tag36h11:2 belongs to both board .*board.yaml and target tag36h11_2"):
        load_target_images(TargetsParameters(images=(str(written(tmp_path, BUNDLE)), "tag36h11:2")))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[0, 0.7", "[0, 0.7, 0.7", r"markers\[1\].quaternion: .*; need a list of 4 numbers"),
        ("[0, 0.70710678118, 0, 0.70710678118]", "[0, 0, 0, 0]", r"markers\[1\].quaternion: .*unit length"),
        ("[0, 0.7", "[x, 0.7", r"markers\[1\].quaternion: 'x'; need a number"),
        ("roll_deg", "quaternion: [0, 0, 0, 1], roll_deg", r"markers\[2\]: quaternion and angles; need one of them"),
        ("z: 0.05", "z: 0.05, turn_deg: 90", r"markers\[0\]: 'turn_deg': no key of a board"),
        ("z: 0.05", "z: wide", r"markers\[0\].z: 'wide'; need a number"),
        ("z: 0.05", "z: 0.05, covariance: [1, 2]", r"markers\[0\].covariance: .*; need a list of 36 numbers"),
        (
            "z: 0.05",
            f"z: 0.05, covariance: {[1] * 6 + [2] * 30}",
            r"markers\[0\].covariance: need 36 numbers of a symm",
        ),
        (
            "id: 1, x: 0.05, quaternion: [0, 0.70710678118, 0, 0.70710678118]",
            "id: 1, z: 0.06",
            "0 and tag36h11:1 overl",
        ),
        ("id: 1", "id: 0", "tag36h11:0: twice"),
    ],
)
def test_what_is_wrong_with_a_bundle(tmp_path: Path, old: str, new: str, words: str) -> None:
    with pytest.raises(FileError, match=words):
        read_board(written(tmp_path, BUNDLE.replace(old, new, 1)))


def test_a_long_row_of_markers_is_sampled_within_the_limits_of_opencv(tmp_path: Path) -> None:
    image = loaded(written(tmp_path, "grid: {family: tag36h11, rows: 1, columns: 300, size: 0.08, gap: 0.02}"))
    assert max(image.pixels.shape) < 8010
    scales = image.template.light_scales
    assert max(image.template.size) * max(scales) < 32767
    finest = image.template.drawn(max(scales))
    assert 0.3 < finest.mean() < 0.8


TEXTS = st.sampled_from(["tag36h11", "0", "3", "0.1", "-1", "nan", "1e9", "true", "x", ""])
KEYS = st.sampled_from(
    ["markers", "grid", "charuco", "family", "id", "size", "x", "z", "rows", "columns", "gap", "square", "quaternion",
     "covariance", "legacy", "first_id", "turn_deg"]
)  # fmt: skip
TREES = st.recursive(
    TEXTS | st.none(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(KEYS, inner, max_size=6),
    max_leaves=30,
)


@given(TREES)
@settings(max_examples=300, deadline=None)
def test_whatever_a_file_holds_it_is_a_board_or_an_error(content: object) -> None:
    with contextlib.suppress(FileError):
        assert markers_of(board_of(content, "board.yaml"))
