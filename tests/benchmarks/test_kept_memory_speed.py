"""An update of the trainer, with freed memory kept for the next one, and given back as glibc does by default.

`xmarl-train` keeps it (training/allocator.py). An epoch of the recipe of discovery with four agents, family
`paper`, in CPU time.
"""

from __future__ import annotations

import subprocess
import sys
import time

import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from xmarl_baselines.training.allocator import keep_freed_memory
from xmarl_baselines.training.recipes import recipe_for
from xmarl_baselines.training.trainer import Run, build

from tests.benchmarks.conftest import Report
from tests.benchmarks.side_by_side import clocked, record
from xmarl_bench.reproducible import one_thread

ROUNDS = 7


def update_seconds(keep: bool) -> float:
    """CPU seconds of the second of two updates."""
    if keep:
        assert keep_freed_memory(), "the setting is glibc's"
    recipe = recipe_for("blind_discovery_v0", 4, family="paper", n_epochs=1)
    with one_thread():
        model = build(Run(recipe, 4), seed=0)
        model.learn(recipe.n_envs * recipe.n_steps)
        return clocked(model.train)()


@pytest.mark.benchmark(timer=time.process_time)
def test_update_with_kept_memory(benchmark: BenchmarkFixture, report: Report) -> None:
    """In turns, each in a process of its own: the setting cannot be taken back."""
    seconds: dict[bool, list[float]] = {True: [], False: []}

    def one_each() -> None:
        for keep, spent in seconds.items():
            code = f"from {__name__} import update_seconds; print(update_seconds({keep}))"
            told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
            spent.append(float(told.stdout.split()[-1]))

    benchmark.pedantic(one_each, rounds=ROUNDS)  # type: ignore[no-untyped-call]
    if benchmark.stats is not None:
        record(
            benchmark, report, "MAPPO update of discovery, family paper", "the same, memory given back",
            ours=seconds[True], theirs=seconds[False], unit="s",
        )  # fmt: skip
