# SPDX-License-Identifier: Apache-2.0
"""zstd for the seeds: bounded decompression, and frames that are much longer than they look."""

from __future__ import annotations

import struct
import sys
from functools import cache

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

_BLOCK = 2**17


def compressed(data: bytes) -> bytes:
    """Return a frame."""
    return zstd.compress(data, level=1)


def decompressed(data: bytes, most: int) -> bytes:
    """Return what one frame holds; ValueError when it is damaged, cut, or longer than `most`."""
    decompressor = zstd.ZstdDecompressor()
    try:
        result = decompressor.decompress(data, max_length=most + 1)
    except zstd.ZstdError as error:
        raise ValueError(str(error)) from None
    if not decompressor.eof or decompressor.unused_data or len(result) > most:
        raise ValueError("cut, too long, or something behind it")
    return result


def decompressed_file(data: bytes, most: int) -> bytes:
    """Return what the frames of a file hold, as far as they go, up to `most` bytes."""
    whole = b""
    while data and len(whole) < most:
        decompressor = zstd.ZstdDecompressor()
        try:
            whole += decompressor.decompress(data, max_length=most - len(whole))
        except zstd.ZstdError:
            break
        if not decompressor.eof:
            break
        data = decompressor.unused_data
    return whole


@cache
def repeated(size: int) -> bytes:
    """Return a frame of `size` zeros, a multiple of 128 KB: blocks of one repeated byte, 4 bytes for each 128 KB."""
    blocks = size // _BLOCK
    head = b"\x28\xb5\x2f\xfd" + b"\x00" + b"\x38"  # no size given, a window of 128 KB
    block = [struct.pack("<I", last | 1 << 1 | _BLOCK << 3)[:3] + b"\0" for last in (0, 1)]
    return head + block[0] * (blocks - 1) + block[1]
