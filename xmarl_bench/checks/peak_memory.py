"""How much memory a call needs at its peak, as the system tells it."""

from __future__ import annotations

import gc
import re
from collections.abc import Callable
from pathlib import Path

STATUS, CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")
FORGET_PEAK = "5"  # proc(5): resets the peak to what is resident now


def peak_memory(call: Callable[[], object]) -> float | None:
    """Megabytes resident at the peak of the call, over those before it; None where Linux does not tell.

    Memory that an earlier call freed and the allocator kept is used again without growing: a lower bound.
    """
    gc.collect()
    try:
        CLEAR.write_text(FORGET_PEAK)
        before = _kilobytes("VmRSS")
        call()
        return max(0.0, (_kilobytes("VmHWM") - before) / 1024)
    except OSError:
        return None


def _kilobytes(name: str) -> int:
    found = re.search(rf"^{name}:\s+(\d+) kB", STATUS.read_text(), re.MULTILINE)
    if found is None:
        raise OSError(f"no {name} in {STATUS}")
    return int(found.group(1))
