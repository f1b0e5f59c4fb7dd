"""What "blind" means: moving another agent changes no entry of my observation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from xmarl_envs import TASKS, VectorEnv, make_task

from tests.envs.properties import PROPERTY

metres = st.floats(-3.0, 3.0)


@PROPERTY
@given(data=st.data(), n_agents=st.integers(2, 5), seed=st.integers(0, 10_000))
@pytest.mark.parametrize("name", TASKS)
def test_moving_another_agent_changes_nothing_i_see(
    name: str, data: st.DataObject, n_agents: int, seed: int
) -> None:
    env = VectorEnv(make_task(name, n_agents))
    env.reset([seed])
    env.step(np.random.default_rng(seed).uniform(-1, 1, (1, n_agents, 2)))
    before = env.observe()[0]
    mover = data.draw(st.integers(0, n_agents - 1))
    env.world.position[0, mover] = data.draw(st.tuples(metres, metres))
    env.world.velocity[0, mover] = data.draw(st.tuples(metres, metres))
    after = env.observe()[0]
    others = np.arange(n_agents) != mover
    np.testing.assert_array_equal(after[others], before[others])


@pytest.mark.parametrize("name", TASKS)
def test_moving_myself_does_change_it(name: str) -> None:
    env = VectorEnv(make_task(name, 3))
    before = env.reset([0])[0]
    env.world.position[0, 1] += 0.5
    env.world.velocity[0, 1] += 0.5
    assert (env.observe()[0, 1] != before[1])[:4].all()


@pytest.mark.parametrize("name", TASKS)
def test_a_step_beside_a_distant_partner_is_seen_the_same(name: str) -> None:
    """Through the physics too: what a partner does out of reach is not seen at the next step."""
    seen = []
    for push in (-1.0, 1.0):
        env = VectorEnv(make_task(name, 3))
        env.reset([4])
        action = np.zeros((1, 3, 2))
        action[0, 1] = push
        seen.append(env.step(action).observation[0, [0, 2]])
    np.testing.assert_array_equal(seen[0], seen[1])
