# SPDX-License-Identifier: Apache-2.0
"""Freed blocks go back to the system, whatever sizes were allocated before."""

from __future__ import annotations

import subprocess
import sys

import pytest

_PROGRAM = """
import ctypes, sys
from pathlib import Path
from imgu_ros.process_memory import bound_free_memory, return_free_memory

libc = ctypes.CDLL(None)
libc.malloc.restype, libc.malloc.argtypes = ctypes.c_void_p, [ctypes.c_size_t]
libc.free.argtypes = [ctypes.c_void_p]


def block(size=6_000_000):
    at = libc.malloc(size)
    ctypes.memset(at, 1, size)
    return at


def resident_mb():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6
"""

_LARGE = """
if sys.argv[1] == "set":
    assert bound_free_memory()
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

# Images of usual size come and go, in a thread other than the main one as those of the middleware, among small blocks
# that stay.
_SCATTERED = """
import threading

assert bound_free_memory()


def work():
    before = resident_mb()
    blocks = []
    for _ in range(200):
        blocks.append(block(600_000))
        block(1000)
    for at in blocks:
        libc.free(at)
    if sys.argv[1] == "set":
        assert return_free_memory()
    print(resident_mb() - before)


thread = threading.Thread(target=work)
thread.start()
thread.join()
"""


# A thread frees what lies at the end of its heap: less than the end that `free` keeps.
_AT_THE_END = """
import threading

assert bound_free_memory()


def work():
    blocks = [0] * 100  # a list that grows would lie behind some of the blocks
    for i in range(100):
        blocks[i] = block(600_000)
    for at in blocks:
        libc.free(at)


before = resident_mb()
thread = threading.Thread(target=work)
thread.start()
thread.join()
if sys.argv[1] == "set":
    assert return_free_memory()
print(resident_mb() - before)
"""

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="glibc's")


def _kept_mb(program: str, setting: str) -> float:
    """Return how much of 60 or 120 MB stayed with a process that freed it."""
    command = [sys.executable, "-c", _PROGRAM + program, setting]
    return float(subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout)


def test_large_blocks_are_returned() -> None:
    assert _kept_mb(_LARGE, "set") < 20 < 60 < _kept_mb(_LARGE, "not set")


def test_free_memory_at_the_end_of_a_threads_heap_is_returned() -> None:
    assert _kept_mb(_AT_THE_END, "set") < 10 < 40 < _kept_mb(_AT_THE_END, "not set")


def test_free_memory_among_blocks_in_use_is_returned() -> None:
    assert _kept_mb(_SCATTERED, "set") < 20 < 60 < _kept_mb(_SCATTERED, "not set")
