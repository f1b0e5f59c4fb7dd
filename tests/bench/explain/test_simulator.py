"""Episodes restarted at what was observed go on as they were played, alone or in a batch."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from xmarl_envs import TASKS, make_task

from tests.helpers.policies import random_observations, small_policy
from xmarl_bench.errors import InputError
from xmarl_bench.explain import simulator as module
from xmarl_bench.explain.simulator import Simulator
from xmarl_bench.rollout.episodes import chooser, roll_out


@pytest.mark.parametrize("name", TASKS)
def test_a_restarted_episode_goes_on_as_it_was_played(name: str) -> None:
    """A lonely agent: no contact amplifies the rounding of what was observed."""
    task, seed = make_task(name, 1), 3
    policy = small_policy(task.obs_dim, 1)
    episode = torch.from_numpy(roll_out(task, policy, [seed], max_cycles=30)[0].observations)
    env = Simulator(name, 1, seed).restart(policy, episode[:20])
    for k in range(10):
        np.testing.assert_allclose(env.observe(), episode[k : k + 20], atol=1e-5)
        env.step(chooser(policy)(env.observe())[0])
    assert np.ptp(episode[:, 0, :2].numpy()) > 0.1


def test_no_copy_depends_on_how_many_there_are() -> None:
    """To the bit, in a crowd."""
    policy, crowd = small_policy(6), 0.2 * random_observations(7, 5, 6)
    simulator, push = Simulator("blind_navigation_v0", 5, 0), np.random.default_rng(0).normal(size=(7, 5, 2))
    together = simulator.restart(policy, crowd)
    alone = [simulator.restart(policy, crowd[k : k + 1]) for k in range(7)]
    touched = np.zeros(7, dtype=bool)
    for _ in range(10):
        step = together.step(push)
        touched |= step.agent_collision.any(axis=1)
        for k, each in enumerate(alone):
            assert np.array_equal(each.step(push[k : k + 1]).observation[0], step.observation[k])
    assert touched.all()


def test_what_cannot_be_restarted_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    simulator = Simulator("blind_navigation_v0", 3, 0)
    with pytest.raises(
        InputError, match=r"a world of 3 agents cannot be restarted with .* \(4, 6\), expected \(3, 6\)"
    ):
        simulator.restart(small_policy(6), random_observations(2, 4, 6))
    with pytest.raises(InputError, match=r"\(3, 8\), expected \(3, 6\)"):
        simulator.restart(small_policy(8), random_observations(2, 3, 8))
    monkeypatch.setattr(module, "STATE_NAMES", ("position_x", "altitude"))
    with pytest.raises(InputError, match=r"blind_navigation_v0 cannot be restarted, .* observe altitude"):
        simulator.restart(small_policy(6), random_observations(2, 3, 6))
