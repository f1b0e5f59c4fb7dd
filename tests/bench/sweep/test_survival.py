"""A sweep that is killed at any moment and run again writes what an undisturbed one writes, byte for byte.

XMARL_BENCH_KILLS=50 python -m pytest tests/bench/sweep/test_survival.py kills it at so many moments.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.conftest import MakeBundle
from xmarl_bench.entry_file import read_entries

KILLS = int(os.environ.get("XMARL_BENCH_KILLS", "4"))
Run = Callable[..., dict[str, Any]]
Inodes = Mapping[Path, int]

pytestmark = pytest.mark.slow


@pytest.fixture
def run() -> Iterator[Run]:
    """run(arguments, kill_after, victim) -> exit code, seconds, whether it was killed."""
    zygote = subprocess.Popen(
        [sys.executable, "-m", "tests.bench.sweep.zygote"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    assert zygote.stdin is not None
    assert zygote.stdout is not None

    def ask(arguments: list[str], kill_after: float | None = None, victim: str = "main") -> dict[str, Any]:
        assert zygote.stdin is not None
        assert zygote.stdout is not None
        request = {"arguments": arguments, "kill_after": kill_after, "victim": victim}
        print(json.dumps(request), file=zygote.stdin, flush=True)
        answer: dict[str, Any] = json.loads(zygote.stdout.readline())
        return answer

    yield ask
    zygote.stdin.close()
    zygote.wait(60)
    zygote.stdout.close()


def results(cells: Path) -> Inodes:
    """Every result on disk; one that is written again is another file."""
    return {path: path.stat().st_ino for path in cells.glob("??/*") if not path.name.startswith(".")}


def hidden(folder: Path) -> set[str]:
    return {path.name for path in folder.rglob(".*")}


@pytest.mark.parametrize(
    ("victim", "jobs", "kills"),
    [("main", 1, KILLS - KILLS // 5), ("main", 2, KILLS // 5), ("worker", 2, max(1, KILLS // 5))],
)
def test_killed_at_any_moment(
    victim: str, jobs: int, kills: int, run: Run, make_bundle: MakeBundle, tmp_path: Path
) -> None:
    if not kills:
        pytest.skip("asked for so few kills that this has none")
    policies = [make_bundle("blind_discovery_v0", name=name, seed=k) for k, name in enumerate(("one", "two"))]
    chosen = [argument for folder in policies for argument in ("--policy", str(folder))]
    chosen += ["--explainer", "attention", "--explainer", "random"]
    size = ["--episodes", "12", "--max-cycles", "12", "--jobs", str(jobs)]

    def command(name: str) -> list[str]:
        folders = ["--out", str(tmp_path / name), "--cells", str(tmp_path / f"{name}-cells")]
        return ["score", *chosen, *size, *folders]

    whole = run(command("whole"))
    assert whole["code"] == 0
    expected = (tmp_path / "whole" / "leaderboard.json").read_bytes()
    ids = [entry.entry_id for _, entry in read_entries(tmp_path / "whole" / "entries")]
    assert len(ids) == 4

    out, cells = tmp_path / "out", tmp_path / "out-cells"
    rng, struck, finished = np.random.default_rng(0), 0, 0
    while struck < kills or not finished:
        before = results(cells)
        moment = float(rng.uniform(0.0, whole["seconds"])) if struck < kills else None
        done = run(command("out"), moment, victim)
        struck += done["killed"]
        after = results(cells)
        assert {path: after.get(path) for path in before} == before  # nothing finished is computed again
        if done["code"] != 0:
            assert done["killed"]
            assert victim == "main"  # a run gets over the death of a worker
            continue
        finished += 1
        assert (out / "leaderboard.json").read_bytes() == expected
        assert [entry.entry_id for _, entry in read_entries(out / "entries")] == ids
        assert hidden(out) == set()
        assert hidden(cells) == {".gitignore"}
        shutil.rmtree(out)
        shutil.rmtree(cells)
    assert struck == kills
