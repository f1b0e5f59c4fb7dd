"""Physics of scoring, one Space per episode, beside a Space for every step.

Three kinds of steps have the bits of a Space for every step (`tests/envs/test_separate_spaces.py`). Episodes
that touch nothing are advanced together in numpy, with Chipmunk's own arithmetic; few of them one by one, in
Python's numbers. While no disc has two contacts at once, the order in which Chipmunk solves them does not
matter: the episode borrows a Space for these steps. Where a disc has several, their order follows Chipmunk's
search tree, and that follows all earlier steps: the episode's own Space then takes all since its beginning.
Figures of rollouts are the physics of 50 episodes of a shipped policy.

What stops discovery: its teams push into each other at the landmark and in corners, often for hundreds of
steps, and most of their steps come before the last one that has a disc with several contacts. A step of a
Space does not become cheaper by public means: half of its time is six calls of `Space.step`, and pymunk has
no call that makes several steps or steps several Spaces.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from xmarl_envs import make_task, separate_spaces
from xmarl_envs.separate_spaces import SeparateSpaces
from xmarl_envs.task import Bools

from tests.benchmarks.conftest import Report
from tests.benchmarks.side_by_side import record
from xmarl_bench.plugins.names import find_policies
from xmarl_bench.policy import load_policy
from xmarl_bench.reproducible import episode_seeds
from xmarl_bench.rollout.episodes import roll_out

pytestmark = pytest.mark.benchmark(timer=time.process_time)
POLICIES = (
    "navigation-n3-residual-lambda0-seed0", "navigation-n5-residual-lambda0.1-seed0",
    "passage-n3-residual-lambda0-seed0", "passage-n4-residual-lambda0-seed0",
    "discovery-n3-residual-lambda0-seed0", "discovery-n5-residual-lambda0.03-seed0",
)  # fmt: skip
EPISODES, ROUNDS, STEPS = 50, 3, 100
PEER = "a Space for every step"


def free_flight(n_episodes: int) -> float:
    """CPU seconds of a step of so many teams of three that never touch."""
    spaces = SeparateSpaces(make_task("blind_navigation_v0", 3), n_episodes)
    position = np.tile(np.array([[-3.0, 0.0], [0.0, 0.0], [3.0, 0.0]]), (n_episodes, 1, 1))
    velocity, walls = np.zeros_like(position), np.zeros((n_episodes, 0, 2))
    spaces.place(np.arange(n_episodes), position, velocity, walls)
    force = np.random.default_rng(0).uniform(-0.3, 0.3, (STEPS, *position.shape))
    started = time.process_time()
    for each in force:
        spaces.step(position, velocity, each, walls, None)
    return (time.process_time() - started) / STEPS


def compared(
    benchmark: BenchmarkFixture,
    report: Report,
    monkeypatch: pytest.MonkeyPatch,
    what: str,
    seconds: Callable[[], float],
) -> None:
    """Calls `seconds` in turns with and without episodes that fly together."""
    ours, theirs = list[float](), list[float]()

    def both() -> None:
        with monkeypatch.context() as patch:
            patch.setattr(separate_spaces, "LARGEST_FLYING_TEAM", 0)
            theirs.append(seconds())
        ours.append(seconds())

    benchmark.pedantic(both, rounds=ROUNDS)  # type: ignore[no-untyped-call]
    record(benchmark, report, what, PEER, ours=ours, theirs=theirs, unit="ms")


@pytest.mark.parametrize("n_episodes", [1, 4, 16, 50, 200])
def test_free_flight(
    benchmark: BenchmarkFixture, report: Report, monkeypatch: pytest.MonkeyPatch, n_episodes: int
) -> None:
    what = f"scoring physics, a step of {n_episodes} teams in free flight"
    compared(benchmark, report, monkeypatch, what, lambda: free_flight(n_episodes))


@pytest.mark.parametrize("name", POLICIES)
def test_rollouts(
    benchmark: BenchmarkFixture, report: Report, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    policy, card = load_policy(find_policies()[name])
    task = make_task(card.task, card.n_agents)
    spent = [0.0]
    step = SeparateSpaces.step

    def timed(self: SeparateSpaces, *arguments: Any) -> Bools:
        started = time.process_time()
        close = step(self, *arguments)
        spent[0] += time.process_time() - started
        return close

    def seconds() -> float:
        spent[0] = 0.0
        roll_out(task, policy, episode_seeds(0, EPISODES), parallel_episodes=EPISODES)
        return spent[0]

    with monkeypatch.context() as patch:
        patch.setattr(SeparateSpaces, "step", timed)
        what = f"scoring physics, {EPISODES} episodes of {name}"
        compared(benchmark, report, monkeypatch, what, seconds)
