# SPDX-License-Identifier: Apache-2.0
"""Named pictures: small files that ask for much."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np

from fuzz.corpus_entry import Entry, file_of
from fuzz.kinds import PICTURE
from fuzz.pictures import Chunk, jpeg, jpeg_seeds, png_file, scene, segments
from fuzz.rasters import bmp, gif, tiff

_SOF0, _SOF2, _SOS = 0xC0, 0xC2, 0xDA


def _two_frame_headers() -> bytes:
    """A small frame header, which the structure's check may take, and a huge one behind it."""
    parts = segments(jpeg_seeds()[4])
    at = next(i for i, (marker, _) in enumerate(parts) if marker == _SOF0)
    marker, content = parts[at]
    parts.insert(at + 1, (marker, content[:1] + struct.pack(">HH", 65000, 32000) + content[5:]))
    return jpeg(parts)


def _huge_after_small() -> bytes:
    """As before, the huge frame header behind the first scan, where few look."""
    parts = segments(jpeg_seeds()[4])
    marker, content = next(part for part in parts if part[0] == _SOF0)
    end = len(parts) - 1
    parts[end:end] = [(marker, content[:1] + struct.pack(">HH", 65000, 65000) + content[5:])]
    return jpeg(parts)


def _many_scans(width: int = 4000, count: int = 20_000) -> bytes:
    """A progressive JPEG whose thousands of scans each go over every pixel."""
    data = cv2.imencode(".jpg", scene(64, 64, 1), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    parts = segments(data)
    at = next(i for i, (marker, _) in enumerate(parts) if marker == _SOF2)
    marker, content = parts[at]
    parts[at] = (marker, content[:1] + struct.pack(">HH", width, width) + content[5:])
    first = next(i for i, (marker, _) in enumerate(parts) if marker == _SOS)
    last = max(i for i, (marker, _) in enumerate(parts) if marker == _SOS)
    return (
        jpeg(parts[:last])
        + jpeg(parts[last : last + 1] + [(-1, b"\0\0\0")]) * count
        + jpeg(parts[first : first + 2])
        + b"\xff\xd9"
    )


def _png_size(width: int, height: int, depth: int, color: int, extra: list[Chunk] | None = None) -> bytes:
    """A PNG of one colour: nearly nothing, packed."""
    bits = depth * {0: 1, 2: 3, 6: 4}[color]
    row = b"\0" * (1 + -(-width * bits // 8))
    packer = zlib.compressobj(9)
    packed = b"".join(packer.compress(row) for _ in range(height)) + packer.flush()
    header = struct.pack(">IIBBBBB", width, height, depth, color, 0, 0, 0)
    return png_file([(b"IHDR", header), *(extra or []), (b"IDAT", packed), (b"IEND", b"")])


def _large_photograph(width: int = 8000, height: int = 6250) -> bytes:
    """50 megapixels of 16 bits, which a camera may have: every 50th row is noise."""
    rng = np.random.default_rng(0)
    packer = zlib.compressobj(1)
    rows = (b"\0" + (rng.bytes(2 * width) if y % 50 == 0 else bytes(2 * width)) for y in range(height))
    packed = b"".join(map(packer.compress, rows)) + packer.flush()
    header = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    return png_file([(b"IHDR", header), (b"IDAT", packed), (b"IEND", b"")])


def _bomb(kind: bytes, head: bytes, size: int = 500_000_000) -> Chunk:
    packer = zlib.compressobj(9)
    block = bytes(10**6)
    return kind, head + b"".join(packer.compress(block) for _ in range(size // 10**6)) + packer.flush()


def _loop(folder: Path) -> Path:
    path = folder / "picture.png"
    path.symlink_to(path)
    return path


def _device(folder: Path) -> Path:
    path = folder / "picture.png"
    path.symlink_to("/dev/zero")
    return path


def _of_no_encoding(folder: Path) -> Path:
    path = Path(str(folder) + "/b\udce4\udc80r\x1b[31m.png")
    path.write_bytes(b"no picture")
    return path


ENTRIES: dict[str, Entry] = {
    "jpeg_two_frame_headers": Entry(PICTURE, file_of("p.jpg", _two_frame_headers), is_read=False),
    "jpeg_frame_header_after_the_scan": Entry(PICTURE, file_of("p.jpg", _huge_after_small)),
    "jpeg_thousands_of_scans": Entry(PICTURE, file_of("p.jpg", _many_scans), is_read=False),
    "gif_32000": Entry(PICTURE, file_of("p.gif", lambda: gif(32000, 32000)), is_read=False),
    "gif_small_screen_large_frame": Entry(PICTURE, file_of("p.gif", lambda: gif(8, 8, (65535, 65535)))),
    "pbm_of_one_bit": Entry(PICTURE, file_of("p.pbm", lambda: b"P4 20000 20000\n" + bytes(50_000_000))),
    "pbm_as_text": Entry(PICTURE, file_of("p.pbm", lambda: b"P1 6000 6000\n" + b"0" * 36_000_000)),
    "pgm_of_endless_width": Entry(
        PICTURE, file_of("p.pgm", lambda: b"P5 " + b"9" * 400 + b" 1 255\n\0"), is_read=False
    ),
    "ppm_16_bit_cut": Entry(PICTURE, file_of("p.ppm", lambda: b"P6 60000 60000 65535\n" + bytes(100)), is_read=False),
    "png_30000_of_one_bit": Entry(PICTURE, file_of("p.png", lambda: _png_size(30000, 30000, 1, 0))),
    "png_20000_rgba_16": Entry(PICTURE, file_of("p.png", lambda: _png_size(20000, 2000, 16, 6))),
    "png_profile_bomb": Entry(PICTURE, file_of("p.png", lambda: _png_size(40, 30, 8, 2, [_bomb(b"iCCP", b"p\0\0")]))),
    "png_text_bomb": Entry(PICTURE, file_of("p.png", lambda: _png_size(40, 30, 8, 2, [_bomb(b"zTXt", b"k\0\0")]))),
    "png_pixels_bomb": Entry(
        PICTURE,
        file_of(
            "p.png",
            lambda: png_file(
                [(b"IHDR", struct.pack(">IIBBBBB", 9, 9, 8, 0, 0, 0, 0)), _bomb(b"IDAT", b""), (b"IEND", b"")]
            ),
        ),
    ),
    "tiff_40000": Entry(PICTURE, file_of("p.tif", lambda: tiff(bytes(100), 40000, 40000, {})), is_read=False),
    "tiff_of_one_bit": Entry(PICTURE, file_of("p.tif", lambda: tiff(bytes(10**7), 40000, 40000, {258: 1, 259: 4}))),
    "bmp_32000": Entry(PICTURE, file_of("p.bmp", lambda: bmp(32000, 32000, 8, 1, b"\0\1"))),
    "picture_loop": Entry(PICTURE, _loop, is_read=False),
    "picture_device": Entry(PICTURE, _device, is_read=False),
    "picture_name_not_utf8": Entry(PICTURE, _of_no_encoding, is_read=False),
    "picture_near_the_bound": Entry(PICTURE, file_of("p.png", _large_photograph), is_read=True),
}
