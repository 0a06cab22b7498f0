# SPDX-License-Identifier: Apache-2.0
"""How this process's memory allocator treats large blocks."""

from __future__ import annotations

import ctypes
import sys

#: Parameters of glibc's mallopt (malloc.h).
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
#: Larger blocks are returned to the system when they are freed. Images of 1080p, grey or raw, are smaller.
LARGE_BYTES = 4_000_000
#: So much free memory at the end of the heap is kept: frames of usual size allocate it again at once.
_KEPT_BYTES = 64_000_000


def return_large_blocks() -> bool:
    """Return freed blocks of more than 4 MB to the system, whatever sizes are allocated; return whether that is set.

    glibc raises its own threshold to the largest block that was ever freed, up to 32 MB. In a process that receives
    images of many sizes the heap then grows by fragmentation: by 100 MB in five minutes with images of 6 MB among
    smaller ones (`benchmarks/soak_hostile.py --large 30`).
    """
    if sys.platform != "linux":
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except AttributeError:  # another C library
        return False
    return bool(mallopt(_MMAP_THRESHOLD, LARGE_BYTES) and mallopt(_TRIM_THRESHOLD, _KEPT_BYTES))
