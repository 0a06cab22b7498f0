# SPDX-License-Identifier: Apache-2.0
"""Image files against hand-made bytes, round trips, and bad input."""

from __future__ import annotations

import os
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from imgu_ros.errors import FileError, ShapeError
from imgu_ros.image_files.images import read_image, read_raw_image, write_image


def png(width: int, height: int, depth: int, color: int, rows: bytes) -> bytes:
    """A PNG by its specification; `rows` without filter bytes."""
    stride = len(rows) // height
    filtered = b"".join(b"\0" + rows[i * stride : (i + 1) * stride] for i in range(height))
    chunks = [
        (b"IHDR", struct.pack(">IIBBBBB", width, height, depth, color, 0, 0, 0)),
        (b"IDAT", zlib.compress(filtered)),
        (b"IEND", b""),
    ]
    packed = [struct.pack(">I", len(d)) + k + d + struct.pack(">I", zlib.crc32(k + d)) for k, d in chunks]
    return b"\x89PNG\r\n\x1a\n" + b"".join(packed)


def be16(*values: int) -> bytes:
    return np.array(values, ">u2").tobytes()


@pytest.mark.parametrize(
    ("name", "data", "expected"),
    [
        ("a.pgm", b"P5\n# comment\n2 2\n255\n" + bytes([0, 1, 2, 255]), np.array([[0, 1], [2, 255]], np.uint8)),
        ("b.pgm", b"P5 2 2 65535\n" + be16(0, 1, 256, 65535), np.array([[0, 1], [256, 65535]], np.uint16)),
        ("c.pgm", b"P5 2 1 4095\n" + be16(1, 4095), np.array([[1, 4095]], np.uint16)),  # 12 bits stay 12 bits
        ("d.pgm", b"P2\n2 1\n255\n7 200\n", np.array([[7, 200]], np.uint8)),
        ("e.pgm", b"P2\n2 1\n65535\n7 20000\n", np.array([[7, 20000]], np.uint16)),
        ("f.ppm", b"P6 1 1 255\n" + bytes([1, 2, 3]), np.array([[[1, 2, 3]]], np.uint8)),
        ("g.ppm", b"P6 1 1 65535\n" + be16(1, 2, 300), np.array([[[1, 2, 300]]], np.uint16)),
        ("h.ppm", b"P3 1 1 255 1 2 3\n", np.array([[[1, 2, 3]]], np.uint8)),
        ("i.png", png(2, 1, 8, 0, bytes([5, 9])), np.array([[5, 9]], np.uint8)),
        ("j.png", png(2, 1, 16, 0, be16(5, 900)), np.array([[5, 900]], np.uint16)),
        ("k.png", png(1, 1, 8, 2, bytes([1, 2, 3])), np.array([[[1, 2, 3]]], np.uint8)),
        ("l.png", png(1, 1, 16, 2, be16(1, 2, 300)), np.array([[[1, 2, 300]]], np.uint16)),
        ("m.png", png(1, 1, 8, 6, bytes([1, 2, 3, 255])), np.array([[[1, 2, 3]]], np.uint8)),
        ("n.png", png(1, 1, 16, 6, be16(1, 2, 300, 65535)), np.array([[[1, 2, 300]]], np.uint16)),
        ("suffix.lies", b"P6 1 1 255\n" + bytes([1, 2, 3]), np.array([[[1, 2, 3]]], np.uint8)),
    ],
)
def test_hand_made_files(tmp_path, name, data, expected):
    (tmp_path / name).write_bytes(data)
    got = read_image(tmp_path / name)
    assert got.dtype == expected.dtype
    assert np.array_equal(got, expected)


