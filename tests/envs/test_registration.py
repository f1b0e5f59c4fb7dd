"""PettingZoo and Gymnasium make every task by its id, after nothing but `import xmarl_envs`."""

from __future__ import annotations

import warnings
from typing import Any

import gymnasium
import numpy as np
import pettingzoo
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import PassiveEnvChecker
from numpy.typing import NDArray
from xmarl_envs import TASKS, TaskParallelEnv, make_task
from xmarl_envs.gymnasium_env import TeamEnv
from xmarl_envs.gymnasium_vector_env import TeamVectorEnv
from xmarl_envs.registration import registered_id

tasks = pytest.mark.parametrize("name", TASKS)


def first_observation(name: str, n_agents: int, seed: int) -> NDArray[np.float32]:
    observations, _ = TaskParallelEnv(make_task(name, n_agents)).reset(seed=seed)
    return np.stack(list(observations.values()))


def test_ids() -> None:
    assert {registered_id(name) for name in TASKS} == {
        "xmarl/blind_navigation-v0",
        "xmarl/blind_passage-v0",
        "xmarl/blind_discovery-v0",
    }


@tasks
def test_pettingzoo_makes_every_task(name: str) -> None:
    env: Any
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = pettingzoo.make("parallel", registered_id(name), n_agents=4, max_cycles=7)
        by_turns: Any = pettingzoo.make("aec", registered_id(name), n_agents=4)
    assert isinstance(env, TaskParallelEnv)
    assert (env.task.name, env.task.n_agents, env.max_cycles) == (name, 4, 7)
    expected = first_observation(name, 4, 5)
    np.testing.assert_array_equal(np.stack(list(env.reset(seed=5)[0].values())), expected)
    by_turns.reset(seed=5)
    np.testing.assert_array_equal(np.stack([by_turns.observe(agent) for agent in by_turns.agents]), expected)


def test_pettingzoo_takes_its_own_spelling_of_the_id_too() -> None:
    env = pettingzoo.make("parallel", "xmarl/blind_navigation_v0")
    assert isinstance(env, TaskParallelEnv)


@tasks
def test_gymnasium_makes_a_team(name: str) -> None:
    env = gymnasium.make(registered_id(name), n_agents=4, max_cycles=7)
    assert isinstance(env.unwrapped, TeamEnv)
    assert env.spec is not None
    checked = env
    while not isinstance(checked, PassiveEnvChecker):  # raises AttributeError if there is none
        checked = checked.env  # type: ignore[attr-defined]
    np.testing.assert_array_equal(env.reset(seed=5)[0], first_observation(name, 4, 5))
    for cycle in range(7):
        truncated = env.step(env.action_space.sample())[3]
        assert truncated == (cycle == 6)


@pytest.mark.slow
def test_gymnasium_s_check_passes_on_what_it_made() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Positions have no bounds, which Gymnasium warns of.
        warnings.filterwarnings("ignore", message=".*Box observation space m..imum value is -?infinity")
        check_env(gymnasium.make("xmarl/blind_navigation-v0", max_cycles=20).unwrapped)


@tasks
def test_gymnasium_makes_many_teams(name: str) -> None:
    env: Any = gymnasium.make_vec(
        registered_id(name), num_envs=2, n_agents=4, autoreset_mode="SameStep", copies_per_space=2
    )
    assert isinstance(env, TeamVectorEnv)
    assert (env.task.name, env.task.n_agents, env.num_envs) == (name, 4, 2)
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    expected = [first_observation(name, 4, seed) for seed in (5, 6)]
    np.testing.assert_array_equal(env.reset(seed=5)[0], expected)


def test_options_of_the_task_are_passed_on() -> None:
    env = gymnasium.make("xmarl/blind_passage-v0", continuous_actions=False, shared_reward=True)
    assert isinstance(env.unwrapped, TeamEnv)
    assert env.unwrapped.task == make_task("blind_passage_v0", continuous_actions=False, shared_reward=True)
