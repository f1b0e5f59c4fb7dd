"""The parts of a step's time, and its growth with the team size: `make bench`, the tables at its end.

Random actions as in test_speed.py. No peers and no bars.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from xmarl_envs import BlindNavigation, State, VectorEnv, make_task
from xmarl_envs.gymnasium_vector_env import TeamVectorEnv
from xmarl_envs.heuristics import heuristic
from xmarl_envs.parallel import TaskParallelEnv
from xmarl_envs.world import World

from tests.benchmarks.conftest import Report
from tests.benchmarks.side_by_side import Run
from tests.benchmarks.test_speed import CYCLES, HELD, SHARED, our_batch, our_episode

# The parts of a step's time: each is the time in its functions, less the time in functions listed before it.
PARTS: dict[str, tuple[tuple[type[Any], str], ...]] = {
    "physics": ((World, "step"),),
    "reward and ending": ((BlindNavigation, "judge"),),
    "observation": ((BlindNavigation, "observe"),),
    "resets": ((VectorEnv, "reset"),),
    "contacts, checks": ((VectorEnv, "step"),),
    "shell": ((TaskParallelEnv, "step"), (TeamVectorEnv, "step")),
}


class Stopwatch:
    """Times each call of the watched functions, without the time in other watched functions."""

    def __init__(self) -> None:
        self.calls: dict[str, list[float]] = {part: [] for part in PARTS}  # s
        self._inner = [0.0]  # s in watched functions, for each running call

    def watch(self, function: Callable[..., Any], part: str) -> Callable[..., Any]:
        def watched(*args: Any, **kwargs: Any) -> Any:
            self._inner.append(0.0)
            started = time.perf_counter()
            try:
                return function(*args, **kwargs)
            finally:
                seconds = time.perf_counter() - started
                self.calls[part].append(seconds - self._inner.pop())
                self._inner[-1] += seconds

        return watched

    def spent(self, part: str) -> float:
        """Total seconds. Calls of several times the median count as interrupted by another process.

        Not so resets: one may begin a single episode and another all of them.
        """
        calls = np.array(self.calls[part])
        if part != "resets":
            calls = np.minimum(calls, 5 * np.median(calls))
        return float(calls.sum())


@pytest.mark.parametrize(
    ("what", "make"),
    [
        ("ParallelEnv", our_episode),
        ("64 episodes, shared Spaces", lambda: our_batch(64, SHARED)),
        ("64 episodes, a Space each", lambda: our_batch(64, 1)),
        ("1024 episodes, shared Spaces", lambda: our_batch(1024, SHARED)),
    ],
)
def test_shares_of_a_step(
    benchmark: BenchmarkFixture,
    report: Report,
    monkeypatch: pytest.MonkeyPatch,
    what: str,
    make: Callable[[], Run],
) -> None:
    benchmark.group = "shares of a step, navigation with 3 agents"
    run, stopwatch = make(), Stopwatch()
    run()
    with monkeypatch.context() as patch:
        for part, functions in PARTS.items():
            for owner, name in functions:
                patch.setattr(owner, name, stopwatch.watch(getattr(owner, name), part))
        for _ in range(5):
            run()
    benchmark.pedantic(run, rounds=3)  # type: ignore[no-untyped-call]
    spent = {part: stopwatch.spent(part) for part in PARTS}
    assert min(spent.values()) > 0.0
    shares = {part: seconds / sum(spent.values()) for part, seconds in spent.items()}
    benchmark.extra_info |= {part: round(share, 3) for part, share in shares.items()}
    cells = ", ".join(f"{part} {share:.0%}" for part, share in shares.items())
    report("shares of a step, navigation with 3 agents", f"{what:<30}{cells}")


@pytest.mark.benchmark(timer=time.process_time)
@pytest.mark.parametrize("n_episodes", [1, 64])
@pytest.mark.parametrize(
    ("name", "n_agents"),
    [
        *(("blind_navigation_v0", n) for n in (3, 8, 16, 32, 64)),
        *(("blind_passage_v0", n) for n in (3, 5)),
        *(("blind_discovery_v0", n) for n in (3, 8, 16, 32, 64)),
    ],
)
def test_team_size(
    benchmark: BenchmarkFixture, report: Report, name: str, n_agents: int, n_episodes: int
) -> None:
    """One episode in its own Space, and 64 that share Spaces; ended episodes are reset."""
    benchmark.group = f"{name}, {n_episodes} episodes"
    n_cycles = max(HELD, CYCLES // (n_agents if n_episodes > 1 else 1) // HELD * HELD)
    env = VectorEnv(make_task(name, n_agents), n_episodes, copies_per_space=n_episodes)
    rng = np.random.default_rng(0)
    drawn = rng.uniform(-1, 1, (n_cycles // HELD, n_episodes, n_agents, 2))
    env.reset(range(n_episodes))

    def run() -> None:
        for action in drawn:
            for _ in range(HELD):
                step = env.step(action)
                ended = np.flatnonzero(step.terminated | step.truncated)
                if ended.size:
                    env.reset(rng.integers(2**31, size=ended.size).tolist(), ended)

    run()
    benchmark.pedantic(run, rounds=3)  # type: ignore[no-untyped-call]
    if benchmark.stats is not None:
        per_step = 1e6 * benchmark.stats.stats.median / (n_cycles * n_episodes)
        benchmark.extra_info["us_per_step"] = round(per_step, 1)
        report(
            "microseconds per step of a team, and per agent",
            f"{name}, {n_episodes} episodes, N = {n_agents}".ljust(46)
            + f"{per_step:>9.1f}{per_step / n_agents:>8.2f}",
        )


@pytest.mark.benchmark(timer=time.process_time)
@pytest.mark.parametrize(
    ("name", "n_agents"),
    [("blind_navigation_v0", 3), ("blind_navigation_v0", 64), ("blind_passage_v0", 5)],
)
def test_heuristic(benchmark: BenchmarkFixture, report: Report, name: str, n_agents: int) -> None:
    """The heuristic's actions over the first 50 cycles of an episode."""
    task = make_task(name, n_agents)
    env = VectorEnv(task)
    env.reset([0])
    states = []
    for _ in range(50):
        states.append(State(*(array.copy() for array in env.state)))
        env.step(heuristic(task, env.state))

    def run() -> None:
        for state in states:
            heuristic(task, state)

    benchmark.pedantic(run, rounds=3)  # type: ignore[no-untyped-call]
    if benchmark.stats is not None:
        milliseconds = 1e3 * benchmark.stats.stats.median / len(states)
        benchmark.extra_info["ms_per_step"] = round(milliseconds, 2)
        report(
            "milliseconds of a heuristic per step",
            f"{name}, N = {n_agents}".ljust(46) + f"{milliseconds:>9.2f}",
        )
