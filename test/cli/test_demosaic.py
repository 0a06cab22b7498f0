# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image as Pillow

from imgu_ros.cli.main import main
from imgu_ros.config.parameters import declaration
from imgu_ros.image_files.images import read_image, write_image
from imgu_ros.vision.formation.cfa import BayerPattern, mosaic

COLOR = (10, 20, 30)


def raw_of(dtype: str, scale: int, pattern: str = "rggb") -> np.ndarray:
    flat = np.broadcast_to(np.array(COLOR, dtype) * np.array(scale, dtype), (8, 12, 3))
    return mosaic(np.ascontiguousarray(flat), BayerPattern(pattern))


@pytest.mark.parametrize("method", declaration("demosaic.method").choices)
@pytest.mark.parametrize("pattern", list(BayerPattern))
def test_a_flat_colour_stays(tmp_path: Path, method: str, pattern: str) -> None:
    write_image(tmp_path / "raw.png", raw_of("uint8", 5, pattern))
    argv = ["demosaic", str(tmp_path / "raw.png"), str(tmp_path / "rgb.png"), "--pattern", pattern, "--method", method]
    assert main(argv) == 0
    rgb = read_image(tmp_path / "rgb.png")
    assert rgb.dtype == np.uint8
    assert np.array_equal(rgb, np.broadcast_to(np.array(COLOR, np.uint8) * np.uint8(5), (8, 12, 3)))


@pytest.mark.parametrize(("name", "dtype"), [("raw.pgm", "uint16"), ("raw.tiff", "uint16"), ("raw.png", "uint16")])
def test_depth_is_kept(tmp_path: Path, name: str, dtype: str) -> None:
    write_image(tmp_path / name, raw_of(dtype, 1000))
    assert main(["demosaic", str(tmp_path / name), str(tmp_path / "rgb.png"), "--pattern", "rggb"]) == 0
    rgb = read_image(tmp_path / "rgb.png")
    assert rgb.dtype == np.uint16
    assert np.array_equal(np.unique(rgb.reshape(-1, 3), axis=0), [[10000, 20000, 30000]])


@pytest.mark.parametrize(("dtype", "stored"), [("uint16", "<u2"), ("uint16be", ">u2"), ("uint8", "u1")])
def test_headerless(tmp_path: Path, dtype: str, stored: str) -> None:
    raw = raw_of("uint8", 5)
    raw.astype(stored).tofile(tmp_path / "raw.bin")
    options = ["--pattern", "rggb", "--width", "12", "--height", "8", "--dtype", dtype]
    assert main(["demosaic", str(tmp_path / "raw.bin"), str(tmp_path / "rgb.png"), *options]) == 0
    assert np.array_equal(read_image(tmp_path / "rgb.png")[4, 6], [50, 100, 150])


def test_levels_and_gains(tmp_path: Path) -> None:
    # (value - 100) / (1100 - 100) of full scale, then the gain; by hand.
    write_image(tmp_path / "raw.pgm", np.full((8, 8), 300, np.uint16))
    options = ["--pattern", "bggr", "--black", "100", "--white", "1100", "--gains", "2,1,0.5"]
    assert main(["demosaic", str(tmp_path / "raw.pgm"), str(tmp_path / "rgb.png"), *options]) == 0
    assert np.abs(read_image(tmp_path / "rgb.png")[4, 4] - 65535 * np.array([0.4, 0.2, 0.1])).max() <= 1


