"""How fast episodes step, beside VMAS navigation: `make bench`.

Each round takes STEPS steps with random actions; `env_steps_per_s` counts steps of a whole team. VMAS runs
with `collisions=False`, which removes its lidar (blind agents have none) and its contacts too: it computes
less than ours does. Torch gets one thread; ours is single-threaded.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
import vmas
from pytest_benchmark.fixture import BenchmarkFixture
from xmarl_envs import BlindNavigation, TaskParallelEnv, VectorEnv, make_task

N_AGENTS, STEPS = 3, 20
BATCHES = [64, 1024]


def measure(benchmark: BenchmarkFixture, n_episodes: int, step: Callable[[], object]) -> None:
    def steps() -> None:
        for _ in range(STEPS):
            step()

    benchmark(steps)
    if benchmark.stats is not None:
        benchmark.extra_info["env_steps_per_s"] = round(n_episodes * STEPS / benchmark.stats.stats.median)


@pytest.mark.parametrize("n_episodes", BATCHES)
@pytest.mark.parametrize("copies_per_space", [1, 64])
@pytest.mark.parametrize("name", ["blind_navigation_v0", "blind_passage_v0", "blind_discovery_v0"])
def test_ours(benchmark: BenchmarkFixture, name: str, copies_per_space: int, n_episodes: int) -> None:
    env = VectorEnv(make_task(name, N_AGENTS), n_episodes, copies_per_space=copies_per_space)
    env.reset(range(n_episodes))
    rng = np.random.default_rng(0)
    measure(benchmark, n_episodes, lambda: env.step(rng.uniform(-1, 1, (n_episodes, N_AGENTS, 2))))


@pytest.mark.parametrize("n_episodes", [1, *BATCHES])
def test_vmas_navigation(benchmark: BenchmarkFixture, n_episodes: int) -> None:
    env = vmas.make_env(
        "navigation",
        num_envs=n_episodes,
        seed=0,
        n_agents=N_AGENTS,
        collisions=False,
        continuous_actions=True,
    )
    env.reset()
    measure(
        benchmark, n_episodes, lambda: env.step([2 * torch.rand(n_episodes, 2) - 1 for _ in range(N_AGENTS)])
    )


def test_our_pettingzoo_episode(benchmark: BenchmarkFixture) -> None:
    env = TaskParallelEnv(BlindNavigation(N_AGENTS), max_cycles=10**9)
    env.reset(seed=0)
    rng = np.random.default_rng(0)

    def step() -> None:
        if not env.agents:
            env.reset()
        action = rng.uniform(-1, 1, (N_AGENTS, 2)).astype(np.float32)
        env.step(dict(zip(env.agents, action, strict=True)))

    measure(benchmark, 1, step)
