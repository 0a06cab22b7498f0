# SPDX-License-Identifier: Apache-2.0
"""Image files made to take memory or time, of every kind that is read, and those that are not."""

from __future__ import annotations

import io
import struct
import subprocess
import sys
import zlib
from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import Image as Pillow

from imgu_ros.cli.main import main
from imgu_ros.config.parameters import DEFAULT_LIMITS, TargetsParameters
from imgu_ros.errors import EncodingError, FileError
from imgu_ros.files.target_images import load_target_images
from imgu_ros.image_files.formats import is_decoder_safe
from imgu_ros.image_files.images import read_image, read_image_file, read_raw_image
from imgu_ros.image_files.pnm import decode_pnm

#: numpy's letters for TIFF's SHORT and LONG.
SHORT, LONG = (3, "H"), (4, "I")


def tiff(size, *, bits=8, samples=1, compression=1, data=b"", part=b"", fields=None, tile=None, rows=0, big=False):
    """A TIFF whose strips or tiles all are the bytes `part`; `fields` replaces or adds some, None removes one."""
    width, height = size
    rows = rows or height
    parts = -(-height // rows) if tile is None else -(-width // tile[0]) * -(-height // tile[1])
    values = {
        256: (LONG, [width]), 257: (LONG, [height]), 258: (SHORT, [bits] * samples), 259: (SHORT, [compression]),
        262: (SHORT, [2 if samples > 2 else 1]), 277: (SHORT, [samples]),
    }  # fmt: skip
    places, sizes = (LONG, [16] * parts), (LONG, [len(part)] * parts)
    if tile is None:
        values |= {273: places, 278: (LONG, [rows]), 279: sizes}
    else:
        values |= {322: (LONG, [tile[0]]), 323: (LONG, [tile[1]]), 324: places, 325: sizes}
    values |= fields or {}
    present = sorted((tag, value) for tag, value in values.items() if value is not None)
    place, most, count = ("Q", 8, "Q") if big else ("I", 4, "H")
    at = 16 + len(part) + len(part) % 2
    outside_at = at + struct.calcsize("<" + count) + (20 if big else 12) * len(present) + most
    entries, outside = b"", b""
    for tag, ((kind, letter), numbers) in present:
        raw = struct.pack(f"<{len(numbers)}{letter}", *numbers)
        entries += struct.pack("<HH" + place, tag, kind, len(numbers))
        if len(raw) <= most:
            entries += raw.ljust(most, b"\0")
        else:
            entries += struct.pack("<" + place, outside_at + len(outside))
            outside += raw
    head = struct.pack("<HHHHQ", 0x4949, 43, 8, 0, at) if big else struct.pack("<HHI8x", 0x4949, 42, at)
    directory = struct.pack("<" + count, len(present)) + entries + bytes(most)
    return head + part + bytes(len(part) % 2) + directory + outside + data


def bmp(width: int, height: int, bits: int = 24, compression: int = 0, data: bytes = b"") -> bytes:
    header = struct.pack("<IiiHHIIiiII", 40, width, height, 1, bits, compression, 0, 0, 0, 0, 0)
    return b"BM" + struct.pack("<IHHI", 0, 0, 0, 54) + header + data


def webp(*chunks: tuple[bytes, bytes]) -> bytes:
    body = b"".join(
        name + struct.pack("<I", len(content)) + content + bytes(len(content) % 2) for name, content in chunks
    )
    return b"RIFF" + struct.pack("<I", 4 + len(body)) + b"WEBP" + body


def extended(flags: int, width: int, height: int) -> tuple[bytes, bytes]:
    return b"VP8X", bytes((flags, 0, 0, 0)) + (width - 1).to_bytes(3, "little") + (height - 1).to_bytes(3, "little")


def lossless(width: int, height: int) -> tuple[bytes, bytes]:
    return b"VP8L", b"\x2f" + ((width - 1) | (height - 1) << 14).to_bytes(4, "little") + bytes(8)


def lossy(width: int, height: int) -> tuple[bytes, bytes]:
    return b"VP8 ", b"\x30\1\0\x9d\1\x2a" + struct.pack("<HH", width, height) + bytes(20)


ROWS = zlib.compress(bytes(16 * 64))
NOT_READ = {
    "gif": (b"GIF89a\0\x7d\0\x7d\x80\0\0\0\0\0\xff\xff\xff,\0\0\0\0\0\x7d\0\x7d\0\2\2D\1\0;", "a GIF; need a PNM, PNG"),
    "jpeg-2000": (b"\0\0\0\x0cjP  \r\n\x87\n" + bytes(99), "a JPEG 2000; need"),
    "j2k": (b"\xff\x4f\xff\x51" + bytes(99), "a JPEG 2000; need"),
    "avif": (b"\0\0\0\x20ftypavif" + bytes(99), "an AVIF or HEIC; need"),
    "exr": (b"v/1\1" + bytes(99), "an OpenEXR; need"),
    "hdr": (b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 40000 +X 40000\n", "a Radiance HDR; need"),
    "sun": (b"\x59\xa6\x6a\x95" + bytes(99), "a Sun raster; need"),
    "pam": (b"P7\nWIDTH 40000\nHEIGHT 40000\nDEPTH 4\nMAXVAL 255\nENDHDR\n", "a PAM or PFM; need"),
    "pfm": (b"PF\n40000 40000\n-1\n", "a PAM or PFM; need"),
    "else": (b"\x7fELF" + bytes(99), r"not an image \(103 bytes\); need a PNM, PNG, TIFF, JPEG, BMP or WebP"),
}
MEMORY = r"need at most 1000 \(limits.picture_mb\)"
PASSES = r"megapixels with all its passes; need at most 2000 \(limits.picture_megapixels\)"
REFUSED = {
    "tiff-width": (tiff((2**31, 1), part=ROWS, compression=8), "2147483648 x 1 px: needs"),
    "tiff-memory": (tiff((30_000, 30_000), samples=3, part=ROWS, compression=8, rows=16), MEMORY),
    "tiff-strip": (tiff((9000, 9000), samples=3, part=ROWS, compression=8), MEMORY),
    "tiff-tile": (tiff((64, 64), part=ROWS, compression=8, tile=(2**15, 2**14)), MEMORY),
    "tiff-tiles": (tiff((1000, 1000), part=ROWS, compression=8, tile=(16, 2**21)), PASSES),
    "tiff-strips": (tiff((1, 300_000), part=ROWS, compression=8, rows=1), PASSES),
    "tiff-shared": (tiff((100, 50_000), part=bytes(30_000), rows=1), r"strips or tiles: needs 1500 MB; " + MEMORY),
    "tiff-count": (tiff((64, 64), part=ROWS, fields={273: (LONG, [16] * 9)}), "9 strips or tiles for 64 x 64 px"),
    "tiff-no-strips": (tiff((64, 64), part=ROWS, fields={273: None}), "0 strips or tiles for"),
    "tiff-no-tile": (tiff((64, 64), part=ROWS, tile=(16, 16), fields={323: (LONG, [0])}), "parts of 16 x 0 px"),
    "tiff-jpeg": (tiff((64, 64), part=ROWS, compression=7), "TIFF of compression 7; need none, LZW, deflate"),
    "tiff-old-jpeg": (tiff((64, 64), part=ROWS, compression=6), "TIFF of compression 6"),
    "tiff-fax": (tiff((64, 64), part=ROWS, compression=4), "TIFF of compression 4"),
    "tiff-samples": (tiff((64, 64), part=ROWS, fields={277: (SHORT, [65535])}), "65535 samples"),
    "tiff-bits": (tiff((64, 64), part=ROWS, fields={258: (SHORT, [65535])}), "65535 bits"),
    "tiff-mixed": (tiff((64, 64), part=ROWS, samples=3, fields={258: (SHORT, [8, 8, 16])}), r"\[8, 8, 16\] bits"),
    "tiff-lab": (tiff((64, 64), part=ROWS, samples=3, fields={262: (SHORT, [8])}), "colours of kind 8"),
    "tiff-0": (tiff((0, 64), part=ROWS, rows=1), "TIFF of 0 x 64 px"),
    "tiff-directory": (b"II*\0\xff\xff\xff\x7f" + bytes(50), "no directory"),
    "tiff-tags": (b"II*\0\x08\0\0\0\xff\xff" + bytes(12 * 65535), "a directory of 65535 tags"),
    "bigtiff-tags": (
        b"II+\0\x08\0\0\0" + struct.pack("<QQ", 16, 2**63) + bytes(50),
        "a directory of 9223372036854775808",
    ),
    "tiff-beyond": (
        b"II*\0\x08\0\0\0\1\0" + struct.pack("<HHII", 273, 4, 2**30, 8) + bytes(4),
        "tag 273 of 1073741824 values, beyond the end",
    ),
    "tiff-kind": (b"II*\0\x08\0\0\0\1\0" + struct.pack("<HHII", 256, 5, 1, 8) + bytes(4), "tag 256 of type 5"),
    "bmp-claim": (bmp(30_000, 30_000), "BMP of 30000 x 30000 px cut after 54 bytes; need 2700000054"),
    "bmp-minimum": (bmp(1, -(2**31)), "cut after 54 bytes"),
    "bmp-runs": (bmp(8, 8, 8, 1, bytes(100)), "BMP of compression 1; need none"),
    "bmp-bits": (bmp(8, 8, 5, 0, bytes(100)), "5 bits"),
    "bmp-cut": (b"BM" + bytes(10), "BMP cut after 12 bytes"),
    "pbm": (b"P4 40000 40000\n" + bytes(100), r"PNM of 40000 x 40000 px: needs 3201 MB; " + MEMORY),
    "webp-animation": (webp(extended(2, 8, 8), (b"ANIM", bytes(6))), "WebP animation; need a single picture"),
    "webp-canvas": (webp(extended(0, 2**24, 2**24), lossy(8, 8)), "WebP of 16777216 x 16777216 px with a picture of 8"),
    "webp-lossless": (webp(lossless(16384, 16384)), "WEBP of 16384 x 16384 px: needs"),
    "webp-lossy": (webp(lossy(16383, 16383)), "WEBP of 16383 x 16383 px: needs"),
    "webp-nothing": (webp((b"EXIF", bytes(10))), "WebP without a picture"),
    "webp-noise": (webp((b"VP8L", b"\1" * 20)), "WebP chunk b'VP8L' begins with"),
}


@pytest.mark.parametrize("name", NOT_READ)
def test_other_formats_are_named_and_go_to_no_decoder(tmp_path, monkeypatch, name):
    content, says = NOT_READ[name]
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("a decoder saw it"))
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(FileError, match=f"a.png: {says}"):
        read_image(tmp_path / "a.png")


@pytest.mark.parametrize("name", REFUSED)
def test_refused_before_memory_is_taken(tmp_path, monkeypatch, name):
    content, says = REFUSED[name]
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("a decoder saw it"))
    (tmp_path / "a").write_bytes(content)
    if name.startswith("webp") and not is_decoder_safe():
        says = "need OpenCV 4.8.1 or newer"
    with pytest.raises(FileError, match=says) as caught:
        read_image(tmp_path / "a")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("compression", [1, 8, 32946, 32773])
