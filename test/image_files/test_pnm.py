# SPDX-License-Identifier: Apache-2.0
"""PNM files against hand-made bytes, against OpenCV's reader where that is right, and damaged ones."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import EncodingError, ImguError, ShapeError
from imgu_ros.image_files.pnm import decode_pnm, encode_pnm, is_pnm


def be16(*values: int) -> bytes:
    return np.array(values, ">u2").tobytes()


ROWS = [[255, 0, 255], [0, 255, 0]]


@pytest.mark.parametrize(
    ("content", "dtype", "expected"),
    [
        (b"P1\n# c\n3 2\n0 1 0\n1 0 1\n", "uint8", ROWS),
        (b"P1 3 2 010 101", "uint8", ROWS),
        (b"P1 3 2\n01 # 1 1\n0101", "uint8", ROWS),
        (b"P4\n3 2\n" + bytes([0b01011111, 0b10100000]), "uint8", ROWS),
        (b"P4 9 1 " + bytes([0b11111110, 0b10000000]), "uint8", [[0, 0, 0, 0, 0, 0, 0, 255, 0]]),
        (b"P2 3 1 15 0 7 15", "uint8", [[0, 7, 15]]),  # not scaled
        (b"P2 3 1 255 0 # x 9\n7 15 99 junk", "uint8", [[0, 7, 15]]),
        (b"P2 3 1 4095\n0 7 4095\n", "uint16", [[0, 7, 4095]]),
        (b"P3 1 2 1000 1 2 3\n4 5 1000", "uint16", [[[1, 2, 3]], [[4, 5, 1000]]]),
        (b"P5 3 1 15\n" + bytes([0, 7, 15]), "uint8", [[0, 7, 15]]),
        (b"P5\r3\t1\v255\r" + bytes([0, 7, 15]), "uint8", [[0, 7, 15]]),
        (b"P5 # size follows\n3 1 # and now\n# maxval\n255\n" + bytes([35, 10, 15]), "uint8", [[35, 10, 15]]),
        (b"P5 3 1 255#c\n" + bytes([0, 7, 15]), "uint8", [[0, 7, 15]]),
        (b"P5 3 1 255 " + b"#\n#", "uint8", [[35, 10, 35]]),  # after the one space, pixels
        (b"P5 3 1 256\n" + be16(0, 7, 256), "uint16", [[0, 7, 256]]),
        (b"P5 1 1 255\n" + bytes([9, 1, 2, 3]), "uint8", [[9]]),  # a second image may follow
        (b"P6 1 1 1023\n" + be16(1, 2, 1023), "uint16", [[[1, 2, 1023]]]),
    ],
)
def test_hand_made(content: bytes, dtype: str, expected: list[object]) -> None:
    assert is_pnm(content)
    got = decode_pnm(content)
    assert got.dtype == np.dtype(dtype)
    assert got.dtype.isnative
    assert got.tolist() == expected


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"", "header"),
        (b"P7 1 1 255 a", "header"),
        (b"P5", "header"),
        (b"P5 -3 1 255 abc", "header"),
        (b"P5 3 x 255 abc", "header"),
        (b"P5 99999999999 1 255 abc", "header"),
        (b"P5 3 1 0 abc", "maxval"),
        (b"P5 3 1 65536 abcabc", "maxval"),
        (b"P5 3 1", "maxval"),
        (b"P5 0 1 255 abc", "0 x 1 px"),
        (b"P5 2000000000 2000000000 255 abc", r"needs \d+ MB; need at most 1000 \(limits.picture_mb\)"),
        (b"P5 3 1 255", "white space"),
        (b"P5 3 2 255\nabcde", "5 bytes of pixels; need 6"),
        (b"P5 3 1 4095\n" + be16(0, 7, 4096), "value 4096; need at most the maxval of 4095"),
        (b"P5 3 1 100\n" + bytes([0, 7, 101]), "value 101"),
        (b"P4 9 2\nabc", "3 bytes of pixels; need 4"),
        (b"P2 3 1 15 0 7", "2 values; need 3"),
        (b"P2 3 1 15 0 7 16", "value 16"),
        (b"P2 3 1 15 0 7 1.5", "decimal digits"),
        (b"P2 3 1 15 0 7 -1", "decimal digits"),
        (b"P2 3 1 65535 0 7 99999999999999999999", "maxval of 65535"),
        (b"P1 3 1 0 1 2", "0 and 1"),
        (b"P1 3 1 01", "2 values; need 3"),
        (b"P1 3 1 0 x 1", "0 and 1"),
    ],
)
def test_damaged(content: bytes, text: str) -> None:
    with pytest.raises(EncodingError, match=text) as error:
        decode_pnm(content)
    assert "\n" not in str(error.value)


@given(
    st.sampled_from(["uint8", "uint16"]), st.booleans(), st.booleans(), st.integers(1, 40), st.integers(1, 5),
    st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_round_trip(dtype: str, color: bool, plain: bool, width: int, height: int, seed: int) -> None:
    shape = (height, width, 3) if color else (height, width)
    pixels = np.random.default_rng(seed).integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)
    content = encode_pnm(pixels, plain=plain)
    assert content[:2] == f"P{2 + color + 3 * (not plain)}".encode()
    got = decode_pnm(content)
    assert got.dtype == pixels.dtype
    assert np.array_equal(got, pixels)
    if plain:
        assert max(map(len, content.splitlines())) <= 70
    theirs = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR)
    assert np.array_equal(theirs[..., ::-1] if color else theirs, pixels)


@given(st.booleans(), st.integers(1, 80), st.integers(1, 5), st.integers(0, 2**32 - 1))
def test_bitmap_round_trip(plain: bool, width: int, height: int, seed: int) -> None:
    pixels = np.random.default_rng(seed).choice(np.array([0, 255], np.uint8), (height, width))
    content = encode_pnm(pixels, plain=plain, bitmap=True)
    assert content[:2] == (b"P1" if plain else b"P4")
    assert np.array_equal(decode_pnm(content), pixels)
    assert np.array_equal(cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED), pixels)


def test_16_bit_is_written_big_endian() -> None:
    pixels = np.array([[1, 256]], "<u2")
    assert encode_pnm(pixels) == b"P5\n2 1\n65535\n\x00\x01\x01\x00"
    assert encode_pnm(pixels.astype(">u2")) == encode_pnm(pixels)


def test_what_cannot_be_encoded() -> None:
    with pytest.raises(ShapeError, match="0 and 255"):
        encode_pnm(np.array([[0, 7]], np.uint8), bitmap=True)
    with pytest.raises(ShapeError, match="uint16"):
        encode_pnm(np.array([[0, 7]], np.float32))
    with pytest.raises(ShapeError):
        encode_pnm(np.zeros((2, 2, 4), np.uint8))


@given(st.data())
def test_any_damage_gives_a_picture_or_one_line(data: st.DataObject) -> None:
    plain, bitmap = data.draw(st.booleans()), data.draw(st.booleans())
    pixels = np.array([[0, 255, 0], [255, 255, 0]], np.uint8)
    content = bytearray(encode_pnm(pixels, plain=plain, bitmap=bitmap))
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(content) - 1))
        content[place] = data.draw(st.integers(0, 255))
    del content[data.draw(st.integers(1, len(content))) :]
    try:
        got = decode_pnm(bytes(content))
    except ImguError as error:
        said = str(error)
    else:
        said = str(got.dtype)
    assert said
    assert "\n" not in said
