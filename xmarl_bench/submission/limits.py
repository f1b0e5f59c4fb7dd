"""Isolation of third-party code, as strong as this system allows.

| | network | files | memory, CPU time, file size | leftover processes |
|---|---|---|---|---|
| bubblewrap | none | read-only; homes, /tmp, /run hidden | limited | ended with it |
| unshare | none | the user's, also writable | limited | ended with its session |
| rlimits | open | the user's, also writable | limited | ended with its session |

Windows has none of them, so third-party code does not run there.
None of these stops a program from reading files that everyone can read, from exploiting the kernel or,
without bubblewrap, from escaping its session. Read third-party code before you run it.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

from xmarl_bench.errors import InputError

Wall = Literal["bubblewrap", "unshare", "rlimits"]
UNIX = os.name == "posix"
HIDDEN = ("/tmp", "/var/tmp", "/home", "/root", "/run", "/media", "/mnt", "/srv")


@dataclass(frozen=True)
class Limits:
    """Limits of the process of one explainer."""

    cpu_seconds: int = 3600
    memory_bytes: int = 8 * 2**30  # of address space: torch alone takes about 1 GiB
    file_bytes: int = 64 * 2**20
    answer_seconds: float = 900.0  # wall-clock time for one episode

    def __post_init__(self) -> None:
        for name in ("cpu_seconds", "memory_bytes", "file_bytes", "answer_seconds"):
            if getattr(self, name) <= 0:
                raise InputError(
                    f"{name} must be more than 0, got {getattr(self, name)}: give a positive number."
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
            hard = resource.getrlimit(kind)[1]
            least = most if hard == resource.RLIM_INFINITY else min(most, hard)
            resource.setrlimit(kind, (least, least))


@cache
def strongest() -> Wall:
    """The strongest isolation that works here: a container often forbids what is installed in it."""
    walls: tuple[Wall, ...] = ("bubblewrap", "unshare")
    for wall in walls:
        command = walled(wall, ["true"], ())
        if shutil.which(command[0]) is None:
            continue
        try:
            if subprocess.run(command, capture_output=True, timeout=20).returncode == 0:
                return wall
        except (OSError, subprocess.TimeoutExpired):
            continue
    return "rlimits"


def walled(wall: Wall, command: Sequence[str], readable: Sequence[Path]) -> list[str]:
    """The isolated command. readable: paths in hidden folders that it needs."""
    if wall == "bubblewrap":
        hidden = [option for folder in HIDDEN if Path(folder).is_dir() for option in ("--tmpfs", folder)]
        # Paths in hidden folders are bound again, outer folders first.
        shown = [
            option
            for path in sorted({each.resolve() for each in readable}, key=lambda path: len(path.parts))
            if path.exists()
            for option in ("--ro-bind", str(path), str(path))
        ]
        return [
            "bwrap", "--unshare-all", "--die-with-parent", "--new-session", "--cap-drop", "ALL",
            "--ro-bind", "/", "/", *hidden, "--dev", "/dev", "--proc", "/proc", *shown,
            "--chdir", "/", "--", *command,
        ]  # fmt: skip
    if wall == "unshare":
        return ["unshare", "--user", "--map-current-user", "--net", "--", *command]
    return list(command)


def python_folders() -> list[Path]:
    """The folders of this interpreter and of the modules that it can import."""
    found = [Path(sys.prefix), Path(sys.base_prefix), Path(sys.executable).parent]
    return found + [Path(entry).absolute() for entry in sys.path if entry and Path(entry).exists()]


def environment() -> dict[str, str]:
    """The variables that Python needs to find its packages. Drops all others, which may hold tokens."""
    kept = {name: os.environ[name] for name in ("PATH", "PYTHONPATH", "LANG") if name in os.environ}
    return {**kept, "HOME": "/tmp", "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
