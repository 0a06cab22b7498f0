# SPDX-License-Identifier: Apache-2.0
"""`imgu filter` against pictures and kernels worked out by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imgu_ros.cli.filter import BORDERS, METHODS, OPERATORS
from imgu_ros.cli.main import main
from imgu_ros.image_files.images import read_image, write_image
from imgu_ros.vision.processing.borders import Border
from imgu_ros.vision.processing.derivatives import Derivative

SHAPE = (30, 40)


def disc() -> np.ndarray:
    """A disc of radius 9 about (20, 15), 200 on 40."""
    y, x = np.mgrid[0:30, 0:40]
    return np.where((x - 20) ** 2 + (y - 15) ** 2 < 81, 200, 40).astype(np.uint8)


def filtered(tmp_path: Path, picture: np.ndarray, *options: str, suffix: str = ".tif") -> np.ndarray:
    write_image(tmp_path / f"in{suffix}", picture)
    out = tmp_path / f"out{suffix}"
    assert main(["filter", str(tmp_path / f"in{suffix}"), str(out), "--method", *options]) == 0
    return read_image(out)


def test_names_are_those_of_the_library() -> None:
    assert set(BORDERS) == set(Border) and set(OPERATORS) == set(Derivative)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("channels", [1, 3])
def test_every_method_keeps_size_and_depth(tmp_path: Path, method: str, dtype: type, channels: int) -> None:
    noise = np.random.default_rng(1).random((*SHAPE, channels)[: 2 if channels == 1 else 3])
    picture = (noise * (1 if dtype is np.float32 else np.iinfo(dtype).max)).astype(dtype)
    options = ["--kernel", "0 -1 0; -1 5 -1; 0 -1 0"] if method == "kernel" else []
    got = filtered(tmp_path, picture, method, *options)
    assert got.dtype == dtype and got.shape[:2] == SHAPE
    assert got.std() > 0


def test_smoothing_by_hand(tmp_path: Path) -> None:
    row = np.zeros((3, 5), np.uint8)
    row[1, 2] = 90
    assert filtered(tmp_path, row, "mean")[1].tolist() == [0, 10, 10, 10, 0]
    assert filtered(tmp_path, row, "mean", "--size", "1")[1].tolist() == [0, 0, 90, 0, 0]
    wide = np.zeros((31, 31), np.uint16)
    wide[15, 15] = 60000
    y, x = np.mgrid[-15:16, -15:16]
    normal = 60000 * np.exp(-(x**2 + y**2) / 8) / (8 * np.pi)
    assert np.abs(filtered(tmp_path, wide, "gaussian", "--sigma", "2") - normal).max() < 3


@pytest.mark.parametrize(
    ("border", "expected"),
    [
        ("constant", [0, 10, 20, 30]),
        ("periodic", [40, 10, 20, 30]),
        ("reflected", [20, 10, 20, 30]),
        ("mirrored", [10, 10, 20, 30]),
        ("replicated", [10, 10, 20, 30]),
    ],
)
def test_kernels_are_flipped_and_borders_are_as_said(tmp_path: Path, border: str, expected: list[int]) -> None:
    # The weight right of the centre takes the value from the left: convolution, not correlation.
    row = np.array([[10, 20, 30, 40]], np.uint8)
    assert filtered(tmp_path, row, "kernel", "--kernel", "0 0 1", "--border", border).tolist() == [expected]


def test_a_kernel_may_begin_with_a_minus(tmp_path: Path) -> None:
    row = np.array([[0, 10, 30, 60]], np.uint8)
    assert filtered(tmp_path, row, "kernel", "--kernel", "-1 0 1").tolist() == [[0, 0, 0, 0]]
    assert filtered(tmp_path, row[:, ::-1].copy(), "kernel", "--kernel", "-1 0 1").tolist() == [[0, 50, 30, 0]]


@pytest.mark.parametrize(
    ("kernel", "said"),
    [
        ("1 2 1; 2 4 2; 1 2 1", "kernel 3 x 3: separable, a column and a row\n"),
        ("0 -1 0; -1 5 -1; 0 -1 0", "kernel 3 x 3: not separable, the sum of 2 that are\n"),
        ("1 0 -1", "kernel 3 x 1: separable, a column and a row\n"),
    ],
)
def test_what_is_said_of_a_kernel(tmp_path: Path, kernel: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    filtered(tmp_path, disc(), "kernel", "--kernel", kernel)
    assert capsys.readouterr().out == said


def test_kernels_clamp(tmp_path: Path) -> None:
    sharp = filtered(tmp_path, disc(), "kernel", "--kernel", "0,-1,0; -1,5,-1; 0,-1,0")
    # Beside a straight piece of the outline: 5 * 200 - 3 * 200 - 40, and 5 * 40 - 3 * 40 - 200.
    assert sharp[15, 28] == 255 and sharp[15, 29] == 0 and sharp[15, 20] == 200


def test_detail(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    color = rng.integers(60, 180, (*SHAPE, 3), np.uint8)
    assert np.array_equal(filtered(tmp_path, color, "detail", "--gain", "1"), color)
    ramp = np.tile(np.linspace(1000, 40000, 40), (30, 1)).astype(np.uint16)
    noise = rng.normal(0, 100, SHAPE)
    noisy = (ramp + noise).astype(np.uint16)
    more = filtered(tmp_path, noisy, "detail", "--gain", "3", "--levels", "1") - ramp.astype(float)
    inside = (slice(4, -4), slice(4, -4))
    assert 2 < more[inside].std() / noise[inside].std() < 3
    assert abs(more[inside].mean()) < 100  # the ramp stays


def test_strength_of_a_ramp(tmp_path: Path) -> None:
    ramp = np.tile(np.arange(0, 200, 5, dtype=np.uint8), (30, 1))
    for operator in OPERATORS:
        got = filtered(tmp_path, ramp, "strength", "--operator", operator, "--gain", "3")
        assert (got[6:-6, 6:-6] == 15).all(), operator
    assert (filtered(tmp_path, ramp, "strength")[6:-6, 6:-6] == 20).all()


def test_direction_is_the_hue(tmp_path: Path) -> None:
    y, x = np.mgrid[-20:21, -20:21].astype(float)
    cone = np.uint8(np.clip(4 * np.hypot(x, y), 0, 255))  # rises outwards
    got = filtered(tmp_path, cone, "direction", "--gain", "100").astype(int)
    assert got[20, 32].tolist() == [255, 0, 0]  # to the right: hue 0
    r, g, b = got[32, 20]  # down: 90 degrees, between yellow and green
    assert g == 255 and abs(r - 128) < 8 and b == 0
    r, g, b = got[20, 8]  # to the left: 180 degrees, cyan
    assert r == 0 and g == 255 and b == 255


@pytest.mark.parametrize("operator", OPERATORS)
def test_edges_by_a_threshold_run_along_the_outline(tmp_path: Path, operator: str) -> None:
    edges = filtered(tmp_path, disc(), "edges", "--threshold", "30", "--operator", operator)
    assert set(np.unique(edges)) == {0, 255}
    y, x = np.nonzero(edges)
    assert np.abs(np.hypot(x - 20, y - 15) - 9).max() < 2
    assert np.ptp(np.arctan2(y - 15, x - 20)) > 6


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_canny_is_a_closed_line_one_pixel_wide(tmp_path: Path, dtype: type) -> None:
    picture = disc().astype(dtype) * (np.iinfo(dtype).max // 255)
    edges = filtered(tmp_path, picture, "canny") > 0
    y, x = np.nonzero(edges)
    assert np.abs(np.hypot(x - 20, y - 15) - 9).max() < 1.5
    assert 45 < edges.sum() < 70  # a circle's 8-connected pixels number 4 sqrt(2) r = 51
    assert not filtered(tmp_path, picture, "canny", "--high", str(0.9 * np.iinfo(dtype).max)).any()


def test_overlay_draws_edges_in_red_over_the_picture(tmp_path: Path) -> None:
    plain = filtered(tmp_path, disc(), "canny") > 0
    over = filtered(tmp_path, disc(), "canny", "--overlay")
    assert (over[plain] == (255, 0, 0)).all()
    assert np.array_equal(over[~plain], np.dstack([disc()] * 3)[~plain])


def test_grey_weights_say_which_colour_counts(tmp_path: Path) -> None:
    color = np.dstack((disc(), np.full_like(disc(), 90), np.full_like(disc(), 90)))
    assert (filtered(tmp_path, color, "canny") > 0).any()
    assert not filtered(tmp_path, color, "canny", "-p", "raw.grey_weights:=[0.0, 1.0, 1.0]").any()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["mean", "--size", "4"], "need an odd integer"),
        (["mean", "--sigma", "2"], "--sigma: given with --method mean; need --method gaussian"),
        (["canny", "--border", "periodic"], "--border: given with --method canny"),
        (["strength", "--sigma", "2"], "need --operator gaussian"),
        (["strength", "--overlay"], "need --method edges, canny"),
        (["strength", "--gain", "nan"], "--gain: nan; need 0 to 1000"),
        (["canny", "--low", "30", "--high", "20"], "need 0 <= low <= high"),
        (["edges", "--threshold", "-1"], "threshold: -1"),
        (["kernel"], "--kernel: none"),
        (["kernel", "--kernel", "1 2; 3 4"], "need odd sides"),
        (["detail", "--levels", "99"], "levels: 99"),
        (["canny", "-p", "preprocess.gamma:=0.5"], "not used by this command"),
    ],
)
def test_bad_options_are_one_line(
    tmp_path: Path, options: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    write_image(tmp_path / "in.png", disc())
    assert main(["filter", str(tmp_path / "in.png"), str(tmp_path / "out.png"), "--method", *options]) == 1
    err = capsys.readouterr().err
    assert err.startswith("imgu: error: ") and err.count("\n") == 1
    assert said in err
    assert not (tmp_path / "out.png").exists()


@pytest.mark.parametrize(
    ("source", "target", "said"),
    [
        ("none.png", "out.png", "none.png"),
        ("in.png", "out.xyz", "suffix '.xyz'"),
        ("in.png", "no/out.png", "its folder does not exist"),
        ("text.png", "out.png", "not an image"),
    ],
)
def test_bad_files_are_one_line(
    tmp_path: Path, source: str, target: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    write_image(tmp_path / "in.png", disc())
    (tmp_path / "text.png").write_text("no picture")
    assert main(["filter", str(tmp_path / source), str(tmp_path / target), "--method", "canny"]) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and said in err


@pytest.mark.parametrize("kernel", ["", "1 x", "1 2; 3", ";"])
def test_a_kernel_that_is_none_is_wrong_usage(kernel: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["filter", "a.png", "b.png", "--method", "kernel", "--kernel", kernel]) == 2
    assert "need rows of equally many numbers" in capsys.readouterr().err
