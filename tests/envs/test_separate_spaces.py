"""Episodes that fly without a Space have the bits of those whose Space takes every step."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from xmarl_envs import TASKS, make_task, separate_spaces
from xmarl_envs.separate_spaces import flight_has_the_bits_of_a_space
from xmarl_envs.task import Floats
from xmarl_envs.vector_env import VectorEnv

EPISODES, STEPS = 12, 80
OF_A_SPACE = 10**6  # more episodes than any: none flies


def played(name: str, n_agents: int, copied_at: int | None = None) -> Floats:
    """(STEPS, 2, B, N, 2): positions and velocities of teams that wander, some of which end early."""
    task, rng = make_task(name, n_agents), np.random.default_rng(7)
    env = VectorEnv(task, EPISODES)
    env.reset(range(EPISODES))
    seen = []
    wander = rng.uniform(-1, 1, (EPISODES, n_agents, 2))
    for step in range(STEPS):
        if step == copied_at:
            env = pickle.loads(pickle.dumps(env))
        if step == STEPS // 2:
            env.reset([100, 101], episodes=[1, 5])
        # Towards the middle for most of the time: crowds, borders and walls.
        towards = np.clip(-2 * env.state.position, -1, 1) if step % 40 < 25 else 3 * wander
        env.step(np.clip(towards + 0.3 * wander, -1, 1), np.arange(EPISODES) % 4 != step // 60)
        seen.append(np.stack([env.state.position, env.state.velocity]))
    return np.array(seen)


@pytest.mark.slow
@pytest.mark.parametrize("name", TASKS)
@pytest.mark.parametrize("n_agents", [1, 2, 3, 5])
def test_flight_has_the_bits_of_spaces(name: str, n_agents: int, monkeypatch: pytest.MonkeyPatch) -> None:
    flown = played(name, n_agents)
    assert (played(name, n_agents, copied_at=55) == flown).all()
    monkeypatch.setattr(separate_spaces, "FEWEST_FLYING", OF_A_SPACE)
    assert (played(name, n_agents) == flown).all()


def test_free_flight_builds_no_space(monkeypatch: pytest.MonkeyPatch) -> None:
    """A team of one in an open plane touches nothing."""
    assert flight_has_the_bits_of_a_space()
    monkeypatch.setattr(separate_spaces, "SlottedSpace", None)  # building one would fail
    env = VectorEnv(make_task("blind_navigation_v0", 1), 8)
    env.reset(range(8))
    for _ in range(70):
        env.step(np.full((8, 1, 2), 0.5))
    assert (env.state.velocity > 0.1).all()
