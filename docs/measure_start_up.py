"""Prints the CPU seconds of commands that need no network: the least of fresh processes, in turns.

python docs/measure_start_up.py
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

REPEATS = 5
ENTRIES = sorted(
    (Path(__file__).parents[1] / "leaderboard/entries").glob("navigation-n3-residual-lambda0-seed0.*")
)
COMMANDS = {
    "--help": ["--help"],
    "list tasks": ["list", "tasks"],
    "list policies": ["list", "policies"],
    "list explainers": ["list", "explainers"],
    "validate ENTRY": ["validate", str(ENTRIES[0])],
    "compare ENTRY ENTRY": ["compare", str(ENTRIES[0]), str(ENTRIES[-1])],
    "status": ["status"],
    "score --policy UNKNOWN": ["score", "--policy", "nobody"],
    "score --explainer UNKNOWN": ["score", "--explainer", "nobody"],
}


def cpu_seconds(arguments: list[str]) -> float:
    before = os.times()
    subprocess.run(
        [sys.executable, "-m", "xmarl_bench.cli.main", *arguments], capture_output=True, check=False
    )
    after = os.times()
    return (after.children_user - before.children_user) + (after.children_system - before.children_system)


def main() -> None:
    seconds: dict[str, list[float]] = {name: [] for name in COMMANDS}
    for _ in range(REPEATS):
        for name, arguments in COMMANDS.items():
            seconds[name].append(cpu_seconds(arguments))
    for name, each in seconds.items():
        print(f"| `{name}` | {min(each):.2f} |")


if __name__ == "__main__":
    main()
