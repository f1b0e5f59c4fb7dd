"""Limits of a stranger's processes: of each one by the system, of all together by their keeper."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass

from xmarl_bench.errors import InputError

UNIX = os.name == "posix"


@dataclass(frozen=True)
class Limits:
    """What all processes of one stranger may use together; None: no limit."""

    cpu_seconds: int | None = 3600
    memory_bytes: int | None = 8 * 2**30  # also the address space of each: torch alone takes about 1 GiB
    file_bytes: int | None = 64 * 2**20  # size of a file
    processes: int | None = 64
    answer_seconds: float = 900.0  # wall-clock time to take one question and answer it

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value is None and name != "answer_seconds":
                continue
            if value is None or not 0 < value < math.inf:
                raise InputError(
                    f"{name} must be more than 0 and finite, got {value}: give a positive number."
                )

    def apply(self) -> None:
        """Apply the limits to this process and its children, before it imports third-party code."""
        import resource  # imported lazily: exists on Unix only

        for kind, most in (
            (resource.RLIMIT_CPU, self.cpu_seconds),
            (resource.RLIMIT_AS, self.memory_bytes),
            (resource.RLIMIT_FSIZE, self.file_bytes),
            (resource.RLIMIT_CORE, 0),
        ):
            if most is None:
                continue
            hard = resource.getrlimit(kind)[1]
            least = most if hard == resource.RLIM_INFINITY else min(most, hard)
            resource.setrlimit(kind, (least, least))


# Of one's own runs: an explainer may need what it needs, but not hang.
UNLIMITED = Limits(cpu_seconds=None, memory_bytes=None, file_bytes=None, processes=None)