def test_parameters_serve_where_no_short_option_is_given(tmp_path: Path) -> None:
    write_image(tmp_path / "raw.pgm", np.full((8, 8), 511, np.uint16))
    options = ["--pattern", "rggb", "-p", "raw.significant_bits:=10", "-p", "raw.gains:=[1.0, 1.0, 2.0]"]
    assert main(["demosaic", str(tmp_path / "raw.pgm"), str(tmp_path / "rgb.png"), *options]) == 0
    half = 65535 * 511 / 1023
    assert np.abs(read_image(tmp_path / "rgb.png")[4, 4] - [half, half, 2 * half]).max() <= 1


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--white", "50", "--black", "60"], "need more than raw.black_level"),
        (["--white", "300"], "white <= 255 (uint8)"),
        (["--black", "255"], "black < white"),
        (["--black", "-1"], "need 0 to 65535"),
        (["--gains", "1,2"], "need 3"),
        (["-p", "demosaic.method:=bilinea"], "nearest: bilinear"),
        (["--width", "8"], "need all three"),
        (["--width", "8", "--height", "9", "--dtype", "uint8"], "bytes"),
        (["--width", "0", "--height", "9", "--dtype", "uint8"], "at least 1 x 1"),
    ],
)
def test_bad_options_are_one_line(
    tmp_path: Path, options: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    write_image(tmp_path / "raw.png", raw_of("uint8", 5))
    argv = ["demosaic", str(tmp_path / "raw.png"), str(tmp_path / "rgb.png"), "--pattern", "rggb", *options]
    assert main(argv) == 1
    err = capsys.readouterr().err
    assert err.startswith("imgu: error: ")
    assert err.count("\n") == 1
    assert said in err
    assert not (tmp_path / "rgb.png").exists()


@pytest.mark.parametrize("content", [None, b"", b"\x00random\xff" * 50])
def test_bad_files_are_one_line(tmp_path: Path, content: bytes | None, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "raw.png"
    if content is not None:
        path.write_bytes(content)
    assert main(["demosaic", str(path), str(tmp_path / "rgb.png"), "--pattern", "rggb"]) == 1
    err = capsys.readouterr().err
    assert "raw.png" in err
    assert err.count("\n") == 1


def test_a_colour_image_is_no_mosaic(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_image(tmp_path / "rgb.png", np.zeros((8, 8, 3), np.uint8))
    assert main(["demosaic", str(tmp_path / "rgb.png"), str(tmp_path / "out.png"), "--pattern", "rggb"]) == 1
    assert "one-channel" in capsys.readouterr().err


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_an_orientation_tag_does_not_turn_the_pattern(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], orientation: int, dtype: type, suffix: str
) -> None:
    color = cv2.resize(np.random.default_rng(1).integers(0, 200, (4, 6, 3), np.uint8), (48, 32)).astype(dtype)
    raw = mosaic(color, BayerPattern.RGGB)
    exif = Pillow.Exif()
    exif[0x0112] = orientation
    Pillow.fromarray(raw).save(tmp_path / f"raw{suffix}", exif=exif)
    write_image(tmp_path / "plain.pgm", raw)
    for name in (f"raw{suffix}", "plain.pgm"):
        assert main(["demosaic", str(tmp_path / name), str(tmp_path / f"{name}.ppm"), "--pattern", "rggb"]) == 0
    assert np.array_equal(read_image(tmp_path / f"raw{suffix}.ppm"), read_image(tmp_path / "plain.pgm.ppm"))
    assert capsys.readouterr().err.count(f"raw{suffix}: orientation tag {orientation} ignored") == (orientation != 1)


def test_the_encoding_gives_the_pattern(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_image(tmp_path / "raw.png", raw_of("uint8", 5, "gbrg"))
    paths = [str(tmp_path / "raw.png"), str(tmp_path / "rgb.png")]
    assert main(["demosaic", *paths, "-p", "raw.encoding:=bayer_gbrg8"]) == 0
    assert np.array_equal(read_image(tmp_path / "rgb.png")[4, 6], np.array(COLOR) * 5)
    for options, text in (
        ([], "--pattern: none; need the mosaic's"),
        (["-p", "raw.encoding:=mono8"], "raw.encoding: mono8; need a Bayer encoding"),
        (["-p", "raw.encoding:=bayer_gbrg16"], "need 1 of uint16"),
        (["-p", "raw.encoding:=bayer_gbrg8", "--pattern", "rggb"], "--pattern: rggb with raw.encoding bayer_gbrg8"),
    ):
        assert main(["demosaic", *paths, *options]) == 1
        assert text in capsys.readouterr().err
