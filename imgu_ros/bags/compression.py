# SPDX-License-Identifier: Apache-2.0
"""Decompression that trusts no length, in bounded steps: zstd, lz4 and bz2, of chunks, messages and whole files."""

from __future__ import annotations

import bz2
import shutil
import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import lz4.frame  # type: ignore[import-untyped]
import numpy as np

from imgu_ros.config.parameters import DEFAULT_LIMITS, LimitsParameters
from imgu_ros.errors import BagError

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_BLOCK = 2**20
#: Of each new zstd frame: many small ones in a block would otherwise have its rest copied for each.
_FIRST_FEED = 2**12
#: Up to this size data are decompressed in one call, which has them twice in memory for a moment.
_AT_ONCE = 2**24
#: zstd's own default for streams: 128 MB.
_ZSTD_OPTIONS: dict[int, int] = {zstd.DecompressionParameter.window_log_max: 27}
#: Decompressed bytes allowed whatever the compressed size, of a file on disk and of chunks or messages in memory:
#: black images are compressed to less than a thousandth.
_FREE_ON_DISK, _FREE_IN_PASSING = 1_000_000_000, 2_000_000_000
#: Number of messages allowed whatever the compressed size, and the bytes that each further message counts: messages may
#: be alike except for their times, which alone take more than two bytes each when they are compressed.
_FREE_MESSAGES, _BYTES_A_MESSAGE = 100_000, 2000
#: Of the disk that temporary copies are on, this stays free; of a small one, a tenth.
_RESERVE = 500_000_000
_CHECK_DISK_EVERY = 64_000_000
#: Bytes that a chunk may have beyond those that it announces.
MOST_UNANNOUNCED = 2**23


