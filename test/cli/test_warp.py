# SPDX-License-Identifier: Apache-2.0
"""`imgu warp` against pictures turned by numpy and mapped by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imgu_ros.cli.main import main
from imgu_ros.image_files.images import read_image, write_image

PICTURE = np.random.default_rng(4).integers(0, 256, (6, 9, 3), np.uint8)


def warped(tmp_path: Path, picture: np.ndarray, *options: str) -> np.ndarray:
    write_image(tmp_path / "in.tif", picture)
    assert main(["warp", str(tmp_path / "in.tif"), str(tmp_path / "out.tif"), *options]) == 0
    return read_image(tmp_path / "out.tif")


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("way", ["nearest", "linear", "cubic"])
def test_quarter_turns_of_the_whole_picture(tmp_path: Path, dtype: type, way: str) -> None:
    picture = PICTURE.astype(dtype) / dtype(1 if dtype is not np.float32 else 255)
    picture = picture.astype(dtype)
    for degrees, turns in ((90, -1), (180, 2), (-90, 1)):
        got = warped(tmp_path, picture, "--rotate", str(degrees), "--whole", "--interpolation", way)
        assert got.dtype == dtype
        np.testing.assert_allclose(got, np.rot90(picture, turns), atol=1e-5)


def test_half_a_turn_about_a_point(tmp_path: Path) -> None:
    got = warped(tmp_path, PICTURE, "--rotate", "180", "--about", "2,3")
    assert got.shape == PICTURE.shape
    for y, x in ((3, 2), (1, 0), (5, 4)):
        assert np.array_equal(got[y, x], PICTURE[6 - y, 4 - x])
    assert (got[:, 5:] == 0).all()
    around = warped(tmp_path, PICTURE, "--rotate", "180", "--about", "2,3", "--border", "periodic")
    assert np.array_equal(around[3, 6], PICTURE[3, -2])


def test_scale_about_the_centre(tmp_path: Path) -> None:
    ramp = np.tile(np.arange(0, 210, 10, dtype=np.uint8), (5, 1))
    # The centre, 10, keeps 100; a pixel to the right was half a pixel away.
    assert warped(tmp_path, ramp, "--scale", "2")[2, 8:13].tolist() == [90, 95, 100, 105, 110]
    assert warped(tmp_path, ramp, "--scale", "2", "--whole").shape == (10, 42)


def test_affine_and_projective_maps_by_hand(tmp_path: Path) -> None:
    shifted = warped(tmp_path, PICTURE, "--matrix", "1 0 2; 0 1 -1")
    assert np.array_equal(shifted[:5, 2:], PICTURE[1:, :-2])
    sheared = warped(tmp_path, PICTURE, "--matrix", "1 1 0; 0 1 0", "--size", "14x6")
    for y in range(6):
        assert np.array_equal(sheared[y, y : y + 9], PICTURE[y])
    ramp = np.tile(np.arange(0, 200, 10, dtype=np.uint8), (3, 1))
    # x' = x / (1 + x / 10): x' = 5 came from x = 10, x' = 6 from 15.
    bent = warped(tmp_path, ramp, "--matrix", "1,0,0; 0,1,0; 0.1,0,1", "--border", "replicated")
    assert bent[0, 0] == 0 and abs(int(bent[0, 5]) - 100) <= 1 and abs(int(bent[0, 6]) - 150) <= 1


def test_resizing(tmp_path: Path) -> None:
    grey = PICTURE[..., 0]
    means = grey.reshape(3, 2, 3, 3).mean(axis=(1, 3))
    assert np.abs(warped(tmp_path, grey, "--size", "3x3") - means).max() <= 0.5
    nearest = warped(tmp_path, grey, "--size", "18x12", "--interpolation", "nearest")
    assert np.array_equal(nearest, grey.repeat(2, axis=0).repeat(2, axis=1))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ([], "nothing to do"),
        (["--matrix", "1 0 0; 0 1 0", "--rotate", "3"], "--matrix: together with"),
        (["--rotate", "3", "--whole", "--size", "9x9"], "need one of the two"),
        (["--size", "9x9", "--border", "periodic"], "--border: given with --size alone"),
        (["--rotate", "3", "--interpolation", "area"], "need nearest, linear or cubic"),
        (["--rotate", "nan"], "angle: nan"),
        (["--scale", "0"], "need 1e-6 to 1e6"),
        (["--matrix", "1 0 0; 2 0 0"], "singular"),
        (["--matrix", "1 0 0; 0 1 0; 0.5 0 -1", "--whole"], "vanishing line"),
        (["--scale", "99999", "--whole"], "need at most 32766"),
        (["--size", "0x5"], "need two integers"),
    ],
)
def test_bad_options_are_one_line(
    tmp_path: Path, options: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    write_image(tmp_path / "in.png", PICTURE)
    assert main(["warp", str(tmp_path / "in.png"), str(tmp_path / "out.png"), *options]) == 1
    err = capsys.readouterr().err
    assert err.startswith("imgu: error: ") and err.count("\n") == 1
    assert said in err
    assert not (tmp_path / "out.png").exists()


@pytest.mark.parametrize(
    ("source", "target", "said"),
    [
        ("none.png", "out.png", "none.png"),
        ("in.png", "out.xyz", "suffix '.xyz'"),
        ("in.png", "out.pgm", "in a .pgm file"),
        ("in.png", "no/out.png", "its folder does not exist"),
    ],
)
def test_bad_files_are_one_line(
    tmp_path: Path, source: str, target: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    write_image(tmp_path / "in.png", PICTURE)
    assert main(["warp", str(tmp_path / source), str(tmp_path / target), "--rotate", "5"]) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and said in err


@pytest.mark.parametrize(
    "options",
    [["--about", "1"], ["--size", "9"], ["--matrix", "1 2; 3 4"], ["--matrix", "1 0 0; 0 1"], ["--scale", "x"]],
)
def test_wrong_usage(options: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["warp", "a.png", "b.png", *options]) == 2
    assert options[0] in capsys.readouterr().err
