# SPDX-License-Identifier: Apache-2.0
"""Vector figures: what is drawn are vectors, at the right places, over the picture as it is."""

from __future__ import annotations

import base64
import re
import shutil
import subprocess
import zlib
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import cv2
import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

from imgu_ros.errors import FileError, ShapeError
from imgu_ros.files.vector_figure import VECTOR_SUFFIXES, VectorFigure, save_figure

SVG = "{http://www.w3.org/2000/svg}"
HREF = "{http://www.w3.org/1999/xlink}href"
RED, GREEN = (255, 0, 0), (0, 128, 0)
PICTURE = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)


def figure() -> VectorFigure:
    drawn = VectorFigure(PICTURE)
    drawn.line(np.array([[0.0, 0.0], [63.25, 47.125], [10.0, 40.0]]), RED, closed=True)
    drawn.dots(np.array([[0.0, 0.0], [63.0, 47.0], [20.5, 30.25]]), GREEN, 1.5)
    drawn.text([("a  found", RED), ("é $x_1$ & <b>", GREEN)])
    return drawn


@pytest.fixture
def svg(tmp_path: Path) -> ElementTree.Element:
    figure().save(tmp_path / "a.svg")
    return ElementTree.fromstring((tmp_path / "a.svg").read_text(encoding="utf-8"))


@pytest.mark.parametrize("suffix", [".svg", ".pdf", ".ps"])
def test_it_is_drawn_by_nobodys_settings(tmp_path: Path, suffix: str) -> None:
    figure().save(tmp_path / f"plain{suffix}")
    # As a file `matplotlibrc` in the current folder can have them; `text.usetex` starts latex.
    with mpl.rc_context(
        {"text.usetex": True, "savefig.facecolor": "red", "font.family": "monospace", "image.cmap": "hot"}
    ):
        figure().save(tmp_path / f"set{suffix}")
    assert (tmp_path / f"set{suffix}").read_bytes() == (tmp_path / f"plain{suffix}").read_bytes()


def test_a_pixel_is_a_unit(svg: ElementTree.Element) -> None:
    assert svg.get("viewBox") == "0 0 64 48"
    assert (svg.get("width"), svg.get("height")) == ("64pt", "48pt")