@pytest.mark.parametrize("plain", [False, True])
@pytest.mark.parametrize("white", [0, 255])
def test_a_bitmap_is_written_and_read(tmp_path, plain, white):
    pixels = np.where(np.random.default_rng(0).random((5, 11)) < 0.5, 255 - white, white).astype(np.uint8)
    write_image(tmp_path / "a.pbm", pixels, plain=plain)
    assert (tmp_path / "a.pbm").read_bytes()[:2] == (b"P1" if plain else b"P4")
    assert np.array_equal(read_image(tmp_path / "a.pbm"), pixels)
    with pytest.raises(FileError, match=r"a.pbm: image: grey values; need 0 and 255 alone"):
        write_image(tmp_path / "a.pbm", pixels // 2)


def test_a_plain_ppm_is_text(tmp_path):
    write_image(tmp_path / "a.ppm", np.array([[[1, 2, 300]]], np.uint16), plain=True)
    assert (tmp_path / "a.ppm").read_text() == "P3\n1 1\n65535\n1 2 300\n"


def test_lossless_and_lossy(tmp_path):
    """Only JPEG loses something, the more the lower its quality; PNG compresses without a loss."""
    y, x = np.mgrid[:64, :96]
    pixels = np.dstack([127 + 100 * np.sin(x / 9), 2 * x, 3 * y]).astype(np.uint8)
    write_image(tmp_path / "a.png", pixels)
    assert np.array_equal(read_image(tmp_path / "a.png"), pixels)
    assert (tmp_path / "a.png").stat().st_size < pixels.nbytes / 2
    errors, sizes = [], []
    for quality in (95, 40):
        write_image(tmp_path / "a.jpg", pixels, quality=quality)
        errors.append(np.square(read_image(tmp_path / "a.jpg").astype(float) - pixels).mean())
        sizes.append((tmp_path / "a.jpg").stat().st_size)
    assert 0 < errors[0] < errors[1] < 255**2 / 10**3  # 30 dB
    assert sizes[1] < sizes[0] < pixels.nbytes / 4


@pytest.mark.parametrize("suffix", [".png", ".tif", ".tiff", ".pgm", ".ppm", ".pnm"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3)])
def test_what_is_written_is_read_again(tmp_path, suffix, dtype, shape):
    rng = np.random.default_rng(0)
    pixels = (
        rng.random(shape, np.float32) if dtype is np.float32 else rng.integers(0, np.iinfo(dtype).max, shape, dtype)
    )
    path = tmp_path / f"Übung ö{suffix}"
    if (dtype is np.float32 and "tif" not in suffix) or (suffix, len(shape)) in ((".pgm", 3), (".ppm", 2)):
        with pytest.raises(FileError, match=f"in a {suffix} file"):
            write_image(path, pixels)
        assert not path.exists()
        return
    write_image(path, pixels)
    got = read_image(path)
    assert got.dtype == dtype
    assert np.array_equal(got, pixels)


def test_a_view_in_any_byte_order_is_written(tmp_path):
    pixels = np.arange(24, dtype=">u2").reshape(4, 6)[::2, ::-1]
    write_image(tmp_path / "a.png", pixels)
    assert np.array_equal(read_image(tmp_path / "a.png"), pixels)


def test_jpeg_colours_are_rgb(tmp_path):
    pixels = np.zeros((16, 16, 3), np.uint8)
    pixels[..., 0] = 250
    write_image(tmp_path / "red.jpeg", pixels)
    assert np.abs(read_image(tmp_path / "red.jpeg").astype(int) - pixels).max() < 10


@pytest.mark.parametrize("text", ["missing.png", "folder", "empty.png", "random.png", "text.jpg", "cut.tif", "pipe"])
def test_what_is_no_image_is_refused_in_one_line(tmp_path, text):
    (tmp_path / "folder").mkdir()
    (tmp_path / "empty.png").touch()
    os.mkfifo(tmp_path / "pipe")  # must not block
    (tmp_path / "random.png").write_bytes(np.random.default_rng(0).bytes(1000))
    (tmp_path / "text.jpg").write_text("hello")
    (tmp_path / "cut.tif").write_bytes(b"II*\0\x08\0")
    with pytest.raises(FileError) as error:
        read_image(tmp_path / text)
    assert "\n" not in str(error.value)
    assert text in str(error.value)
    assert "need" in str(error.value)


def test_a_forged_size_is_refused(tmp_path):
    (tmp_path / "huge.pgm").write_bytes(b"P5 2000000000 2000000000 255\n1234")
    with pytest.raises(FileError, match="huge"):
        read_image(tmp_path / "huge.pgm")


def test_what_cannot_be_written_is_refused(tmp_path):
    pixels = np.zeros((4, 4), np.uint8)
    with pytest.raises(FileError, match=r"suffix '.xyz'; need one of .png"):
        write_image(tmp_path / "a.xyz", pixels)
    with pytest.raises(FileError, match="need a file that can be written"):
        write_image(tmp_path / "none" / "a.png", pixels)
    with pytest.raises(FileError, match="uint16"):
        write_image(tmp_path / "a.jpg", pixels.astype(np.uint16))
    with pytest.raises(FileError, match="need a quality of 0 to 100"):
        write_image(tmp_path / "a.jpg", pixels, quality=101)
    with pytest.raises(FileError, match="for plain text"):
        write_image(tmp_path / "a.png", pixels, plain=True)
    with pytest.raises(ShapeError):
        write_image(tmp_path / "a.png", np.zeros((0, 4), np.uint8))


