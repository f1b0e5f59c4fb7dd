"""Ends worker processes when their program ends, whatever state they are in."""

from __future__ import annotations

import os
from typing import Any

pools: dict[int, Any] = {}  # loky's pool by process id: a fork has none


def end_workers() -> None:
    """Kill this process's workers on this machine. A program calls this before it ends.

    A worker that is killed while it takes a unit keeps the lock of the queue. When the program ends, loky no
    longer looks for dead workers, and the others would wait forever for that lock.
    """
    pool = pools.pop(os.getpid(), None)
    if pool is not None:
        pool.shutdown(wait=True, kill_workers=True)
