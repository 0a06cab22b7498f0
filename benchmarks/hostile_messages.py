# SPDX-License-Identifier: Apache-2.0
"""Messages made to break a node that takes images: what they say of themselves is a lie, or they are no messages."""

from __future__ import annotations

import array
import random
import struct
import time
import zlib
from typing import Any

import cv2
import numpy as np

SIZES = (0, 1, 2, 3, 31, 64, 65, 4096, 65_535, 2**31 - 1, 2**31, 2**32 - 1)
_ENCODINGS = ("mono8", "rgb8", "bgr16", "bayer_rggb8", "bayer_gbrg16", "32FC1", "64FC3", "8UC7", "yuv422", "uyvy", "",
              "nv12", "rgb", "16UC99999", "x" * 500, "8UC0", "ünïcode")  # fmt: skip
_FORMATS = ("jpeg", "png", "", "rgb8; jpeg compressed bgr8", "bayer_rggb8; png compressed", "16UC1; compressedDepth",
            "; ;", "x" * 300)  # fmt: skip
_NUMBERS = (0.0, -1.0, 1e-300, 1e300, float("nan"), float("inf"), -float("inf"), 500.0)
_MODELS = ("plumb_bob", "rational_polynomial", "equidistant", "", "fisheye", "x" * 200)


class Liar:
    """Fills messages with lies.

    Parameters
    ----------
    rng : tells which
    K : of a camera, row by row, of which a few numbers are changed
    size : width and height that go with it
    frame_ids : of which each message has one
    """

    def __init__(self, rng: random.Random, K: np.ndarray, size: tuple[int, int], frame_ids: tuple[str, ...]) -> None:
        self._rng, self._K, self._size, self._frame_ids = rng, K, size, frame_ids

    def header(self, message: Any) -> Any:
        """Write a header; most have the right time: they lie about something else."""
        rng = self._rng
        if rng.random() < 0.2:
            message.header.stamp.sec = rng.choice((0, -(2**31), 2**31 - 1, 5))
            message.header.stamp.nanosec = rng.choice((0, 2**32 - 1))
        else:
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(time.time_ns(), 10**9)
        message.header.frame_id = rng.choice(self._frame_ids)
        return message

    def info(self, info: Any) -> Any:
        """Fill a CameraInfo."""
        rng = self._rng
        self.header(info)
        info.width, info.height = self._size if rng.random() < 0.5 else (rng.choice(SIZES), rng.choice(SIZES))
        k = np.array(self._K, np.float64).ravel()
        for _ in range(rng.choice((0, 1, 3))):
            k[rng.randrange(9)] = rng.choice(_NUMBERS)
        info.k = k
        info.d = array.array("d", [rng.choice(_NUMBERS) for _ in range(rng.choice((0, 4, 5, 8, 14, 300)))])
        info.distortion_model = rng.choice(_MODELS)
        if rng.random() < 0.2:
            info.binning_x, info.roi.width, info.roi.x_offset = (rng.choice(SIZES) for _ in range(3))
        return info

    def image(self, message: Any) -> Any:
        """Fill an Image or a CompressedImage."""
        self.header(message)
        if hasattr(message, "format"):
            message.format = self._rng.choice(_FORMATS)
            data = bad_file(self._rng)
        else:
            data = self._fill(message)
        set_data(message, data)
        return message

    def _fill(self, image: Any) -> bytes:
        """Write the fields of an image that lies, or holds noise; return its data."""
        rng = self._rng
        image.encoding = rng.choice(_ENCODINGS)
        image.width, image.height = rng.choice(SIZES), rng.choice(SIZES)
        image.step = rng.choice((*SIZES, min(2**32 - 1, image.width), min(2**32 - 1, 3 * image.width)))
        image.is_bigendian = rng.choice((0, 1, 255))
        size = rng.choice((0, 1, 100, 4096, 60_000))
        if rng.random() < 0.2:
            image.encoding, image.width, image.height, image.step, size = "mono8", 240, 200, 240, 48_000
        return rng.randbytes(size)


def set_data(message: Any, data: bytes) -> None:
    """Give a message its bytes; assigning them would take as many steps as there are."""
    content = array.array("B")
    content.frombytes(data)
    message.data = content


def bad_file(rng: random.Random) -> bytes:
    """Return a picture file that is cut, damaged, of noise, or a few bytes that claim to be very large."""
    noise = np.frombuffer(rng.randbytes(64 * 48 * 3), np.uint8).reshape(48, 64, 3)
    _, encoded = cv2.imencode(rng.choice((".png", ".jpg")), noise)
    data = bytearray(encoded.tobytes())
    kind = rng.randrange(6)
    if kind == 0:
        return bytes(data[: rng.randrange(len(data))])
    if kind == 1:
        for _ in range(rng.choice((1, 10, 100))):
            data[rng.randrange(len(data))] = rng.randrange(256)
        return bytes(data)
    if kind == 2:
        return rng.randbytes(rng.choice((0, 3, 50, 5000)))
    if kind == 3:
        return png(rng.choice((1, 20_000, 2**31 - 1)), rng.choice((1, 20_000, 2**31 - 1)), b"\0" * 100)
    if kind == 4 and rng.random() < 0.1:
        # It is what it says: 16000 x 16000 pixels of nothing, in a quarter of a megabyte.
        return _BOMB or _make_bomb()
    return bytes(data)


def png(width: int, height: int, content: bytes) -> bytes:
    """Return a PNG file whose header says what it likes."""

    def chunk(name: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(content)) + chunk(b"IEND", b"")


_BOMB = b""


def _make_bomb() -> bytes:
    global _BOMB
    _BOMB = png(16_000, 16_000, bytes(16_001 * 16_000))
    return _BOMB
