"""A sweep that is killed at any moment and run again writes the same bytes as an undisturbed one, less times.

It is killed right before an access to one of its files. XMARL_BENCH_KILLS=50 python -m pytest
tests/bench/scoring/test_survival.py kills it at 50 of them.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from xmarl_envs import TASKS

from tests.helpers.forks import Ask, forks
from tests.helpers.measured_times import board_without_times
from tests.helpers.policies import small_policy
from tests.helpers.zygote import Request
from xmarl_bench.entry.file import read_entries
from xmarl_bench.policy import save_policy

KILLS = int(os.environ.get("XMARL_BENCH_KILLS", "3"))
TASK = "blind_discovery_v0"
Inodes = Mapping[Path, int]

pytestmark = pytest.mark.slow


def results(cache: Path) -> Inodes:
    """Every piece on disk with its inode, which changes if the piece is written again."""
    return {path: path.stat().st_ino for path in cache.glob("*/??/*") if not path.name.startswith(".")}


def hidden(folder: Path) -> set[str]:
    return {path.name for path in folder.rglob(".*")}


@dataclass(frozen=True)
class Sweep:
    """One command line, and its output when undisturbed in one process."""

    ask: Ask
    arguments: tuple[str, ...]
    board: bytes
    entry_ids: list[str]
    touches: int  # accesses to its files

    @staticmethod
    def request(arguments: tuple[str, ...], folder: Path, jobs: int) -> Request:
        options = ("--out", str(folder / "out"), "--cache", str(folder / "cache"), "--jobs", str(jobs))
        return {"command": ["xmarl-bench", "score", *arguments, *options], "touched": str(folder)}


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sweep]:
    folder = tmp_path_factory.mktemp("undisturbed")
    arguments = [
        "--explainer",
        "attention",
        "--explainer",
        "random",
        "--episodes",
        "12",
        "--max-cycles",
        "12",
    ]
    for seed, name in enumerate(("one", "two")):
        policy = small_policy(len(TASKS[TASK].observation_names), seed)
        save_policy(folder / name, policy, name=name, task=TASK, n_agents=3, attention_entropy=0.5)
        arguments += ["--policy", str(folder / name)]
    folder /= "run"
    out = folder / "out"
    with forks() as ask:
        whole = ask(Sweep.request(tuple(arguments), folder, jobs=1))
        assert whole["code"] == 0, whole["err"]
        ids = [entry.entry_id for _, entry in read_entries(out / "entries")]
        assert len(ids) == 4
        board = board_without_times(out)
        assert whole["touches"] > 100
        yield Sweep(ask, tuple(arguments), board, ids, whole["touches"])


@pytest.mark.parametrize(
    ("victim", "jobs", "kills"),
    [("main", 1, KILLS), ("main", 2, -(-KILLS // 4)), ("worker", 2, -(-KILLS // 4))],
)
def test_a_sweep_killed_at_any_moment_and_rerun_writes_the_same_bytes(
    victim: str, jobs: int, kills: int, sweep: Sweep, tmp_path: Path
) -> None:
    out, cache = tmp_path / "out", tmp_path / "cache"
    rng, struck, finished = np.random.default_rng(0), 0, 0
    while struck < kills or not finished:
        before = results(cache)
        if struck == kills:
            jobs = 1  # saves the start of workers; the leftovers are from two
        request = Sweep.request(sweep.arguments, tmp_path, jobs)
        if struck < kills:
            request["victim"] = victim
            request["kill_at"] = int(rng.integers(sweep.touches))
        done = sweep.ask(request)
        struck += done["killed"]
        after = results(cache)
        assert {path: after.get(path) for path in before} == before  # finished pieces are not recomputed
        if done["code"] != 0:
            assert done["killed"], done["err"]
            assert victim == "main"  # a run survives the death of a worker
            continue
        finished += 1
        assert board_without_times(out) == sweep.board
        assert [entry.entry_id for _, entry in read_entries(out / "entries")] == sweep.entry_ids
        assert hidden(out) == set()
        assert hidden(cache) == {".gitignore"}
        shutil.rmtree(out)
        shutil.rmtree(cache)
    assert struck == kills
