"""Runs a training in a new process. The worker only waits for it, so this file does not import torch."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def train_in_own_process(unit: tuple[str, Path]) -> int:
    """Run `xmarl-train --reproduce NAME --out OUT --resume`; returns its exit code."""
    name, out = unit
    program = [sys.executable, "-m", "xmarl_baselines.training.command"]
    with (out / f"{name}.log").open("ab") as log:
        return subprocess.run(
            [*program, "--reproduce", name, "--out", str(out), "--resume"],
            stdout=log,
            stderr=subprocess.STDOUT,
        ).returncode
