# SPDX-License-Identifier: Apache-2.0
"""`imgu make`: the pages as PDFium draws them, measured in pixels."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pypdfium2 as pdfium
import pytest
from pypdfium2 import raw as pdfium_c

from imgu_ros.cli.main import main
from imgu_ros.files.print_pages import PAPERS_MM, PrintJob, print_pages, tiles_of
from imgu_ros.image_files.images import read_image, write_image

DPI = 300
GREEN = (0, 200, 0)


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    """A picture with a green rim: nothing else on the page is green."""
    pixels = np.random.default_rng(3).integers(0, 256, (90, 120, 3), np.uint8)
    pixels[..., 1] //= 3
    pixels[:2], pixels[-2:], pixels[:, :2], pixels[:, -2:] = GREEN, GREEN, GREEN, GREEN
    write_image(tmp_path / "label.png", pixels)
    return tmp_path / "label.png"


def pages_of(path: Path, dpi: float = DPI) -> list[np.ndarray]:
    """Return the pages as a printer of so many dots an inch would print them, RGB."""
    document = pdfium.PdfDocument(path)
    try:
        return [np.asarray(page.render(scale=dpi / 72).to_pil().convert("RGB")) for page in document]
    finally:
        document.close()


def green_box_mm(page: np.ndarray, dpi: float = DPI) -> tuple[float, float, float, float]:
    """Return left, top, width and height of what is green."""
    image = page.astype(int)
    y, x = np.nonzero((image[..., 1] > 150) & (image[..., 0] < 60) & (image[..., 2] < 60))
    mm = 25.4 / dpi
    return x.min() * mm, y.min() * mm, (np.ptp(x) + 1) * mm, (np.ptp(y) + 1) * mm


def made(tmp_path: Path, *arguments: object) -> Path:
    out = tmp_path / "print.pdf"
    assert main(["make", *map(str, arguments), "--out", str(out)]) == 0
    return out


@pytest.mark.parametrize(
    ("paper", "width_m", "page_mm"),
    [
        ("auto", 0.15, PAPERS_MM["a4"]),
        ("auto", 0.2, PAPERS_MM["a4"][::-1]),
        ("auto", 0.27, PAPERS_MM["a3"]),
        ("auto", 0.32, PAPERS_MM["a3"][::-1]),
        ("letter", 0.18, PAPERS_MM["letter"]),
        ("fit", 0.6, (624.0, 498.0)),
        ("fit", 0.02, (124.0, 63.0)),
    ],
)
def test_the_print_has_its_width(
    picture: Path, tmp_path: Path, paper: str, width_m: float, page_mm: tuple[float, float]
) -> None:
    dpi = DPI if width_m < 0.25 else DPI / 2
    pages = pages_of(made(tmp_path, picture, "--width-m", width_m, "--paper", paper), dpi)
    assert len(pages) == 1
    height, width = pages[0].shape[:2]
    assert (width * 25.4 / dpi, height * 25.4 / dpi) == pytest.approx(page_mm, abs=0.2)
    _, _, green_width, green_height = green_box_mm(pages[0], dpi)
    # An edge may be in the middle of a dot.
    assert green_width == pytest.approx(1000 * width_m, rel=1e-3, abs=25.4 / dpi)
    assert green_height == pytest.approx(750 * width_m, rel=1e-3, abs=25.4 / dpi)


def test_the_ruler_is_as_long_as_it_says(picture: Path, tmp_path: Path) -> None:
    page = pages_of(made(tmp_path, picture, "--width-m", 0.1))[0]
    dark = (page < 128).all(axis=2)
    # The longest dark row is the ruler's line.
    y = int(dark.sum(axis=1).argmax())
    x = np.flatnonzero(dark[y])
    # From the outer edge of the first mark to that of the last: they are 0.14 mm wide.
    assert (np.ptp(x) + 1) * 25.4 / DPI - 0.14 == pytest.approx(100, rel=1e-3)


def test_tiles_overlap_and_make_the_whole_picture(picture: Path, tmp_path: Path) -> None:
    out = made(tmp_path, picture, "--width-m", 0.5, "--overlap-mm", 12)
    job = PrintJob(read_image(picture), (500.0, 375.0), 0.5, ())
    tiles = tiles_of(job.size_mm, "auto", 12.0)
    pages = pages_of(out, 100)
    assert len(pages) == len(tiles) == 6
    # Laid together where the tiles say, they are the picture.
    whole = np.zeros((round(375 / 25.4 * 100) + 2, round(500 / 25.4 * 100) + 2, 3), np.uint8)
    covered = np.zeros(whole.shape[:2], int)
    for tile, page in zip(tiles, pages, strict=True):
        x, y, width, height = (round(mm / 25.4 * 100) for mm in tile.part_mm)
        margin = round(12 / 25.4 * 100)
        part = page[margin : margin + height, margin : margin + width]
        seen = covered[y : y + height, x : x + width] > 0
        if seen.any():
            before = whole[y : y + height, x : x + width][seen].astype(int)
            assert np.abs(before - part[seen]).mean() < 25
        whole[y : y + height, x : x + width] = part
        covered[y : y + height, x : x + width] += 1
    assert covered[2:-4, 2:-4].min() == 1 and covered.max() == 4
    got = cv2.resize(whole[:-2, :-2], (120, 90), interpolation=cv2.INTER_AREA)
    assert np.corrcoef(got.ravel(), read_image(picture).ravel())[0, 1] > 0.95


def test_viewers_are_asked_not_to_scale(picture: Path, tmp_path: Path) -> None:
    document = pdfium.PdfDocument(made(tmp_path, picture, "--width-m", 0.1))
    assert pdfium_c.FPDF_VIEWERREF_GetPrintScaling(document.raw) == 0
    document.close()


def test_the_page_says_what_to_enter_and_the_same_call_gives_the_same_bytes(picture: Path, tmp_path: Path) -> None:
    out = made(tmp_path, picture, "--width-m", 0.12)
    document = pdfium.PdfDocument(out)
    text = document[0].get_textpage().get_text_bounded()
    document.close()
    assert "targets.images: [label.png]" in text and "targets.widths_m: [0.12]" in text and "120 x 90 mm" in text
    assert "width_m is 0.12 x L / 100" in text
    first = out.read_bytes()
    assert made(tmp_path, picture, "--width-m", 0.12).read_bytes() == first


def test_a_random_texture_is_found_where_it_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = made(tmp_path, "random", "--width-m", 0.16, "--height-m", 0.1, "--seed", 5)
    assert read_image(tmp_path / "print.png").shape == (800, 1280, 3)
    assert "-p targets.widths_m:=0.16" in capsys.readouterr().out
    write_image(tmp_path / "photo.png", pages_of(out, 75)[0])
    assert main(["match", str(tmp_path / "print.png"), str(tmp_path / "photo.png")]) == 0
    before = (tmp_path / "print.png").read_bytes()
    assert made(tmp_path, "random", "--width-m", 0.16, "--height-m", 0.1, "--seed", 5).stat().st_size > 0
    # Another texture does not take the place of this one, nor of anybody's picture.
    assert main(["make", "random", "--width-m", "0.16", "--out", str(out)]) == 1
    assert "is there and shows something else" in capsys.readouterr().err
    assert (tmp_path / "print.png").read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["random", "--width-m", "0"], "--width-m: 0 m; need 0.001 to 100 m"),
        (["random", "--width-m", "nan"], "--width-m: nan m; need 0.001 to 100 m"),
        (["missing.png", "--width-m", "0.1"], "missing.png"),
        (["missing.png", "--width-m", "0.1", "--seed", "3"], "--seed: of the target random alone"),
        (["random", "--width-m", "9", "--height-m", "9", "--paper", "fit"], "need at most 5080 mm"),
        (["random", "--width-m", "0.1", "--height-m", "0.001"], "a factor of at most 80"),
        (["random", "--width-m", "16"], "pages; need at most 200"),
        (["random", "--width-m", "1", "--overlap-mm", "200"], "overlap: 200 mm; need 0 to"),
        (["random", "--width-m", "1", "--overlap-mm", "inf"], "--overlap-mm: inf; need a number"),
    ],
)
def test_what_cannot_be_made_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    out = tmp_path / "print.pdf"
    assert main(["make", *arguments, "--out", str(out)]) == 1
    assert words in capsys.readouterr().err
    assert not out.exists() and not list(tmp_path.iterdir())


def test_another_suffix_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["make", "random", "--width-m", "0.1", "--out", str(tmp_path / "print.png")]) == 1
    assert "need a name that ends with .pdf" in capsys.readouterr().err


def test_a_coarse_picture_is_warned_of(picture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made(tmp_path, picture, "--width-m", 0.5)
    assert "0.24 px a mm; its pixels will show as steps" in capsys.readouterr().err


def test_grey_pictures_keep_their_values() -> None:
    ramp = np.tile(np.arange(0, 250, 10, dtype=np.uint8), (10, 1))
    job = PrintJob(ramp, (100.0, 40.0), 0.1, ())
    content = print_pages([(job, tiles_of(job.size_mm, "auto", 10.0))], 10.0)
    document = pdfium.PdfDocument(content)
    page = np.asarray(document[0].render(scale=2).to_pil().convert("L"))
    document.close()
    row = page[round((12 + 20) * 72 / 25.4 * 2)]
    middles = [row[round((12 + 4 * index + 2) * 72 / 25.4 * 2)] for index in range(25)]
    np.testing.assert_allclose(middles, ramp[0], atol=2)


@pytest.mark.parametrize(("name", "cells"), [("tag36h11:7", 8), ("aruco_4x4_50:3", 6)])
def test_a_marker_is_as_wide_as_its_black_square(tmp_path: Path, name: str, cells: int) -> None:
    markers = pytest.importorskip("imgu_ros.vision.markers")
    if not hasattr(cv2, "aruco"):
        pytest.skip("no aruco module in this OpenCV")
    page = pages_of(made(tmp_path, name, "--width-m", 0.1))[0].min(axis=2)
    top = page[: round(0.6 * page.shape[0])]
    # The black square ends the rim of white that separates it from the cutting marks.
    margin = 12 + 100 / cells
    left = round((margin - 2) / 25.4 * DPI)
    square = top[left:, left : left + round(104 / 25.4 * DPI)]
    darkness = 1 - square / 255.0
    rim = round((2 + 50 / cells) / 25.4 * DPI)
    assert darkness[rim].sum() * 25.4 / DPI == pytest.approx(100, rel=1e-3)
    assert darkness[:, rim].sum() * 25.4 / DPI == pytest.approx(100, rel=1e-3)
    # No seam within what is white or black; each cell is there.
    family, number = name.split(":")
    expected = markers.marker_cells(family, int(number))
    for row in range(cells):
        for column in range(cells):
            y, x = (round((2 + (k + 0.5) * 100 / cells) / 25.4 * DPI) for k in (row, column))
            assert (square[y, x] > 127) == expected[row, column]
    flat = np.minimum(square, 255 - square)
    inner = [round((2 + k * 100 / cells) / 25.4 * DPI) for k in range(cells + 1)]
    for k in range(1, cells):
        for m in range(cells):
            at = round((2 + (m + 0.5) * 100 / cells) / 25.4 * DPI)
            if expected[k - 1, m] == expected[k, m]:
                assert flat[inner[k] - 3 : inner[k] + 4, at].max() <= 2


def test_a_printed_marker_is_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if not hasattr(cv2, "aruco"):
        pytest.skip("no aruco module in this OpenCV")
    page = pages_of(made(tmp_path, "tag36h11:7", "--width-m", 0.08), 100)[0]
    said = capsys.readouterr().out
    assert "leave the white about it" in said and "-p targets.images:=tag36h11:7 -p targets.widths_m:=0.08" in said
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    corners, numbers, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(cv2.cvtColor(page, cv2.COLOR_RGB2GRAY))
    assert numbers.ravel().tolist() == [7]
    sides = np.linalg.norm(np.diff(corners[0][0], axis=0, append=corners[0][0][:1]), axis=1)
    np.testing.assert_allclose(sides / 100 * 25.4, 80, rtol=0.01)


def test_a_printed_board_is_read_and_as_large_as_its_file_says(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """OpenCV reads it; distances between corners of different markers are exact. Another width scales it."""
    if not hasattr(cv2, "aruco"):
        pytest.skip("no aruco module in this OpenCV")
    board = tmp_path / "wall.yaml"
    board.write_text("grid: {family: tag36h11, rows: 2, columns: 3, size: 0.04, gap: 0.015, first_id: 3}")
    for options, scale in (((), 1.0), (("--width-m", 0.075), 0.5)):
        page = pages_of(made(tmp_path, board, *options))[0]
        said = capsys.readouterr().out
        assert "150 x 95 mm" in said if scale == 1 else "75 x 47.5 mm" in said
        assert f"targets.images:={board}\n" in said if scale == 1 else "targets.widths_m:=0.075" in said
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
        corners, numbers, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(cv2.cvtColor(page, cv2.COLOR_RGB2GRAY))
        # OpenCV's are half a turn from upright: its third corner is the upper left one.
        place = {int(n): np.roll(c[0], 2, axis=0) * 25.4 / DPI for n, c in zip(numbers.ravel(), corners, strict=True)}
        assert sorted(place) == [3, 4, 5, 6, 7, 8]
        assert place[5][1] - place[6][3] == pytest.approx((150 * scale, -95 * scale), abs=0.2)
        assert place[4][0] - place[3][1] == pytest.approx((15 * scale, 0), abs=0.2)


def test_a_printed_charuco_board_is_opencvs(tmp_path: Path) -> None:
    if not hasattr(cv2, "aruco"):
        pytest.skip("no aruco module in this OpenCV")
    board = tmp_path / "charuco.yml"
    board.write_text("charuco: {family: aruco_4x4_50, columns: 4, rows: 5, square: 0.04, size: 0.03}")
    page = pages_of(made(tmp_path, board))[0].min(axis=2)
    left = top = round(12 / 25.4 * DPI)
    width, height = (round(mm / 25.4 * DPI) for mm in (160, 200))
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    expected = cv2.aruco.CharucoBoard((4, 5), 0.04, 0.03, dictionary).generateImage((4 * 24 * 4, 5 * 24 * 4))
    seen = cv2.resize(page[top : top + height, left : left + width], expected.shape[::-1], interpolation=cv2.INTER_AREA)
    assert np.abs(seen.astype(int) - expected).mean() < 12
    assert np.corrcoef(seen.ravel(), expected.ravel())[0, 1] > 0.95


def test_a_bundle_is_printed_marker_by_marker(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if not hasattr(cv2, "aruco"):
        pytest.skip("no aruco module in this OpenCV")
    board = tmp_path / "cube.yaml"
    board.write_text(
        "family: tag36h11\nmarkers: [{id: 3, size: 0.08, z: 0.05}, {id: 4, size: 0.06, x: 0.05, yaw_deg: 90}]"
    )
    pages = pages_of(made(tmp_path, board), 100)
    said = capsys.readouterr().out
    assert "cube/tag36h11:3: 80 x 80 mm" in said and "cube/tag36h11:4: 60 x 60 mm" in said
    assert f"parameters: -p targets.images:={board}\n" in said
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    for page, number, side in zip(pages, (3, 4), (80, 60), strict=True):
        corners, numbers, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(cv2.cvtColor(page, cv2.COLOR_RGB2GRAY))
        assert numbers.ravel().tolist() == [number]
        sides = np.linalg.norm(np.diff(corners[0][0], axis=0, append=corners[0][0][:1]), axis=1)
        np.testing.assert_allclose(sides / 100 * 25.4, side, rtol=0.015)
    assert main(["make", str(board), "--width-m", "0.1", "--out", str(tmp_path / "x.pdf")]) == 1
    assert "markers on several planes have no one width" in capsys.readouterr().err