def test_headerless_raw_in_both_byte_orders(tmp_path):
    path = tmp_path / "a.raw"
    path.write_bytes(bytes([0, 1, 2, 3, 4, 5]))
    assert read_raw_image(path, 3, 2, "uint8").tolist() == [[0, 1, 2], [3, 4, 5]]
    assert read_raw_image(path, 1, 3, "uint16").tolist() == [[256], [770], [1284]]
    assert read_raw_image(path, 3, 1, ">u2").tolist() == [[1, 515, 1029]]
    assert read_raw_image(path, 3, 1, ">u2").dtype == np.uint16
    assert read_raw_image(path, 3, 1, ">u2").dtype.isnative


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((3, 3, "uint8"), r"6 bytes; need 9 \(3 x 3 x 1\)"),
        ((3, 2, "uint16"), "6 bytes; need 12"),
        ((0, 2, "uint8"), "size 0 x 2"),
        ((3, 2, "float32"), "need uint8, uint16 or >u2"),
        ((3, 2, "bayer"), "need uint8, uint16 or >u2"),
    ],
)
def test_raw_of_another_size_or_type_is_refused(tmp_path, arguments, text):
    (tmp_path / "a.raw").write_bytes(bytes(6))
    with pytest.raises(FileError, match=text):
        read_raw_image(tmp_path / "a.raw", *arguments)
    with pytest.raises(FileError, match="need"):
        read_raw_image(tmp_path / "missing.raw", *arguments)
    with pytest.raises(FileError, match="need"):
        read_raw_image(tmp_path, *arguments)


def test_the_nikon_raws(data_dir):
    path = next((data_dir / "raw" / "nikon").glob("*rggb*"))
    raw = read_raw_image(path, 768, 512, "uint16")
    assert 400 < raw.min() < 1000
    assert 4000 < raw.max() <= 16383


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
@pytest.mark.parametrize("share", [0.3, 0.6, 0.95])
def test_a_cut_picture_is_refused_whatever_the_decoder_says(tmp_path: Path, suffix: str, share: float) -> None:
    """OpenCV 4.6 fills what is missing of a JPEG with grey, and says nothing."""
    whole = cv2.imencode(suffix, np.random.default_rng(0).integers(0, 255, (60, 80, 3), dtype=np.uint8))[1]
    path = tmp_path / f"cut{suffix}"
    path.write_bytes(whole[: int(share * len(whole))].tobytes())
    with pytest.raises(FileError, match=f"cut{suffix}: .* cut after"):
        read_image(path)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".pgm"])
def test_damage_gives_a_picture_or_one_line(tmp_path, suffix, capfd):
    """And nothing on stderr, where a command says its one line."""
    rng = np.random.default_rng(0)
    write_image(tmp_path / f"whole{suffix}", rng.integers(0, 255, (20, 30), dtype=np.uint8))
    whole = (tmp_path / f"whole{suffix}").read_bytes()
    path = tmp_path / f"damaged{suffix}"
    for i in range(40):
        content = bytearray(whole[: int(rng.integers(8, len(whole)))] if i % 2 else whole)
        for place in rng.integers(0, len(content), 3):
            content[place] = rng.integers(0, 256)
        path.write_bytes(content)
        try:
            said = f"damaged{suffix}: {read_image(path).dtype}"
        except FileError as error:
            said = str(error)
        assert f"damaged{suffix}: " in said
        assert "\n" not in said
    # libjpeg warns of bytes that it leaves out; OpenCV 4 prints what it throws.
    if suffix != ".jpg" and cv2.__version__ >= "5":
        assert capfd.readouterr().err == ""


def test_a_mask_is_written_as_black_and_white(tmp_path):
    mask = np.array([[True, False, True]])
    for suffix in (".png", ".pgm", ".pbm", ".tif"):
        write_image(tmp_path / f"mask{suffix}", mask)
        np.testing.assert_array_equal(read_image(tmp_path / f"mask{suffix}"), np.array([[255, 0, 255]], np.uint8))
