"""Runs `jaxmarl_peer.py` in a Python of its own, because JAX is no dependency of this project."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from types import TracebackType

import pytest

PYTHON = "XMARL_BENCH_JAXMARL"
ONE_THREAD = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"


class JaxMarl:
    """Rollouts of JaxMARL in a process that waits between them. Skips the test without such a Python.

    compiled: CPU seconds of compiling and the first run.
    """

    def __init__(self, n_episodes: int, way: str, cycles: int, held: int) -> None:
        python = os.environ.get(PYTHON)
        if python is None:
            pytest.skip(f"set {PYTHON} to a Python with jaxmarl, e.g. of a venv with `pip install jaxmarl`")
        peer = Path(__file__).with_name("jaxmarl_peer.py")
        self._process = subprocess.Popen(
            [python, str(peer), str(n_episodes), way, str(cycles), str(held)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "XLA_FLAGS": ONE_THREAD, "JAX_PLATFORMS": "cpu", "PYTHONPATH": ""},
        )
        self.compiled = self._answer()

    def seconds(self) -> float:
        """CPU seconds of one more rollout."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return self._answer()

    def __enter__(self) -> JaxMarl:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.communicate()

    def _answer(self) -> float:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.startswith("seconds "):
                return float(line.split()[1])
        raise AssertionError(f"{PYTHON}: its process ended with code {self._process.wait()}, see above")
