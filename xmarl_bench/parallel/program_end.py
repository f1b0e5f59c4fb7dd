"""Workers end with their program, whatever state they are in."""

from __future__ import annotations

import os
from typing import Any

pools: dict[int, Any] = {}  # loky's, by the process that uses it: a fork has none


def end_workers() -> None:
    """Kill this process's workers on this machine: for a program to call before it ends.

    A worker that is killed while it takes a unit keeps the lock of the queue. At the end of a program loky no
    longer looks for the dead, and the others would wait for that lock for ever.
    """
    pool = pools.pop(os.getpid(), None)
    if pool is not None:
        pool.shutdown(wait=True, kill_workers=True)