class Expansion:
    """Bounds the decompressed size of a file: beyond 2 GB, `limits.expansion` times the compressed size."""

    def __init__(self, limits: LimitsParameters) -> None:
        self._factor = limits.expansion
        self._left = _FREE_IN_PASSING
        self._messages_left = _FREE_MESSAGES

    def take(self, packed: int, size: int) -> None:
        """Count `size` bytes decompressed from `packed`; BagError, without counting them, when they are too many."""
        excess = size - self._factor * packed
        if excess > self._left:
            raise BagError(
                f"{packed} bytes become {size}; need at most {self._factor} times as many (limits.expansion)"
            )
        self._left -= max(0, excess)

    def most_messages(self, packed: int) -> int:
        """Return how many messages a chunk of `packed` bytes may hold."""
        return self._messages_left + self._factor * packed // _BYTES_A_MESSAGE

    def take_messages(self, packed: int, count: int) -> int:
        """Count messages that come of `packed` bytes; return how many of them are more than the bytes account for."""
        excess = max(0, count - self._factor * packed // _BYTES_A_MESSAGE)
        self._messages_left = max(0, self._messages_left - excess)
        return excess

    def spare(self, packed: int) -> int:
        """Return how many bytes that it does not announce a chunk of `packed` ones may become."""
        return min(MOST_UNANNOUNCED, self._left + self._factor * packed)


def decompressed(
    data: bytes,
    method: str,
    size: int,
    limits: LimitsParameters = DEFAULT_LIMITS,
    unannounced: int = MOST_UNANNOUNCED,
) -> memoryview:
    """Return what compressed `data` hold: `size` bytes, or, where that is wrong, what is there.

    Parameters
    ----------
    data : compressed frames
    method : "", "zstd", "lz4" or "bz2"
    size : the announced size
    limits : `message_mb` bounds the size
    unannounced : bytes that a small chunk may have instead of its size

    Raises
    ------
    BagError
        If the method is unknown, the data are damaged or cut, or are much more than announced.
    """
    if method == "":
        return memoryview(data)
    if size <= 1_000_000 * limits.message_mb:
        return _unpacked(data, method, size, unannounced)
    with suppress(BagError):
        return _unpacked(data, method, 0, unannounced)  # a wrong size of a small chunk
    raise _too_large(size, limits)


def decompressed_message(
    data: bytes | memoryview, limits: LimitsParameters = DEFAULT_LIMITS, expansion: Expansion | None = None
) -> bytes | memoryview:
    """Return a message's bytes, decompressed when rosbag2 compressed it by itself.

    Serialised messages begin with 0 (CDR), never with zstd's magic, so that no metadata is needed to tell.

    Parameters
    ----------
    data : as recorded
    limits : `message_mb` bounds the size
    expansion : counts what the messages of a bag become

    Raises
    ------
    BagError
        If the compressed data are damaged or larger than the limit.
    """
    if data[: len(ZSTD_MAGIC)] != ZSTD_MAGIC:
        return data
    pieces: list[bytes] = []
    size = 0
    for piece in _pieces(data, "zstd", 1_000_000 * limits.message_mb + 1):
        size += len(piece)
        check_message_size(size, limits)
        pieces.append(piece)
    if expansion is not None:
        expansion.take(len(data), size)
    return pieces[0] if len(pieces) == 1 else _joined(pieces, size)


def check_message_size(size: int, limits: LimitsParameters) -> None:
    """Refuse a message or a chunk of more than `limits.message_mb`.

    Raises
    ------
    BagError
        If `size`, in bytes, is more.
    """
    if size > 1_000_000 * limits.message_mb:
        raise _too_large(size, limits)


def _too_large(size: int, limits: LimitsParameters) -> BagError:
    return BagError(f"{size / 1e6:.0f} MB or more; need at most {limits.message_mb} (limits.message_mb)")


class TemporarySpace:
    """Disk space for all temporary copies of a bag's files together."""

    def __init__(self, limits: LimitsParameters) -> None:
        self._limits = limits
        self._left = 1_000_000 * limits.temporary_mb
        self._unchecked = 0

    def take(self, size: int, folder: Path) -> str:
        """Count bytes that are about to be written; return why they may not be written, empty when they may."""
        if size > self._left:
            return f"need at most {self._limits.temporary_mb} MB of temporary copies (limits.temporary_mb)"
        if self._unchecked < size:
            disk = shutil.disk_usage(folder)
            free = disk.free - min(_RESERVE, disk.total // 10)
            if free < size:
                return f"the disk of {folder.parent} has {disk.free // 1_000_000} MB left; need more"
            self._unchecked = min(max(size, _CHECK_DISK_EVERY), free)
        self._left -= size
        self._unchecked -= size
        return ""


def decompress_file(source: Path, target: Path, limits: LimitsParameters, space: TemporarySpace) -> str:
    """Decompress a zstd file as far as it goes, and as its limits allow; return what was wrong, or empty.

    Raises
    ------
    BagError
        If the source cannot be read, or the target not be made.
    """
    size = 0
    try:
        with source.open("rb") as packed, target.open("wb") as plain:
            blocks = iter(lambda: packed.read(_BLOCK), b"")
            for piece in _zstd_pieces(blocks, _BLOCK):
                reason = ""
                if size + len(piece) > _FREE_ON_DISK + limits.expansion * packed.tell():
                    reason = f"need at most {limits.expansion} times as many bytes (limits.expansion)"
                reason = reason or space.take(len(piece), target.parent)
                if reason:
                    return f"only its first {size / 1e6:.0f} MB are decompressed: {reason}"
                plain.write(piece)
                size += len(piece)
        return ""
    except BagError as error:
        return f"the compressed file is {error}"
    except OSError as error:
        if size:
            return f"only its first {size / 1e6:.0f} MB are decompressed: {error.strerror}"
        raise BagError(f"{source}: cannot decompress to {target.parent}: {error.strerror}") from None


def _unpacked(data: bytes, method: str, size: int, unannounced: int) -> memoryview:
    pieces = _pieces(data, method, size + 1)
    if size < _AT_ONCE:
        first = next(pieces, b"")
        if size and len(first) == size:
            return memoryview(first)
        most = max(size, unannounced)
        return memoryview(b"".join([first, *_bounded(pieces, most - len(first))]))
    return _joined(_bounded(pieces, size), size)


def _joined(pieces: Iterable[bytes], size: int) -> memoryview:
    """Return pieces of at most `size` bytes together as one; memory that no piece fills is not touched."""
    joined = np.empty(size, np.uint8)
    at = 0
    for piece in pieces:
        joined[at : at + len(piece)] = np.frombuffer(piece, np.uint8)
        at += len(piece)
    return memoryview(joined)[:at]


def _bounded(pieces: Iterator[bytes], size: int) -> Iterator[bytes]:
    for piece in pieces:
        size -= len(piece)
        if size < 0:
            raise BagError("more bytes than announced")
        yield piece


def _pieces(data: bytes | memoryview, method: str, most: int) -> Iterator[bytes]:
    """Decompress in pieces; the first is all of it when that is little. BagError when the data are damaged."""
    step = min(max(most, 2**16), _AT_ONCE)
    if method == "zstd":
        try:
            yield from _zstd_pieces(iter([data]), step, len(data))
        except BagError as error:
            raise BagError(f"zstd data are {error}") from None
        return
    if method not in ("lz4", "bz2"):
        raise BagError(f"compression {method!r}; need none, zstd, lz4 or bz2")
    decompressor: Any = lz4.frame.LZ4FrameDecompressor() if method == "lz4" else bz2.BZ2Decompressor()
    feed: bytes | memoryview = data
    try:
        while not decompressor.eof:
            piece = decompressor.decompress(feed, max_length=step)
            feed = b""
            yield piece
            if not piece and decompressor.needs_input:
                return
    except (RuntimeError, OSError, EOFError, ValueError, MemoryError) as error:
        raise BagError(f"{method} data are damaged ({error})") from None


def _zstd_pieces(
    blocks: Iterator[bytes] | Iterator[bytes | memoryview], step: int, first_feed: int = _FIRST_FEED
) -> Iterator[bytes]:
    """Decompress one zstd frame after the other, in pieces of at most `step` bytes."""
    decompressor = None
    feed = first_feed
    try:
        for block in blocks:
            view = memoryview(block)
            at = 0
            while at < len(view):
                if decompressor is None or decompressor.eof:
                    feed = first_feed if decompressor is None else _FIRST_FEED
                    decompressor = zstd.ZstdDecompressor(options=_ZSTD_OPTIONS)
                part = view[at : at + feed]
                at += len(part)
                feed = min(2 * feed, max(_BLOCK, first_feed))
                yield decompressor.decompress(part, step)
                while not (decompressor.eof or decompressor.needs_input):
                    yield decompressor.decompress(b"", step)
                at -= len(decompressor.unused_data) if decompressor.eof else 0
    except (zstd.ZstdError, MemoryError) as error:
        raise BagError(f"damaged ({error})") from None
    if decompressor is None or not decompressor.eof:
        raise BagError("cut short")
