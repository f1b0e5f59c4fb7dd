"""Peak memory of a call, as Linux reports it."""

from __future__ import annotations

import gc
import re
from collections.abc import Callable
from pathlib import Path

STATUS, CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")
RESET_PEAK = b"5"  # proc(5): sets the peak to the current resident memory


def peak_memory(call: Callable[[], object]) -> float | None:
    """Resident megabytes at the peak of the call, less those before it; None if Linux does not report them.

    A lower bound: the allocator reuses memory that earlier calls freed.
    """
    gc.collect()
    try:
        CLEAR.write_bytes(RESET_PEAK)
        before = _kilobytes("VmRSS")
        call()
        return max(0.0, (_kilobytes("VmHWM") - before) / 1024)
    except OSError:
        return None


def _kilobytes(name: str) -> int:
    found = re.search(rf"^{name}:\s+(\d+) kB", STATUS.read_text(encoding="utf-8"), re.MULTILINE)
    if found is None:
        raise OSError(f"no {name} in {STATUS}")
    return int(found.group(1))
