"""Start-up: commands that need no network, in fresh processes.

CPU seconds of the process. What needs no network and no physics loads neither torch nor pymunk: `list
explainers` reads what explainers declare from their source, and policies are chosen by their cards. Half of
what is left is typer, pydantic's schemas and numpy; `compare` and `board` add Student's t of scipy.

What needs a network imports torch (1.6 s) and torch_geometric, which imports `torch._dynamo` (2.5 s more),
without Python's garbage collector: `python -c 'import gc; gc.disable(); import xmarl_bench.scoring.score'`
takes 4.1 s, and without its first half 4.9 s.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from tests.benchmarks.conftest import Report

ENTRIES = sorted(
    (Path(__file__).parents[2] / "leaderboard/entries").glob("navigation-n3-residual-lambda0-seed0.*")
)
COMMANDS = {
    "--help": ["--help"],
    "list tasks": ["list", "tasks"],
    "list policies": ["list", "policies"],
    "list explainers": ["list", "explainers"],
    "validate ENTRY": ["validate", str(ENTRIES[0])],
    "compare ENTRY ENTRY": ["compare", str(ENTRIES[0]), str(ENTRIES[-1])],
    "status --cache UNKNOWN": ["status", "--cache", "nowhere"],
    "score --policy UNKNOWN": ["score", "--policy", "nobody"],
    "score --explainer UNKNOWN": ["score", "--explainer", "nobody"],
}


def cpu_of_children() -> float:
    """CPU seconds of child processes that have ended."""
    times = os.times()
    return times.children_user + times.children_system


@pytest.mark.benchmark(timer=cpu_of_children)
@pytest.mark.parametrize("command", COMMANDS)
def test_command(benchmark: BenchmarkFixture, report: Report, command: str) -> None:
    program = [sys.executable, "-m", "xmarl_bench.cli.main", *COMMANDS[command]]
    codes = set[int]()

    def run() -> None:
        codes.add(subprocess.run(program, capture_output=True).returncode)

    benchmark.pedantic(run, rounds=5)  # type: ignore[no-untyped-call]
    assert codes == ({2} if "UNKNOWN" in command else {0})
    if benchmark.stats is not None:
        report("start-up, least CPU seconds", f"{command:<30}{benchmark.stats.stats.min:>6.2f}")
