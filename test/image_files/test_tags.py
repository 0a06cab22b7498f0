# SPDX-License-Identifier: Apache-2.0
"""Orientation and transparency of image files: bytes made by hand or by Pillow, and what must come out of them."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image as Pillow
from PIL import ImageOps

from imgu_ros.errors import FileError
from imgu_ros.image_files.formats import is_decoder_safe
from imgu_ros.image_files.images import read_image, read_image_file
from imgu_ros.image_files.tags import PictureTags, picture_tags

#: Where the first row and the first column of the file are shown, Exif 2.3 table 4.6.4: what turns the file upright.
UPRIGHT: dict[int, Callable[[np.ndarray], np.ndarray]] = {
    1: lambda a: a,
    2: lambda a: a[:, ::-1],
    3: lambda a: a[::-1, ::-1],
    4: lambda a: a[::-1],
    5: lambda a: a.swapaxes(0, 1),
    6: lambda a: a[::-1].swapaxes(0, 1),  # the first row becomes the right column
    7: lambda a: a[::-1, ::-1].swapaxes(0, 1),
    8: lambda a: a[:, ::-1].swapaxes(0, 1),
}
RNG = np.random.default_rng(0)
GREY = RNG.integers(0, 256, (6, 9), np.uint8)
COLOR = RNG.integers(0, 256, (6, 9, 3), np.uint8)
ALPHA = RNG.integers(0, 256, (6, 9), np.uint8)
GREY16 = RNG.integers(0, 65536, (6, 9), np.uint16)
COLOR16 = RNG.integers(0, 65536, (6, 9, 3), np.uint16)
ALPHA16 = RNG.integers(0, 65536, (6, 9), np.uint16)
FLOATS = RNG.random((6, 9, 3)).astype(np.float32)


def exif(orientation: int, order: str = ">", kind: int = 3) -> bytes:
    """Exif data by the TIFF 6.0 specification: one directory with one tag."""
    value = struct.pack(order + {3: "HH", 4: "I"}[kind], *((orientation, 0) if kind == 3 else (orientation,)))
    start = b"MM\0*" if order == ">" else b"II*\0"
    return start + struct.pack(order + "IHHHI", 8, 1, 0x0112, kind, 1) + value + bytes(4)


def png(pixels: np.ndarray, extra: tuple[tuple[bytes, bytes], ...] = (), depth: int = 0) -> bytes:
    """A PNG by its specification, of grey, grey and alpha, RGB or RGBA; `extra` chunks before the pixels."""
    color = {1: 0, 2: 4, 3: 2, 4: 6}[1 if pixels.ndim == 2 else pixels.shape[2]]
    height, width = pixels.shape[:2]
    depth = depth or 8 * pixels.dtype.itemsize
    rows = pixels.astype(pixels.dtype.newbyteorder(">")).reshape(height, -1)
    if depth < 8:
        bits = np.unpackbits(rows[:, :, None], axis=2)[:, :, -depth:].reshape(height, -1)
        rows = np.packbits(bits, axis=1)
    filtered = b"".join(b"\0" + row.tobytes() for row in rows)
    header = struct.pack(">IIBBBBB", width, height, depth, color, 0, 0, 0)
    chunks = [(b"IHDR", header), *extra, (b"IDAT", zlib.compress(filtered)), (b"IEND", b"")]
    packed = [struct.pack(">I", len(d)) + k + d + struct.pack(">I", zlib.crc32(k + d)) for k, d in chunks]
    return b"\x89PNG\r\n\x1a\n" + b"".join(packed)


def tiff(
    pixels: np.ndarray, orientation: int = 0, extra_sample: int | None = None, order: str = "<", big: bool = False
) -> bytes:
    """A TIFF 6.0 or BigTIFF, one strip, uncompressed; `orientation` 0: without the tag."""
    height, width = pixels.shape[:2]
    samples = 1 if pixels.ndim == 2 else pixels.shape[2]
    data = pixels.astype(pixels.dtype.newbyteorder(order)).tobytes()
    data += bytes(len(data) % 2)
    start = 16 if big else 8
    short, long = (3, "H"), (4, "I")
    fields: list[tuple[int, tuple[int, str], list[int]]] = [
        (256, short, [width]), (257, short, [height]), (258, short, [8 * pixels.dtype.itemsize] * samples),
        (259, short, [1]), (262, short, [2 if samples > 2 else 1]), (273, long, [start]),
        (277, short, [samples]), (278, short, [height]), (279, long, [len(data)]),
        (339, short, [3 if pixels.dtype.kind == "f" else 1] * samples),
    ]  # fmt: skip
    if orientation:
        fields.append((274, short, [orientation]))
    if extra_sample is not None:
        fields.append((338, short, [extra_sample]))
    fields.sort()
    number, inline = ("Q", 8) if big else ("I", 4)
    at = start + len(data)
    behind = at + (8 if big else 2) + len(fields) * (20 if big else 12) + inline
    entries, outside = b"", b""
    for tag, (kind, form), values in fields:
        packed = struct.pack(order + form * len(values), *values)
        if len(packed) > inline:
            entry, outside = struct.pack(order + number, behind + len(outside)), outside + packed
        else:
            entry = packed.ljust(inline, b"\0")
        entries += struct.pack(order + "HH" + number, tag, kind, len(values)) + entry
    mark = "II" if order == "<" else "MM"
    head = mark.encode() + (struct.pack(order + "HHHQ", 43, 8, 0, at) if big else struct.pack(order + "HI", 42, at))
    count = struct.pack(order + ("Q" if big else "H"), len(fields))
    return head + data + count + entries + bytes(inline) + outside


def jpeg(pixels: np.ndarray, orientation: int = 0, order: str = ">", before: bytes = b"") -> bytes:
    """A JPEG as OpenCV writes it, with an Exif segment after `before`."""
    done, encoded = cv2.imencode(".jpg", pixels)
    assert done
    data = encoded.tobytes()
    if not orientation:
        return data
    segment = b"Exif\0\0" + exif(orientation, order)
    return data[:2] + before + b"\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment + data[2:]


def webp(pixels: np.ndarray, orientation: int = 0) -> bytes:
    stream = io.BytesIO()
    Pillow.fromarray(pixels).save(stream, "WEBP", lossless=True, exif=exif(orientation) if orientation else b"")
    return stream.getvalue()


FILES: dict[str, Callable[[int], bytes]] = {
    "grey8.png": lambda o: png(GREY, ((b"eXIf", exif(o)),) if o else ()),
    "grey16.png": lambda o: png(GREY16, ((b"eXIf", exif(o, "<")),) if o else ()),
    "color8.png": lambda o: png(COLOR, ((b"eXIf", exif(o, "<", kind=4)),) if o else ()),
    "color16.png": lambda o: png(COLOR16, ((b"eXIf", exif(o)),) if o else ()),
    "grey8.tif": lambda o: tiff(GREY, o),
    "grey16.tif": lambda o: tiff(GREY16, o, order=">"),
    "color8.tif": lambda o: tiff(COLOR, o, order=">"),
    "color16.tif": lambda o: tiff(COLOR16, o),
    "floats.tif": lambda o: tiff(FLOATS, o),
    "big.tif": lambda o: tiff(GREY, o, big=True),
    "big_endian.tif": lambda o: tiff(GREY16, o, big=True, order=">"),
    "grey.jpg": lambda o: jpeg(GREY, o),
    "color.jpg": lambda o: jpeg(COLOR, o, "<"),
    "behind.jpg": lambda o: jpeg(COLOR, o, before=b"\xff\xfe\0\x06note\xff\xff\xe1\0\x09http:x\0"),
    "color.webp": lambda o: webp(COLOR, o),
}
#: Those that this OpenCV reads.
READABLE = [name for name in FILES if is_decoder_safe() or not name.endswith("webp")]


@pytest.mark.parametrize("name", READABLE)
@pytest.mark.parametrize("orientation", UPRIGHT)
def test_pixels_stay_as_read_out_unless_they_are_to_be_looked_at(tmp_path, name, orientation):
    (tmp_path / name).write_bytes(FILES[name](0))
    stored = read_image(tmp_path / name)
    assert read_image_file(tmp_path / name).notes == ()
    (tmp_path / name).write_bytes(FILES[name](orientation))
    file = read_image_file(tmp_path / name)
    assert file.pixels.dtype == stored.dtype
    assert np.array_equal(file.pixels, stored)
    assert len(file.notes) == (orientation != 1)
    assert all(f"orientation tag {orientation} ignored" in note for note in file.notes)
    turned = read_image_file(tmp_path / name, upright=True)
    assert np.array_equal(turned.pixels, UPRIGHT[orientation](stored))
    assert turned.pixels.flags.c_contiguous
    assert turned.notes == ()


@pytest.mark.parametrize("name", sorted({"color8.png", "color8.tif", "color.jpg", "color.webp"} & {*READABLE}))
@pytest.mark.parametrize("orientation", UPRIGHT)
def test_upright_is_what_pillow_shows(tmp_path, name, orientation):
    (tmp_path / name).write_bytes(FILES[name](orientation))
    with Pillow.open(tmp_path / name) as opened:
        shown = np.array(ImageOps.exif_transpose(opened))
    assert np.abs(read_image(tmp_path / name, upright=True).astype(int) - shown).max() <= (2 if "jpg" in name else 0)


@pytest.mark.parametrize("orientation", [0, 9, 65535])
def test_orientations_that_are_none_turn_nothing(tmp_path, orientation):
    for name, data in (("a.png", png(GREY, ((b"eXIf", exif(orientation)),))), ("a.tif", tiff(GREY, orientation))):
        (tmp_path / name).write_bytes(data)
        file = read_image_file(tmp_path / name, upright=True)
        assert np.array_equal(file.pixels, GREY)
        assert file.notes == ()


@given(st.sampled_from(sorted(FILES)), st.integers(0, 2000), st.binary(min_size=1, max_size=4))
def test_damaged_tags_never_raise(name, position, damage):
    data = FILES[name](6)
    position %= len(data)
    broken = data[:position] + damage + data[position + len(damage) :]
    for content in (broken, data[:position]):
        assert 1 <= picture_tags(content).orientation <= 8


def test_what_is_no_picture_has_no_tags():
    beyond = b"II+\0\x08\0\0\0" + 8 * b"\xff"  # a BigTIFF whose directory lies beyond all files
    for content in (b"", beyond, b"P5 1 1 255\n0", b"II*\0", b"RIFF", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"):
        assert picture_tags(content) == PictureTags()


def on_white(color: np.ndarray, alpha: np.ndarray, full: float) -> np.ndarray:
    share = (alpha / full)[..., None] if color.ndim == 3 else alpha / full
    return color * share + full * (1 - share)


def pillow_png(pixels: np.ndarray, mode: str, **options: object) -> bytes:
    stream = io.BytesIO()
    Pillow.fromarray(pixels).convert(mode).save(stream, "PNG", **options)
    return stream.getvalue()


def premultiplied(color: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    full = np.iinfo(color.dtype).max
    return np.rint(color * (alpha[..., None] / full)).astype(color.dtype)


TRANSPARENT = {
    "rgba.png": (png(np.dstack((COLOR, ALPHA))), on_white(COLOR, ALPHA, 255)),
    "rgba16.png": (png(np.dstack((COLOR16, ALPHA16))), on_white(COLOR16, ALPHA16, 65535)),
    "la.png": (png(np.dstack((GREY, ALPHA))), on_white(GREY, ALPHA, 255)),
    "la16.png": (png(np.dstack((GREY16, ALPHA16))), on_white(GREY16, ALPHA16, 65535)),
    "straight.tif": (tiff(np.dstack((COLOR, ALPHA)), extra_sample=2), on_white(COLOR, ALPHA, 255)),
    "straight16.tif": (tiff(np.dstack((COLOR16, ALPHA16)), extra_sample=2), on_white(COLOR16, ALPHA16, 65535)),
    "untold.tif": (tiff(np.dstack((COLOR, ALPHA)), order=">"), on_white(COLOR, ALPHA, 255)),
    "associated.tif": (
        tiff(np.dstack((premultiplied(COLOR, ALPHA), ALPHA)), extra_sample=1),
        on_white(COLOR, ALPHA, 255),
    ),
    "associated16.tif": (
        tiff(np.dstack((premultiplied(COLOR16, ALPHA16), ALPHA16)), extra_sample=1, order=">"),
        on_white(COLOR16, ALPHA16, 65535),
    ),
    "key.png": (
        png(GREY, ((b"tRNS", struct.pack(">H", GREY[2, 3])),)),
        np.where(GREY[2, 3] == GREY, 255, GREY),
    ),
    "key16.png": (
        png(GREY16, ((b"tRNS", struct.pack(">H", GREY16[2, 3])),)),
        np.where(GREY16[2, 3] == GREY16, 65535, GREY16),
    ),
    "key2bit.png": (
        png(GREY % 4, ((b"tRNS", struct.pack(">H", 1)),), depth=2),
        np.where(GREY % 4 == 1, 255, GREY % 4 * 85),
    ),
    "keycolor.png": (
        png(COLOR, ((b"tRNS", struct.pack(">HHH", *COLOR[2, 3])),)),
        np.where((COLOR[2, 3] == COLOR).all(axis=2)[..., None], 255, COLOR),
    ),
}


@pytest.mark.parametrize("name", TRANSPARENT)
def test_transparency_is_paper(tmp_path, name):
    data, expected = TRANSPARENT[name]
    (tmp_path / name).write_bytes(data)
    file = read_image_file(tmp_path / name)
    assert file.notes == ("transparent: composed on white",)
    assert file.pixels.shape == expected.shape
    # Associated colours are rounded once more.
    assert np.abs(file.pixels - expected).max() <= (1.01 if ".tif" in name else 0.51)


def test_transparent_palettes_and_webp(tmp_path):
    palette = Pillow.fromarray(COLOR).quantize(16)
    opaque = np.array(palette.convert("RGB"))
    share = np.arange(16) * 17
    palette.save(tmp_path / "palette.png", transparency=bytes(share.tolist()))
    expected = on_white(opaque, share[np.array(palette)], 255)
    assert np.abs(read_image(tmp_path / "palette.png") - expected).max() <= 0.51
    Pillow.fromarray(np.dstack((COLOR, ALPHA))).save(tmp_path / "a.webp", lossless=True, exact=True)
    if not is_decoder_safe():
        with pytest.raises(FileError, match=r"WebP with OpenCV 4.*; need OpenCV 4.8.1 or newer"):
            read_image(tmp_path / "a.webp")
        return
    assert np.abs(read_image(tmp_path / "a.webp") - on_white(COLOR, ALPHA, 255)).max() <= 0.51


def test_floats_and_hidden_values(tmp_path):
    """A transparent pixel may hold anything, NaN too: none of it shows."""
    alpha = np.linspace(0, 1, 54, dtype=np.float32).reshape(6, 9)
    color = FLOATS.copy()
    expected = on_white(color, alpha, 1.0)
    color[0, 0] = np.nan
    (tmp_path / "a.tif").write_bytes(tiff(np.dstack((color, alpha)), extra_sample=2))
    assert np.abs(read_image(tmp_path / "a.tif") - expected).max() < 1e-6


@pytest.mark.parametrize(
    ("name", "data", "expected"),
    [
        ("opaque.png", png(np.dstack((COLOR, np.full_like(ALPHA, 255)))), COLOR),
        ("opaque_la.png", png(np.dstack((GREY, np.full_like(ALPHA, 255)))), GREY),
        ("opaque.tif", tiff(np.dstack((COLOR16, np.full_like(ALPHA16, 65535))), extra_sample=2), COLOR16),
        ("unspecified.tif", tiff(np.dstack((COLOR, ALPHA)), extra_sample=0), COLOR),
        ("unused_key.png", png(GREY // 2, ((b"tRNS", struct.pack(">H", 255)),)), GREY // 2),
    ],
)
def test_what_is_opaque_stays_and_nothing_is_said(tmp_path, name, data, expected):
    (tmp_path / name).write_bytes(data)
    file = read_image_file(tmp_path / name)
    assert np.array_equal(file.pixels, expected)
    assert (file.notes, file.alpha) == ((), None)


def test_transparency_and_orientation_together(tmp_path):
    data = png(np.dstack((COLOR, ALPHA)), ((b"eXIf", exif(6)),))
    (tmp_path / "a.png").write_bytes(data)
    turned = read_image_file(tmp_path / "a.png", upright=True)
    assert np.abs(turned.pixels - UPRIGHT[6](on_white(COLOR, ALPHA, 255))).max() <= 0.51
    assert np.array_equal(turned.alpha, UPRIGHT[6](ALPHA))
    assert len(read_image_file(tmp_path / "a.png").notes) == 2


def test_other_kinds_of_files(tmp_path):
    """Palettes, one bit, CMYK, sixteen bits: each as an independent writer made it."""
    palette = Pillow.fromarray(COLOR).quantize(16)
    for name in ("palette.png", "palette.tif", "palette.bmp"):
        palette.save(tmp_path / name)
        assert np.array_equal(read_image(tmp_path / name), np.array(palette.convert("RGB")))
    for name in ("bit.png", "bit.tif"):
        Pillow.fromarray(GREY > 127).save(tmp_path / name)
        assert np.array_equal(read_image(tmp_path / name), (GREY > 127) * np.uint8(255))
    Pillow.fromarray(GREY16).save(tmp_path / "deep.png")
    assert np.array_equal(read_image(tmp_path / "deep.png"), GREY16)
    for name, options in (("cmyk.jpg", {"quality": 100}), ("cmyk.tif", {})):
        smooth = np.broadcast_to(np.array([180, 90, 30], np.uint8), (16, 16, 3))
        Pillow.fromarray(np.ascontiguousarray(smooth)).convert("CMYK").save(tmp_path / name, **options)
        assert np.abs(read_image(tmp_path / name).astype(int) - smooth).max() <= 4


@pytest.mark.parametrize("pixels", [np.dstack((GREY, ALPHA)), np.dstack((GREY16, ALPHA16))])
def test_a_tiff_of_grey_and_alpha_is_refused(tmp_path, pixels):
    """Decoders lose its alpha, and of 16 bits the lower 8, without a word."""
    (tmp_path / "a.tif").write_bytes(tiff(pixels, extra_sample=2))
    with pytest.raises(FileError, match=r"a.tif: a TIFF of grey and alpha; need it without transparency, or as a PNG"):
        read_image(tmp_path / "a.tif")
