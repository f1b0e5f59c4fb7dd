"""Where, when and with which versions an entry was made. Not part of the entry's id."""

from __future__ import annotations

import platform
import shlex
import subprocess
import sys
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

from xmarl_bench.entry.schema import Provenance
from xmarl_bench.origin.installed import harness_version, package_version
from xmarl_bench.records.field_types import MOST_TEXT

PACKAGES = ("loky", "numpy", "pettingzoo", "pydantic", "pymunk", "safetensors", "torch", "torch-geometric")
# What a sweep and `board build` write: an interrupted sweep goes on with unchanged sources.
DERIVED = (":(top,exclude)leaderboard", ":(top,exclude)docs", ":(top,exclude)README.md")


def now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def provenance(started: str, jobs: int, device: str | None = None) -> Provenance:
    """device: of the explainer, if it is not the CPU."""
    import torch

    commit, dirty = commit_of_harness()
    return Provenance(
        harness_version=harness_version(),
        commit=commit,
        dirty=dirty,
        packages={name: package_version(name) or "missing" for name in PACKAGES},
        python=platform.python_version(),
        os=platform.platform(),
        machine=platform.machine(),
        cpu=_cpu(),
        cpu_capability=torch.backends.cpu.get_cpu_capability(),
        device=device,
        threads=1,
        jobs=jobs,
        command=_command(),
        started=started,
        finished=now(),
    )


def _command() -> str:
    """The command of this process; of one with hundreds of files, what an entry has room for."""
    command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
    return command if len(command) <= MOST_TEXT else f"{command[: MOST_TEXT - 4]} ..."


@cache
def _cpu() -> str:
    """The processor's model name if Linux reports it, else its architecture."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


@cache
def commit_of_harness() -> tuple[str | None, bool | None]:
    """Commit of this source tree, and whether sources have changed; (None, None) for an installed package."""
    return commit_of(Path(__file__).resolve())


def commit_of(here: Path) -> tuple[str | None, bool | None]:
    """The commit that a source file belongs to, and whether sources of its repository have changed."""
    # An installed copy may lie inside another git repository without being part of it.
    if _git(here.parent, "ls-files", "--error-unmatch", here.name) is None:
        return None, None
    changes = _git(here.parent, "status", "--porcelain", "--untracked-files=no", "--", ":/", *DERIVED)
    return _git(here.parent, "rev-parse", "HEAD"), None if changes is None else bool(changes)


def _git(folder: Path, *arguments: str) -> str | None:
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *arguments], capture_output=True, encoding="utf-8", timeout=20
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 else None
