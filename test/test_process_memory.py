# SPDX-License-Identifier: Apache-2.0
"""Freed blocks go back to the system, whatever sizes were allocated before."""

from __future__ import annotations

import subprocess
import sys

import pytest

_PROGRAM = """
import ctypes, sys
from pathlib import Path
from imgu_ros.process_memory import return_large_blocks

libc = ctypes.CDLL(None)
libc.malloc.restype, libc.malloc.argtypes = ctypes.c_void_p, [ctypes.c_size_t]
libc.free.argtypes = [ctypes.c_void_p]


def block():
    at = libc.malloc(6_000_000)
    ctypes.memset(at, 1, 6_000_000)
    return at


def resident_mb():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6


if sys.argv[1] == "set":
    assert return_large_blocks()
# glibc takes blocks of this size from the heap once one of them was freed.
libc.free(block())
before = resident_mb()
blocks = [block() for _ in range(20)]
# A block behind them keeps the heap from shrinking.
last = libc.malloc(100_000)
for at in blocks:
    libc.free(at)
print(resident_mb() - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="an option of glibc")
def test_large_blocks_are_returned() -> None:
    def kept_mb(setting: str) -> float:
        command = [sys.executable, "-c", _PROGRAM, setting]
        return float(subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout)

    # Of 120 MB.
    assert kept_mb("set") < 20 < 60 < kept_mb("not set")
