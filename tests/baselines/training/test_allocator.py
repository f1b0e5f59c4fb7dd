"""Memory that an update frees is kept for the next one."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

# Eight blocks of 4 MiB, twice: 8192 pages of 4 KiB, which glibc by default gives back in between.
CODE = """
import resource
from xmarl_baselines.training.allocator import keep_freed_memory
assert keep_freed_memory()
def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    [b"x" * (4 << 20) for _ in range(8)]
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
faults()
print(faults())
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the setting is glibc's")
def test_pages_are_asked_for_once() -> None:
    told = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True)
    assert int(told.stdout) < 1000
