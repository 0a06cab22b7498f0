# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from imgu_ros.errors import FileError
from imgu_ros.image_files.images import read_image
from imgu_ros.messages.annotations import STATUS_COLORS
from imgu_ros.report.overlay import draw_result, write_overlay
from imgu_ros.result import PoseStatus, Status


def _is_color(picture: np.ndarray, color: tuple[int, int, int]) -> np.ndarray:
    return (np.abs(picture.astype(int) - color) < 40).all(axis=2)


def test_outline_is_drawn_where_the_target_is(make_result) -> None:
    result = make_result()
    picture = draw_result(result)
    assert picture.shape == (480, 640, 3)
    assert picture.dtype == np.uint8
    outline = result.first.outline
    drawn = _is_color(picture, STATUS_COLORS[Status.DETECTED])
    for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        for share in (0.1, 0.5, 0.9):
            x, y = np.rint(a + share * (b - a)).astype(int)
            assert drawn[y - 2 : y + 3, x - 2 : x + 3].any()


def test_outline_follows_the_lens(make_result) -> None:
    result = make_result(distortion=(-0.3, 0.1), size=(640, 480))
    drawn = _is_color(draw_result(result), STATUS_COLORS[Status.DETECTED])
    target, camera = result.first, result.frame.camera
    a, b = camera.ideal_pixels(target.outline)[0][:2]
    x, y = np.rint(camera.raw_pixels([(a + b) / 2])[0]).astype(int)
    assert drawn[y - 2 : y + 3, x - 2 : x + 3].any()


def test_the_frame_is_not_changed_and_the_picture_is_new(make_result) -> None:
    result = make_result()
    before = result.developed.color().copy()
    draw_result(result)
    assert np.array_equal(result.developed.color(), before)


def test_axes_only_with_a_pose(make_result) -> None:
    red = (230, 40, 40)
    assert _is_color(draw_result(make_result()), red).sum() > 20
    assert not _is_color(draw_result(make_result(pose_status=PoseStatus.AMBIGUOUS)), red).any()


@pytest.mark.parametrize("status", [Status.LOST, Status.DEGENERATE, Status.REJECTED])
def test_failures_are_said(make_result, status) -> None:
    plain = make_result(status=status, reason="because é of something long " * 20)
    picture = draw_result(plain)
    assert _is_color(picture[:40], STATUS_COLORS[status]).sum() > 50


def test_ten_bits_in_sixteen_are_visible(make_result) -> None:
    result = make_result(dtype="uint16", status=Status.LOST)
    body = draw_result(result)[100:]
    assert body.min() < 20
    assert body.max() > 235


@pytest.mark.parametrize("size", [(8, 6), (64, 48), (320, 240), (2000, 1500)])
def test_any_size(make_result, size) -> None:
    picture = draw_result(make_result(size=size, names=("a", "b")))
    assert picture.shape == (size[1], size[0], 3)


SVG = "{http://www.w3.org/2000/svg}"


def _strokes(svg: ElementTree.Element, color: tuple[int, int, int]) -> list[np.ndarray]:
    style = f"stroke: #{bytes(color).hex()}"
    paths = [path.get("d") or "" for path in svg.iter(f"{SVG}path") if style in (path.get("style") or "")]
    return [np.array(re.findall(r"-?[\d.]+", d), float).reshape(-1, 2) for d in paths]


def test_as_vectors(make_result, tmp_path: Path) -> None:
    """The frame is the one raster picture; pixel (x, y) lies at (x + 1/2, y + 1/2) of a view of one unit a pixel."""
    result = make_result()
    target, camera = result.first, result.frame.camera
    write_overlay(tmp_path / "a.svg", result)
    svg = ElementTree.fromstring((tmp_path / "a.svg").read_text(encoding="utf-8"))
    assert svg.get("viewBox") == "0 0 640 480"
    assert len(list(svg.iter(f"{SVG}image"))) == 1
    (outline,) = _strokes(svg, STATUS_COLORS[Status.DETECTED])
    np.testing.assert_allclose(outline[:4], target.outline + 0.5, atol=1e-4)
    (x_axis,) = _strokes(svg, (230, 40, 40))
    np.testing.assert_allclose(x_axis[0], camera.project([target.pose.t])[0] + 0.5, atol=1e-4)
    places = np.array([(use.get("x"), use.get("y")) for use in svg.iter(f"{SVG}use")], float)
    inliers = target.matches.image_xy[target.matches.inliers]
    np.testing.assert_allclose(places[:60], np.concatenate((inliers, inliers)) + 0.5, atol=1e-4)
    (text,) = (text.text for text in svg.iter(f"{SVG}text"))
    assert "30 points agree" in text


@pytest.mark.parametrize("suffix", [".svg", ".pdf", ".eps", ".ps"])
@pytest.mark.parametrize("status", Status)
def test_every_status_as_vectors(make_result, tmp_path: Path, suffix: str, status: Status) -> None:
    write_overlay(tmp_path / f"a{suffix}", make_result(status=status, reason="" if status.found else "so and so"))
    content = (tmp_path / f"a{suffix}").read_bytes()
    start = {".svg": b"<?xml", ".pdf": b"%PDF", ".eps": b"%!PS", ".ps": b"%!PS"}[suffix]
    assert content.startswith(start)
    assert status.found or suffix != ".svg" or b"so and so" in content


def test_a_bent_outline_as_vectors(make_result, tmp_path: Path) -> None:
    result = make_result(distortion=(-0.3, 0.1))
    write_overlay(tmp_path / "a.svg", result)
    svg = ElementTree.fromstring((tmp_path / "a.svg").read_text(encoding="utf-8"))
    (outline,) = _strokes(svg, STATUS_COLORS[Status.DETECTED])
    assert len(outline) > 60
    np.testing.assert_allclose(outline[:64:16], result.first.outline + 0.5, atol=1e-3)


def test_written_as_a_raster_picture(make_result, tmp_path: Path) -> None:
    result = make_result()
    write_overlay(tmp_path / "a.png", result)
    assert np.array_equal(read_image(tmp_path / "a.png"), draw_result(result))
    with pytest.raises(FileError, match=r"suffix '.xyz'; need one of .png.*, .svg, .pdf, .eps, .ps"):
        write_overlay(tmp_path / "a.xyz", result)