def test_the_picture_is_embedded_once_as_it_is(svg: ElementTree.Element) -> None:
    """Nothing else is a raster picture; it fills the view, and its pixels are not resampled."""
    (image,) = svg.iter(f"{SVG}image")
    encoded = np.frombuffer(base64.b64decode((image.get(HREF) or "").partition(",")[2]), np.uint8)
    pixels = cv2.cvtColor(cv2.imdecode(encoded, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)
    # Some versions of Matplotlib write the rows upwards and turn the picture by a transform.
    mirrored = "scale(1 -1)" in (image.get("transform") or "")
    assert np.array_equal(pixels[::-1] if mirrored else pixels, PICTURE)
    assert float(image.get("width", "0")) == pytest.approx(64)
    assert float(image.get("height", "0")) == pytest.approx(48)
    assert "pixelated" in (image.get("style") or "")


def drawn_paths(svg: ElementTree.Element, color: str) -> Iterator[np.ndarray]:
    for path in svg.iter(f"{SVG}path"):
        if f"stroke: {color}" in (path.get("style") or ""):
            yield np.array(re.findall(r"-?[\d.]+", path.get("d") or ""), float).reshape(-1, 2)


def test_lines_lie_half_a_pixel_from_the_corner(svg: ElementTree.Element) -> None:
    """The centre of the top left pixel, (0, 0), is drawn at (0.5, 0.5) of a view in which it covers 0 to 1."""
    (line,) = drawn_paths(svg, "#ff0000")
    np.testing.assert_allclose(line[:4], [[0.5, 0.5], [63.75, 47.625], [10.5, 40.5], [0.5, 0.5]], atol=1e-4)


def test_lines_have_an_edge(svg: ElementTree.Element) -> None:
    (edge,) = drawn_paths(svg, "#000000")
    (line,) = drawn_paths(svg, "#ff0000")
    np.testing.assert_array_equal(edge, line)


def test_dots_lie_at_their_places(svg: ElementTree.Element) -> None:
    uses = [(float(use.get("x", "nan")), float(use.get("y", "nan"))) for use in svg.iter(f"{SVG}use")]
    np.testing.assert_allclose(uses, [[0.5, 0.5], [63.5, 47.5], [21, 30.75]], atol=1e-4)
    marker = next(path for path in svg.iter(f"{SVG}path") if (path.get("d") or "").startswith("M 0 1.5"))
    numbers = np.array(re.findall(r"-?[\d.]+", marker.get("d") or ""), float)
    assert np.abs(numbers).max() == pytest.approx(1.5)


def test_text_is_text(svg: ElementTree.Element) -> None:
    texts = [(text.text or "").replace("\N{NO-BREAK SPACE}", " ") for text in svg.iter(f"{SVG}text")]
    assert texts[0].startswith("a  fou")
    assert texts[1].startswith("? $x_1$")


@pytest.mark.parametrize("length", [0, 1, 20, 5000])
def test_text_is_cut_to_the_width(tmp_path: Path, length: int) -> None:
    drawn = VectorFigure(np.zeros((48, 400, 3), np.uint8))
    drawn.text([("m" * length, RED)])
    drawn.save(tmp_path / "a.svg")
    shown = re.findall(r">(m*(?:\.\.)?)</text>", (tmp_path / "a.svg").read_text())
    assert [len(text) for text in shown] == ([length] if 0 < length <= 20 else [] if length == 0 else [len(shown[0])])
    assert all(len(text) < 60 for text in shown)


@pytest.mark.parametrize("suffix", VECTOR_SUFFIXES)
def test_the_same_figure_gives_the_same_bytes(tmp_path: Path, suffix: str) -> None:
    for name in "ab":
        figure().save(tmp_path / f"{name}{suffix}")
    assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


def test_pdf(tmp_path: Path) -> None:
    figure().save(tmp_path / "a.PDF")
    content = (tmp_path / "a.PDF").read_bytes()
    assert content.startswith(b"%PDF-")
    assert re.search(rb"/MediaBox \[ ?0 0 64 48 ?\]", content)
    assert len(re.findall(rb"/Subtype /Image", content)) == 1
    # y points up in PDF: (63.25, 47.125) is drawn at (63.75, 48 - 47.625).
    streams = b"".join(
        zlib.decompress(stream)
        for stream in re.findall(rb"stream\r?\n(.*?)\r?\nendstream", content, re.DOTALL)
        if stream[:1] == b"x"
    )
    assert re.search(rb"63\.75 0\.375 l", streams)


def rasters(content: bytes) -> list[np.ndarray]:
    """The raster pictures of a PostScript file, rows upwards as PostScript has them, by its own numbers."""
    head = rb"(\d+) (\d+) 8 \[ [^\]]* \]\n\{\ncurrentfile DataString readhexstring pop\n\} bind false 3 colorimage\n"
    found = re.findall(head + rb"([0-9a-f\s]*)", content)
    return [
        np.frombuffer(bytes.fromhex(data.decode()), np.uint8)[: int(w) * int(h) * 3].reshape(int(h), int(w), 3)
        for w, h, data in found
    ]


@pytest.mark.parametrize("suffix", [".eps", ".ps"])
def test_postscript(tmp_path: Path, suffix: str) -> None:
    figure().save(tmp_path / f"a{suffix}")
    content = (tmp_path / f"a{suffix}").read_bytes()
    assert content.startswith(b"%!PS-Adobe-3.0 EPSF-3.0\n" if suffix == ".eps" else b"%!PS-Adobe-3.0\n")
    assert b"%%BoundingBox: 0 0 64 48\n" in content
    # A page of its own size, which an encapsulated file must not have.
    assert (b"<< /PageSize [64 48] >> setpagedevice" in content) == (suffix == ".ps")
    assert b"CreationDate" not in content
    # y points up: (63.25, 47.125) is drawn at (63.75, 48 - 47.625).
    assert re.search(rb"\n63\.75 0\.375 l\n", content)
    whole, strip = rasters(content)
    assert any(np.array_equal(rows, PICTURE) for rows in (whole, whole[::-1]))
    # PostScript knows no transparency: under the text lies the picture, darkened.
    dark = np.rint(0.35 * PICTURE[: len(strip)]).astype(np.uint8)
    assert 8 <= len(strip) < 48 and any(np.array_equal(rows, dark) for rows in (strip, strip[::-1]))


def test_the_other_formats_are_as_before_after_postscript(tmp_path: Path) -> None:
    drawn = figure()
    drawn.save(tmp_path / "a.svg")
    drawn.save(tmp_path / "a.eps")
    drawn.save(tmp_path / "b.svg")
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()


@pytest.mark.skipif(shutil.which("gs") is None, reason="no Ghostscript")
@pytest.mark.parametrize("suffix", [".eps", ".ps"])
def test_ghostscript_renders_postscript_as_pdf(tmp_path: Path, suffix: str) -> None:
    pictures = []
    for name in ("a.pdf", f"a{suffix}"):
        figure().save(tmp_path / name)
        command = ["gs", "-q", "-dSAFER", "-dBATCH", "-dNOPAUSE", "-dEPSCrop", "-sDEVICE=png16m", "-r72"]
        subprocess.run([*command, f"-sOutputFile={tmp_path / name}.png", str(tmp_path / name)], check=True, timeout=60)
        picture = cv2.imread(str(tmp_path / f"{name}.png"))
        assert picture is not None
        pictures.append(picture.astype(int))
    assert pictures[0].shape == pictures[1].shape == (48, 64, 3)
    # The strip's lowest row is whole or missing, and the picture is noise: other pictures are 85 apart.
    assert float(np.abs(pictures[0] - pictures[1]).mean()) < 8


def test_a_transparent_plot_is_opaque_in_postscript_and_says_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    plot = Figure()
    (line,) = plot.subplots().plot([1, 2], [3, 5], alpha=0.5)
    save_figure(plot, tmp_path / "plot.eps")
    assert (tmp_path / "plot.eps").read_bytes().startswith(b"%!PS")
    assert line.get_alpha() == 0.5 and caplog.records == []


def test_a_plot_of_any_kind(tmp_path: Path) -> None:
    plot = Figure()
    plot.subplots().plot([1, 2], [3, 5])
    save_figure(plot, tmp_path / "plot.svg")
    assert "<svg" in (tmp_path / "plot.svg").read_text()


def test_what_cannot_be_drawn_or_written(tmp_path: Path) -> None:
    with pytest.raises(ShapeError, match="picture"):
        VectorFigure(PICTURE.astype(np.float32))
    with pytest.raises(ShapeError, match="points"):
        figure().line(np.array([[np.nan, 0]]), RED)
    with pytest.raises(FileError, match=r"suffix '.png'; need one of .svg, .pdf, .eps, .ps"):
        figure().save(tmp_path / "a.png")
    with pytest.raises(FileError, match="need a file that can be written"):
        figure().save(tmp_path / "none" / "a.svg")
