# SPDX-License-Identifier: Apache-2.0
"""Decompression that trusts no length: zstd, lz4 and bz2, of chunks, messages and whole files."""

from __future__ import annotations

import bz2
import sys
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]

from imgu_ros.bags.storage import DEFAULT_LIMITS
from imgu_ros.errors import BagError
from imgu_ros.params import LimitsParameters

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_BLOCK = 2**20


def decompressed(data: bytes, method: str, size: int, limits: LimitsParameters = DEFAULT_LIMITS) -> bytes:
    """Return exactly `size` bytes from compressed `data`.

    Parameters
    ----------
    data : one compressed frame
    method : "", "zstd", "lz4" or "bz2"
    size : the announced size
    limits : `message_mb` bounds the size

    Raises
    ------
    BagError
        If the method is unknown, the data are damaged, or the size differs.
    """
    check_message_size(size, limits)
    if method == "":
        result = data
    elif method == "zstd":
        result = _decompressed_zstd(data, size)
    elif method == "lz4":
        result = _decompressed_lz4(data, size)
    elif method == "bz2":
        result = _decompressed_bz2(data, size)
    else:
        raise BagError(f"compression {method!r}; need none, zstd, lz4 or bz2")
    if len(result) != size:
        raise BagError(f"{len(result)} bytes decompressed; need {size}")
    return result


def decompressed_message(data: bytes | memoryview, limits: LimitsParameters = DEFAULT_LIMITS) -> bytes | memoryview:
    """Return a message's bytes, decompressed when rosbag2 compressed it by itself.

    Serialised messages begin with 0 (CDR), never with zstd's magic, so that no metadata is needed to tell.

    Raises
    ------
    BagError
        If the compressed data are damaged or larger than any sane message.
    """
    if data[: len(ZSTD_MAGIC)] != ZSTD_MAGIC:
        return data
    result = _decompressed_zstd(data, 1_000_000 * limits.message_mb)
    check_message_size(len(result), limits)
    return result


def check_message_size(size: int, limits: LimitsParameters) -> None:
    """Refuse a message or a chunk of more than `limits.message_mb`.

    Raises
    ------
    BagError
        If `size`, in bytes, is more.
    """
    if size > 1_000_000 * limits.message_mb:
        raise BagError(f"{size / 1e6:.1f} MB or more; need at most {limits.message_mb} (limits.message_mb)")


def decompress_file(source: Path, target: Path, limits: LimitsParameters = DEFAULT_LIMITS) -> str:
    """Decompress a zstd file as far as it goes; return what was wrong, empty when nothing was.

    Raises
    ------
    BagError
        If the target cannot be written.
    """
    try:
        with source.open("rb") as packed, target.open("wb") as plain:
            decompressor = zstd.ZstdDecompressor()
            while block := packed.read(_BLOCK):
                while block:
                    if decompressor.eof:
                        decompressor = zstd.ZstdDecompressor()
                    plain.write(decompressor.decompress(block))
                    block = decompressor.unused_data if decompressor.eof else b""
            return "" if decompressor.eof else "the compressed file is cut short"
    except zstd.ZstdError as error:
        return f"the compressed file is damaged ({error})"
    except OSError as error:
        raise BagError(f"{source}: cannot decompress to {target.parent}: {error.strerror}") from None


def _decompressed_zstd(data: bytes | memoryview, limit: int) -> bytes:
    decompressor = zstd.ZstdDecompressor()
    try:
        result = decompressor.decompress(data, max_length=limit + 1)
    except zstd.ZstdError as error:
        raise BagError(f"zstd data are damaged ({error})") from None
    except MemoryError:
        raise BagError("zstd data need more memory than there is") from None
    if not decompressor.eof and len(result) <= limit:
        raise BagError("zstd data are cut short")
    return result


def _decompressed_lz4(data: bytes, size: int) -> bytes:
    if size > 255 * len(data) + 64:  # no lz4 data expand more
        raise BagError(f"announces {size} bytes from {len(data)} compressed ones; lz4 cannot")
    decompressor = lz4.frame.LZ4FrameDecompressor()
    try:
        result: bytes = decompressor.decompress(data, max_length=size + 1)
    except (RuntimeError, MemoryError) as error:
        raise BagError(f"lz4 data are damaged ({error})") from None
    return result


def _decompressed_bz2(data: bytes, size: int) -> bytes:
    try:
        return bz2.BZ2Decompressor().decompress(data, max_length=size + 1)
    except (OSError, EOFError, MemoryError) as error:
        raise BagError(f"bz2 data are damaged ({error})") from None
