"""Walls around a stranger's process: what it can see and reach of the machine.

docs/security.md tells what each wall holds and what it does not.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Literal

from xmarl_bench.isolation import landlock

Wall = Literal["bubblewrap", "landlock", "process"]
SIGNED: tuple[Wall, ...] = ("bubblewrap", "landlock")  # a verdict on third-party code needs one of them
HIDDEN = ("/tmp", "/var/tmp", "/home", "/root", "/run", "/media", "/mnt", "/srv")
PRIVATE_BYTES = 2**28  # of a private temporary folder in memory
STRANGER = "XMARL_BENCH_STRANGER"  # the environment variable of processes of third-party code


@cache
def strongest() -> Wall:
    """The strongest wall that works here: a container often forbids what is installed in it."""
    if shutil.which("bwrap") is not None:
        try:
            command = in_bubblewrap(["true"], ())
            if subprocess.run(command, capture_output=True, timeout=20).returncode == 0:
                return "bubblewrap"
        except (OSError, subprocess.TimeoutExpired):
            pass
    return "landlock" if landlock.available() else "process"


def in_bubblewrap(command: Sequence[str], readable: Sequence[Path]) -> list[str]:
    """The command behind bubblewrap. readable: paths in hidden folders that it needs."""
    size = ("--size", str(PRIVATE_BYTES))
    hidden = [part for folder in HIDDEN if Path(folder).is_dir() for part in (*size, "--tmpfs", folder)]
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


def python_folders() -> list[Path]:
    """The folders of this interpreter and of the modules that it can import."""
    found = [Path(sys.prefix), Path(sys.base_prefix), Path(sys.executable).parent]
    return found + [Path(entry) for entry in search_path() if Path(entry).exists()]


def search_path() -> list[str]:
    """The folders that modules are imported from, absolute."""
    return [str(Path(entry).absolute()) for entry in sys.path if entry]


def environment(wall: Wall) -> dict[str, str]:
    """Environment variables: all of them without a wall, else what Python needs to find its packages.

    The others may hold tokens.
    """
    kept = dict(os.environ)
    if wall != "process":
        kept = {name: os.environ[name] for name in ("PATH", "LANG") if name in os.environ} | {"HOME": "/tmp"}
    return {
        **kept,
        "PYTHONPATH": os.pathsep.join(search_path()),
        "OMP_NUM_THREADS": "1",
        "PYTHONDONTWRITEBYTECODE": "1",
        STRANGER: "1",
    }
