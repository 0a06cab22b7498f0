# SPDX-License-Identifier: Apache-2.0
"""How this process's memory allocator treats freed memory."""

from __future__ import annotations

import ctypes
import sys
from functools import cache

#: Parameters of glibc's mallopt (malloc.h).
_TRIM_THRESHOLD, _MMAP_THRESHOLD, _ARENA_MAX = -1, -3, -8
#: Larger blocks are returned to the system when they are freed. Images of 1080p, grey or raw, are smaller.
LARGE_BYTES = 4_000_000
#: So much free memory at the end of the heap is kept by `free` itself: frames of usual size allocate it again at once.
_KEPT_BYTES = 64_000_000


def bound_free_memory() -> bool:
    """Make the allocator keep little of what is freed, whatever sizes are allocated; return whether that is set.

    Blocks of more than 4 MB are returned to the system as soon as they are freed. glibc raises its own threshold to the
    largest block that was ever freed, up to 32 MB. In a process that receives images of many sizes the heap then grows
    by fragmentation: by 100 MB in five minutes with images of 6 MB among smaller ones (`benchmarks/soak_hostile.py
    --large 30`).

    All threads share one heap; to be called before there are many of them. By default nearly every thread has one of
    its own, and `return_free_memory` cannot return the free memory at the end of those.
    """
    libc = _glibc()
    if libc is None:
        return False
    settings = ((_MMAP_THRESHOLD, LARGE_BYTES), (_TRIM_THRESHOLD, _KEPT_BYTES), (_ARENA_MAX, 1))
    return all(libc.mallopt(parameter, value) for parameter, value in settings)


def return_free_memory() -> bool:
    """Return the pages of the heap that hold nothing to the system; return whether the allocator can do that.

    Free memory between blocks that are in use stays with the process otherwise, and grows with the variety of sizes:
    from 15 to 47 MB in five minutes of 30 hostile messages a second, while 46 to 60 MB were in use throughout
    (`benchmarks/soak_hostile.py --hostile-rate 30`). It takes a millisecond, in which other threads go on.
    """
    libc = _glibc()
    if libc is None:
        return False
    libc.malloc_trim(0)
    return True


@cache
def _glibc() -> ctypes.CDLL | None:
    """Return the C library if it is glibc."""
    if sys.platform != "linux":
        return None
    libc = ctypes.CDLL(None)
    if not hasattr(libc, "mallopt") or not hasattr(libc, "malloc_trim"):  # another C library
        return None
    libc.malloc_trim.argtypes = [ctypes.c_size_t]
    return libc
