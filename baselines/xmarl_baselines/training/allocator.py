"""Memory that an update frees is kept for the next one, instead of going back to the system.

The activations of a minibatch take some megabytes, which glibc's malloc by default gives back after each
update and asks for again, page by page. tests/benchmarks/test_kept_memory_speed.py measures the difference.
"""

from __future__ import annotations

import ctypes
import platform

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # of glibc's malloc.h, see mallopt(3)
LARGEST_BLOCK = 32 << 20  # bytes; glibc takes no larger threshold
KEPT = 1 << 30  # bytes that may stay unused before they are given back


def keep_freed_memory() -> bool:
    """Tell malloc so, for the whole process; returns False where the C library is not glibc."""
    if platform.libc_ver()[0] != "glibc":
        return False
    mallopt = ctypes.CDLL(None).mallopt
    return bool(mallopt(M_MMAP_THRESHOLD, LARGEST_BLOCK)) and bool(mallopt(M_TRIM_THRESHOLD, KEPT))