def test_tiffs_of_strips_and_tiles_are_read(tmp_path, compression, big):
    """PackBits: a run of 128 zeros is two bytes."""
    packed = {1: bytes, 32773: lambda count: b"\x81\0" * (count // 128)}
    part = packed.get(compression, lambda count: zlib.compress(bytes(count)))
    files = {
        "strip": tiff((64, 48), samples=3, part=part(64 * 48 * 3), compression=compression, big=big),
        "strips": tiff((64, 48), part=part(64 * 16), compression=compression, rows=16, big=big),
        "tiles": tiff((100, 50), part=part(64 * 32), compression=compression, tile=(64, 32), big=big),
        "deep": tiff((64, 48), bits=16, part=part(64 * 16 * 2), compression=compression, rows=16, big=big),
    }
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
        pixels = read_image(tmp_path / name)
        assert (pixels.size > 0, pixels.any()) == (True, False)
        assert pixels.dtype == (np.uint16 if name == "deep" else np.uint8)


@pytest.mark.parametrize(("order", "part"), [(1, b"\xb0\x01"), (2, b"\x0d\x80")])
def test_the_order_of_bits_in_a_tiff_counts(tmp_path, order, part):
    (tmp_path / "a").write_bytes(tiff((8, 2), bits=1, part=part, fields={266: (SHORT, [order])}))
    assert read_image(tmp_path / "a").tolist() == [[255, 0, 255, 255, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0, 0, 255]]


def test_tags_beside_the_picture_never_reach_a_decoder(tmp_path, monkeypatch):
    """Directories that go in circles, Exif, profiles: none of it makes the picture."""
    seen: list[bytes] = []
    decode = cv2.imdecode
    monkeypatch.setattr(cv2, "imdecode", lambda data, flags: seen.append(data.tobytes()) or decode(data, flags))
    fields = {274: (SHORT, [6]), 330: (LONG, [8, 8, 8]), 34665: (LONG, [8]), 34675: (SHORT, [1, 2, 3, 4])}
    (tmp_path / "a").write_bytes(tiff((64, 48), part=bytes(64 * 48), fields=fields))
    file = read_image_file(tmp_path / "a")
    assert file.pixels.shape == (48, 64)
    assert file.notes == ("orientation tag 6 ignored: pixels stay as the sensor gave them",)
    (at,) = struct.unpack_from("<4xI", seen[0])
    (count,) = struct.unpack_from("<H", seen[0], at)
    tags = [struct.unpack_from("<H", seen[0], at + 2 + 12 * i)[0] for i in range(count)]
    assert tags == [256, 257, 258, 259, 262, 273, 277, 278, 279]
    assert struct.unpack_from("<I", seen[0], at + 2 + 12 * count) == (0,)


def test_a_file_larger_than_the_limit_is_not_read(tmp_path):
    with open(tmp_path / "a.png", "wb") as stream:
        stream.truncate(10**13)  # without a block on the disk
    for read in (read_image, lambda path: read_raw_image(path, 10**7, 10**6, "uint8")):
        with pytest.raises(FileError, match=r"a.png: its size: needs 10000000 MB; " + MEMORY):
            read(tmp_path / "a.png")


@pytest.mark.parametrize("text", [b"# \n", b"\n\n\n"])
def test_text_without_end_is_read_no_further(text):
    limits = replace(DEFAULT_LIMITS, picture_megapixels=100)
    with pytest.raises(EncodingError, match=r"PNM of \d+ bytes of text: 1\d\d megapixels .*need at most 100"):
        decode_pnm(b"P2 300 300 255\n" + text * 3_000_000, limits)


def test_a_header_of_comments_takes_little_memory():
    code = (
        "import resource\n"
        "from imgu_ros.image_files.pnm import decode_pnm\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "assert decode_pnm(b'P5\\n' + b'#\\n' * 10**6 + b'1 1' + b' #\\n' * 10**6 + b'255 \\7').tolist() == [[7]]\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert int(done.stdout) < 50_000  # kB


def test_limits_are_passed_on(tmp_path):
    for name in ("a.png", "a.tif", "a.bmp", "a.pgm", "a.jpg"):
        Pillow.fromarray(np.zeros((1000, 1000), np.uint8)).save(tmp_path / name)
        assert read_image(tmp_path / name, limits=replace(DEFAULT_LIMITS, picture_mb=10)).shape[:2] == (1000, 1000)
        with pytest.raises(FileError, match=r"need at most 1 \(limits.picture_mb\)"):
            read_image(tmp_path / name, limits=replace(DEFAULT_LIMITS, picture_mb=1))


@pytest.mark.parametrize(
    "command", [["filter", "--method", "gaussian"], ["warp", "--scale", "0.5"], ["demosaic", "--pattern", "rggb"]]
)
def test_commands_take_the_limit(tmp_path, capsys, command):
    Pillow.fromarray(np.zeros((1000, 1000), np.uint8)).save(tmp_path / "a.png")
    name, *options = command
    arguments = [name, str(tmp_path / "a.png"), str(tmp_path / "b.png"), *options]
    assert main([*arguments, "-p", "limits.picture_mb:=1"]) == 1
    assert "a.png: PNG of 1000 x 1000 px: needs 3 MB; need at most 1 (limits.picture_mb)" in capsys.readouterr().err


@pytest.mark.parametrize("size", [(20_000, 20_000), (10**8, 1), (1, 10**8), (6400, 6400)])
def test_a_target_beyond_what_can_be_prepared_is_refused(tmp_path, monkeypatch, size):
    width, height = size
    monkeypatch.setattr(np, "unpackbits", lambda *_, **__: pytest.fail("pixels were made"))
    with open(tmp_path / "poster.pbm", "wb") as stream:
        stream.write(f"P4 {width} {height}\n".encode())
        stream.truncate(stream.tell() + height * -(-width // 8))
    needed = -(-25 * width * height // 10**6)
    with pytest.raises(FileError, match=rf"poster.pbm: PNM of {width} x {height} px: needs {needed} MB; {MEMORY}"):
        load_target_images(TargetsParameters(images=(str(tmp_path / "poster.pbm"),)))


def test_a_larger_target_is_read_when_the_limit_allows_it(tmp_path):
    Pillow.fromarray(np.tile(np.arange(250, dtype=np.uint8), (200, 1))).save(tmp_path / "a.png")
    targets = TargetsParameters(images=(str(tmp_path / "a.png"),))
    with pytest.raises(FileError, match="PNG of 250 x 200 px: needs 2 MB; need at most 1"):
        load_target_images(targets, limits=replace(DEFAULT_LIMITS, picture_mb=1))
    (target,) = load_target_images(targets, limits=replace(DEFAULT_LIMITS, picture_mb=2))
    assert target.pixels.shape == (200, 250)


@pytest.mark.parametrize("comment", [b"", b"# a comment of 1 2 3\n", b"#" + b"9" * 2_000_000 + b"\n"])
@pytest.mark.parametrize("separator", [b" ", b"\n", b"\t\r\n  "])
def test_plain_text_is_read_in_pieces(comment, separator):
    """Numbers and comments across the ends of pieces, against what Python reads of the words."""
    values = np.random.default_rng(3).integers(0, 65536, (300, 1000), np.uint16)
    words = [b"%d" % value for value in values.ravel().tolist()]
    half = len(words) // 2
    text = separator.join(words[:half]) + separator + comment + separator.join(words[half:])
    content = b"P2 1000 300 65535\n" + text + b"\nP2 1 1 255 next picture"
    np.testing.assert_array_equal(decode_pnm(content), values)


def test_plain_bits_are_read_in_pieces():
    bits = np.random.default_rng(3).integers(0, 2, (1200, 1500), np.uint8)
    text = (bits + ord("0")).tobytes().replace(b"0101", b"01 # note\n 01")
    np.testing.assert_array_equal(decode_pnm(b"P1 1500 1200\n" + text), np.where(bits, 0, 255))


def test_bitmaps_and_transparency_take_no_more_than_is_said(tmp_path):
    """A bitmap of 121 megapixels took 0.9 GB, a transparent picture of 9 took 0.6 GB."""
    (tmp_path / "a.pbm").write_bytes(b"P4 11000 11000\n" + bytes(1375 * 11000))
    stream = io.BytesIO()
    Pillow.new("RGBA", (3000, 3000), (1, 2, 3, 100)).save(stream, "PNG", compress_level=1)
    (tmp_path / "a.png").write_bytes(stream.getvalue())
    program = (
        "import resource, sys\n"
        "resource.setrlimit(resource.RLIMIT_AS, (3 * 2**30,) * 2)\n"
        "from imgu_ros.image_files.images import read_image\n"
        "def peak():\n"
        "    return int(open('/proc/self/status').read().split('VmHWM:')[1].split()[0])\n"
        "before = peak()\n"
        "read_image(sys.argv[1])\n"
        "print((peak() - before) // 1000)\n"
    )
    for name, most in (("a.pbm", 150), ("a.png", 95)):  # 86 on Python 3.14
        done = subprocess.run(
            [sys.executable, "-c", program, str(tmp_path / name)],
            capture_output=True,
            text=True,
            timeout=60,
            check=True,
        )
        assert int(done.stdout) < most
