"""PettingZoo's turn-by-turn (AEC) API plays the same episodes, also when converted back."""

from __future__ import annotations

import importlib

import numpy as np
import pytest
from pettingzoo.utils import aec_to_parallel, parallel_to_aec
from pettingzoo.utils.conversions import aec_to_parallel_wrapper
from xmarl_envs import TASKS, TaskParallelEnv, make_task
from xmarl_envs.trajectory import Pushes, play_env

tasks = pytest.mark.parametrize("name", TASKS)


@pytest.mark.slow
@tasks
@pytest.mark.parametrize("n_agents", [1, 4])
def test_converted_to_aec_and_back_it_plays_the_same_episode(name: str, n_agents: int) -> None:
    """Uses the wrapper itself: `aec_to_parallel` would only unwrap the first one."""
    direct = TaskParallelEnv(make_task(name, n_agents))
    converted = aec_to_parallel_wrapper(parallel_to_aec(TaskParallelEnv(make_task(name, n_agents))))
    assert play_env(converted, seed=3, max_steps=600) == play_env(direct, seed=3, max_steps=600)


@tasks
def test_taking_turns_is_the_same_episode(name: str) -> None:
    """Before each agent's next turn, `last()` returns what `step` of the ParallelEnv returned for it."""
    peer = TaskParallelEnv(make_task(name, 3), 25)
    env = importlib.import_module(f"xmarl_envs.{name}").env(n_agents=3, max_cycles=25)
    observations, infos = peer.reset(seed=8)
    env.reset(seed=8)
    rewards: dict[str, float] = dict.fromkeys(peer.agents, 0.0)
    over = dict.fromkeys(peer.agents, False)
    ended = over
    pushes = Pushes(peer, 0)
    n_turns = 0
    while env.agents:
        actions = pushes.next(peer.possible_agents)
        for agent in peer.possible_agents:
            assert env.agent_selection == agent
            observation, reward, terminated, truncated, info = env.last()
            np.testing.assert_array_equal(observation, observations[agent])
            assert (reward, terminated, truncated, info) == (
                rewards[agent],
                ended[agent],
                over[agent],
                infos[agent],
            )
            env.step(None if terminated or truncated else actions[agent])
            n_turns += 1
        if peer.agents:
            observations, rewards, ended, over, infos = peer.step(actions)
    assert n_turns == 3 * (25 + 1)  # every agent once more, for the last step's result


@tasks
def test_pettingzoo_finds_the_parallel_environment_in_ours(name: str) -> None:
    module = importlib.import_module(f"xmarl_envs.{name}")
    env = module.raw_env(n_agents=2)
    assert isinstance(aec_to_parallel(env), TaskParallelEnv)
    assert isinstance(module.env(n_agents=2).unwrapped, TaskParallelEnv)
