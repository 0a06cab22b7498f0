# SPDX-License-Identifier: Apache-2.0
"""What every mutator draws from: numbers and texts that break readers, and mutations that know no structure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal, TypeVar

import numpy as np

T = TypeVar("T")
Rng = np.random.Generator
#: A case: the files that are written side by side, by name; the first is what is opened (`FOLDER`: their folder).
Case = dict[str, bytes]
FOLDER = ""

_ORDERS: tuple[Literal["little", "big"], ...] = ("little", "big")
_POWERS = (7, 8, 15, 16, 24, 27, 28, 30, 31, 32, 33, 40, 62, 63, 64)
_NUMBERS: tuple[int, ...] = (
    0,
    1,
    2,
    3,
    10,
    10**8,
    10**9,
    0x20202020,
    *((1 << p) + d for p in _POWERS for d in (-1, 0, 1)),
)
_TEXTS = (
    b"", b"/", b"/a/b", b"\x1b[2J\x1b]0;x\x07", b"=1+1", b"@SUM(1)", b"\xff\xfe\x80", b"\xe2\x80\xae", b"a\0b", b"\r\n",
    b"../../x", b"x" * 300, b"x" * 70_000, "ä€𝄞".encode(), b"\xed\xa0\x80", b"sensor_msgs/msg/Image",
    b"std_msgs/String", b"cdr", b"ros1", b"json", b"zstd", b"lz4", b"bz2", b"none", b"mcap", b"sqlite3", b"NaN",
    b"1e400", b"%s%n", b"mono8", b"mono16", b"bayer_rggb8", b"32FC4", b"8UC64", b"plumb_bob", b"jpeg", b"png",
)  # fmt: skip


def choice(rng: Rng, values: Sequence[T]) -> T:
    """Return one of `values`."""
    return values[int(rng.integers(len(values)))]


def chance(rng: Rng, share: float) -> bool:
    """Return True with the probability `share`."""
    return float(rng.random()) < share


def number(rng: Rng, value: int, bits: int) -> int:
    """Return an unsigned number of `bits` bits in the place of `value`: next to it, or one that readers trip over."""
    if chance(rng, 0.4):
        value += choice(rng, (-16, -8, -4, -2, -1, 1, 2, 4, 8, 16, 100, 4096))
    elif chance(rng, 0.2):
        value ^= 1 << int(rng.integers(bits))
    else:
        value = choice(rng, _NUMBERS)
    return value % (1 << bits)


def text(rng: Rng, value: bytes) -> bytes:
    """Return a text in the place of `value`."""
    if value and chance(rng, 0.3):
        return mangled(rng, value)
    return choice(rng, _TEXTS)


def mangled(rng: Rng, data: bytes) -> bytes:
    """Return `data` with one mutation that knows nothing of its structure."""
    return choice(rng, _MANGLES)(rng, data)


def place(rng: Rng, data: bytes) -> int:
    """Return a place in `data`, its end included: one of its first and last 64 bytes as often as any other."""
    if chance(rng, 0.5):
        return int(rng.integers(len(data) + 1))
    near = int(rng.integers(min(64, len(data)) + 1))
    return near if chance(rng, 0.7) else len(data) - near


def overwritten(data: bytes, at: int, other: bytes) -> bytes:
    """Return `data` with `other` from `at` on, of the same size."""
    return (data[:at] + other + data[at + len(other) :])[: len(data)]


def _flip(rng: Rng, data: bytes) -> bytes:
    at = place(rng, data)
    return overwritten(data, at, bytes([data[at] ^ (1 << int(rng.integers(8)))])) if at < len(data) else data


def _byte(rng: Rng, data: bytes) -> bytes:
    return overwritten(data, place(rng, data), rng.bytes(1))


def _number(rng: Rng, data: bytes) -> bytes:
    size, order = choice(rng, (1, 2, 4, 8)), choice(rng, _ORDERS)
    at = place(rng, data)
    old = int.from_bytes(data[at : at + size], order)
    return overwritten(data, at, number(rng, old, 8 * size).to_bytes(size, order))


def _insert(rng: Rng, data: bytes) -> bytes:
    at = place(rng, data)
    count = choice(rng, (1, 2, 4, 16, 256))
    return data[:at] + (rng.bytes(count) if chance(rng, 0.5) else bytes(count)) + data[at:]


def _delete(rng: Rng, data: bytes) -> bytes:
    at = place(rng, data)
    return data[:at] + data[at + choice(rng, (1, 2, 4, 16, 256)) :]


def _cut(rng: Rng, data: bytes) -> bytes:
    return data[: place(rng, data)]


def _repeat(rng: Rng, data: bytes) -> bytes:
    at, size = place(rng, data), choice(rng, (1, 4, 16, 64, 1024))
    return data[:at] + data[at : at + size] * choice(rng, (2, 3, 10)) + data[at + size :]


def _move(rng: Rng, data: bytes) -> bytes:
    source, target, size = place(rng, data), place(rng, data), choice(rng, (1, 4, 16, 64, 1024))
    return overwritten(data, target, data[source : source + size])


def _fill(rng: Rng, data: bytes) -> bytes:
    return overwritten(data, place(rng, data), choice(rng, (b"\0", b"\xff", b" ")) * choice(rng, (4, 64, 1024)))


_MANGLES: tuple[Callable[[Rng, bytes], bytes], ...] = (
    _flip, _byte, _number, _number, _insert, _delete, _cut, _repeat, _move, _fill,
)  # fmt: skip
