"""Fan-out: the overhead of a piece, the gain from 2 workers, and the memory of parent and workers.

Memory and overhead hold on a busy machine too; the gain from 2 workers needs 2 idle cores.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import cloudpickle
import psutil
import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from xmarl_baselines.explainers.attention import attention
from xmarl_envs import TASKS, make_task

from tests.baselines.reference import shipped_name
from tests.benchmarks.conftest import Report
from tests.helpers.units_of_work import memory, twenty_kilobytes
from xmarl_bench.parallel.fan_out import fan_out
from xmarl_bench.parallel.workers import Workers
from xmarl_bench.plugins.names import find_policies
from xmarl_bench.plugins.registry import find_explainer
from xmarl_bench.policy import load_policy
from xmarl_bench.rollout.cell import Cell, Sampling
from xmarl_bench.rollout.episodes import roll_out
from xmarl_bench.scoring.cache import Cache
from xmarl_bench.scoring.measure import Unit
from xmarl_bench.scoring.piece_keys import piece_key
from xmarl_bench.scoring.request import Request
from xmarl_bench.scoring.score import Failed, score_requests

TITLE = "fan-out"
PIECES, OVERHEAD = 5000, 0.020  # seconds per piece
# Growth in bytes of this process from the 1000th piece to the last; the results of these are 80 MB.
GROWTH = 30 * 2**20
GAIN = 1.7
POLICY = shipped_name("blind_passage_v0")
POLICIES = tuple(shipped_name(task) for task in TASKS)


def test_soak(benchmark: BenchmarkFixture, report: Report, tmp_path: Path) -> None:
    """5,000 pieces without work, each result written into the cache."""
    cache = Cache(tmp_path)
    cache.prepare()
    sizes: dict[int, int] = {}

    def soak() -> None:
        for done, (k, result) in enumerate(
            fan_out(twenty_kilobytes, _numbers(), workers=Workers(2)), start=1
        ):
            assert isinstance(result, bytes)
            cache.write(piece_key(k), result)
            if done in (1000, PIECES):
                sizes[done] = psutil.Process().memory_info().rss

    benchmark.pedantic(soak, rounds=1)  # type: ignore[no-untyped-call]
    if benchmark.stats is None:  # --benchmark-disable
        return
    overhead = benchmark.stats.stats.mean / PIECES
    grown = sizes[PIECES] - sizes[1000]
    report(
        TITLE,
        f"{PIECES} pieces: {1000 * overhead:.1f} ms each < {1000 * OVERHEAD:.0f}; parent {_mb(sizes[1000])} "
        f"after 1000, {_mb(sizes[PIECES])} after all",
    )
    assert sum(1 for _ in tmp_path.glob("*/??/*")) == PIECES
    assert overhead < OVERHEAD
    assert grown < GROWTH


def _numbers() -> Iterator[int]:
    yield from range(PIECES)


def test_two_workers_over_one(benchmark: BenchmarkFixture, report: Report, tmp_path: Path) -> None:
    """Scores four policies of `make score` without a cache, with one and two workers in turns."""
    if (os.cpu_count() or 1) < 2:
        pytest.skip("needs two cores")
    policies = [load_policy(find_policies()[name]) for name in POLICIES]
    requests = [
        Request(
            policy,
            card,
            find_explainer(name),
            (Cell(card.task, card.n_agents),),
            Sampling(),
            None if name == "attention" else 0,
        )
        for policy, card in policies
        for name in ("attention", "gnn_explainer", "graphmask")
    ]

    def score(jobs: int, folder: str, some: Sequence[Request] = requests) -> float:
        started = time.perf_counter()
        cache = Cache(tmp_path / folder)
        outcomes = list(score_requests(some, workers=Workers(jobs), cache=cache))
        assert not any(isinstance(each, Failed) for each in outcomes)
        return time.perf_counter() - started

    warm = [replace(requests[0], sampling=Sampling(episodes=20, timesteps=1))]
    score(2, "warm", warm)  # workers have imported torch
    one: list[float] = []
    two: list[float] = []

    def both() -> None:
        one.append(score(1, f"one{len(one)}"))
        two.append(score(2, f"two{len(two)}"))

    benchmark.pedantic(both, rounds=1)  # type: ignore[no-untyped-call]
    if benchmark.stats is None:
        return
    gain = sorted(a / b for a, b in zip(one, two, strict=True))[len(one) // 2]
    report(TITLE, f"2 workers over 1: {gain:.2f} times >= {GAIN} ({min(one):.1f} s and {min(two):.1f} s)")
    assert gain >= GAIN


def test_memory_and_size_of_a_unit(benchmark: BenchmarkFixture, report: Report) -> None:
    """Memory of a worker that scores the largest team's policy, and the cost of sending it episodes."""
    policy, card = load_policy(find_policies()[POLICY])
    seeds = list(range(10**12, 10**12 + 10))
    episodes = roll_out(make_task(card.task, card.n_agents), policy, seeds)
    units = tuple(Unit(policy, (attention,), each, 0, None, sanity=True) for each in episodes)
    data = benchmark(cloudpickle.dumps, units)
    seconds = "" if benchmark.stats is None else f" in {1000 * benchmark.stats.stats.mean:.1f} ms"
    report(TITLE, f"a policy with 10 episodes is pickled into {len(data) / 1e6:.2f} MB{seconds}")
    held = [size for _, size in fan_out(memory, [units] * 4, workers=Workers(2)) if isinstance(size, int)]
    assert len(held) == 4
    report(TITLE, f"memory of a worker that scored 10 episodes of {POLICY}: {_mb(max(held))}")
    assert max(held) < 2**30


def _mb(n_bytes: int) -> str:
    return f"{n_bytes / 2**20:.0f} MB"
