"""Blindness beyond `check_task`: agents observe themselves, and do not sense others through the physics."""

from __future__ import annotations

import numpy as np
import pytest
from xmarl_envs import TASKS, VectorEnv, make_task


@pytest.mark.parametrize("name", TASKS)
def test_moving_an_agent_changes_its_own_observation(name: str) -> None:
    env = VectorEnv(make_task(name, 3))
    before = env.reset([0])[0]
    env.world.position[0, 1] += 0.5
    env.world.velocity[0, 1] += 0.5
    assert (env.observe()[0, 1] != before[1])[:4].all()


@pytest.mark.parametrize("name", TASKS)
def test_actions_of_a_distant_partner_change_no_observation(name: str) -> None:
    """Also not through the physics, at the next step."""
    seen = []
    for push in (-1.0, 1.0):
        env = VectorEnv(make_task(name, 3))
        env.reset([4])
        action = np.zeros((1, 3, 2))
        action[0, 1] = push
        seen.append(env.step(action).observation[0, [0, 2]])
    np.testing.assert_array_equal(seen[0], seen[1])
