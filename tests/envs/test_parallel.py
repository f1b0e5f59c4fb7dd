"""The PettingZoo environment, beyond what `check_task` checks."""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pettingzoo.test import api_test
from xmarl_envs import TASKS, TaskParallelEnv, VectorEnv, make_task

tasks = pytest.mark.parametrize("name", TASKS)


@pytest.fixture(autouse=True)
def pettingzoo_warnings_are_errors() -> Iterator[None]:
    """PettingZoo's tests only warn of most faults. Unbounded spaces are intended: the plane is open."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        warnings.filterwarnings("ignore", message=".*(minimum|maximum).*space value.*infinity.*")
        yield


def module_of(name: str) -> ModuleType:
    return importlib.import_module(f"xmarl_envs.{name}")


@tasks
def test_turn_by_turn_constructors(name: str) -> None:
    api_test(module_of(name).env(n_agents=4), num_cycles=30)
    api_test(module_of(name).raw_env(n_agents=4), num_cycles=30)


@pytest.mark.parametrize(("name", "n_agents"), [("blind_passage_v0", 6), ("blind_navigation_v0", 0)])
def test_team_sizes_out_of_range_are_refused(name: str, n_agents: int) -> None:
    with pytest.raises(ValueError, match=f"{name} takes 1 to .* agents, got n_agents={n_agents}"):
        module_of(name).parallel_env(n_agents=n_agents)


def test_max_cycles_below_one_and_fractions_are_refused() -> None:
    with pytest.raises(ValueError, match="max_cycles must be at least 1, got 0"):
        module_of("blind_discovery_v0").parallel_env(max_cycles=0)
    with pytest.raises(TypeError, match="'float' object cannot be interpreted as an integer"):
        module_of("blind_discovery_v0").parallel_env(max_cycles=2.5)


@tasks
def test_agents_observe_their_row_and_the_state_is_all_rows(name: str) -> None:
    env, vector = TaskParallelEnv(make_task(name, 4)), VectorEnv(make_task(name, 4))
    observation, infos = env.reset(seed=5)
    rows = vector.reset([5])[0]
    assert infos == {agent: {} for agent in env.agents}
    for _ in range(3):
        for i, agent in enumerate(env.agents):
            np.testing.assert_array_equal(observation[agent], rows[i])
            assert env.observation_space(agent).contains(observation[agent])
        np.testing.assert_array_equal(env.state(), rows.ravel())
        assert env.state_space.contains(env.state())
        actions = random_actions(env)
        observation, reward, _, _, infos = env.step(actions)
        step = vector.step(np.stack([actions[agent] for agent in env.agents])[None])
        rows = step.observation[0]
        for i, agent in enumerate(env.agents):
            assert reward[agent] == step.reward[0, i]
            assert infos[agent] == {
                env.task.success_key: bool(step.success[0, i]),
                "agent_collision": bool(step.agent_collision[0, i]),
                "object_collision": bool(step.object_collision[0, i]),
            }


def test_infos_report_goals_and_collisions() -> None:
    keys = {}
    for name in TASKS:
        env = TaskParallelEnv(make_task(name))
        env.reset(seed=0)
        infos = env.step(random_actions(env))[-1]
        keys[name] = set(infos["agent_0"]) - {"agent_collision", "object_collision"}
    assert keys == {
        "blind_navigation_v0": {"at_goal"},
        "blind_passage_v0": {"at_goal"},
        "blind_discovery_v0": {"found"},
    }


def test_truncation_ends_the_episode_and_later_steps_return_nothing() -> None:
    env = TaskParallelEnv(make_task("blind_navigation_v0"), max_cycles=2)
    env.reset(seed=0)
    truncations = [env.step(random_actions(env))[3] for _ in range(2)]
    assert truncations == [dict.fromkeys(env.possible_agents, value) for value in (False, True)]
    assert env.agents == []
    assert env.step({}) == ({}, {}, {}, {}, {})
    env.reset()
    assert env.agents == env.possible_agents


def test_invalid_seeds_are_refused_and_the_environment_continues() -> None:
    env = TaskParallelEnv(make_task("blind_navigation_v0"))
    with pytest.raises(ValueError, match="a seed must be a whole number from 0 on, got -1"):
        env.reset(seed=-1)
    with pytest.raises(TypeError, match="float"):
        env.reset(seed=1.5)  # type: ignore[arg-type]
    assert env.reset()[0].keys() == set(env.possible_agents)
    assert env.reset(seed=np.int64(3))[0].keys() == set(env.possible_agents)  # type: ignore[arg-type]


def test_unseeded_resets_after_a_seed_repeat() -> None:
    env = TaskParallelEnv(make_task("blind_navigation_v0"))
    rows = []
    for _ in range(2):
        starts = [env.reset(seed=3)[0], env.reset()[0], env.reset()[0]]
        rows.append(np.stack([start["agent_0"] for start in starts]))
    np.testing.assert_array_equal(rows[0], rows[1])
    assert len(np.unique(rows[0], axis=0)) == 3


@pytest.mark.parametrize(
    ("bad", "sentence"),
    [
        (np.zeros(3), r"the action of agent_1 must have shape \(2,\), got \(3,\)\."),
        (np.float64(1), r"the action of agent_1 must have shape \(2,\), got \(\)\."),
        (
            np.array([0.0, np.nan]),
            "actions of blind_navigation_v0 must be finite numbers, got NaN or infinity.",
        ),
        (
            np.array([-np.inf, 0.0]),
            "actions of blind_navigation_v0 must be finite numbers, got NaN or infinity.",
        ),
    ],
)
def test_invalid_actions_are_refused_and_leave_the_episode_unchanged(
    bad: NDArray[Any], sentence: str
) -> None:
    env = TaskParallelEnv(make_task("blind_navigation_v0"))
    env.reset(seed=0)
    before = env.state()
    actions = {agent: np.zeros(2, dtype=np.float32) for agent in env.agents}
    with pytest.raises(ValueError, match=sentence):
        env.step({**actions, "agent_1": bad})
    np.testing.assert_array_equal(env.state(), before)


def test_missing_agents_are_named() -> None:
    env = TaskParallelEnv(make_task("blind_navigation_v0"))
    env.reset(seed=0)
    with pytest.raises(
        ValueError, match="every live agent needs an action, none was given for agent_1, agent_2"
    ):
        env.step({"agent_0": np.zeros(2, dtype=np.float32)})


@pytest.mark.parametrize("n_agents", [1, 2, 3])
def test_actions_that_numpy_would_broadcast_are_refused(n_agents: int) -> None:
    env = TaskParallelEnv(make_task("blind_navigation_v0", n_agents))
    env.reset(seed=0)
    wrong: list[Any] = [np.zeros(1), np.float64(0.5), np.zeros((1, 2)), np.zeros(n_agents + 2)]
    for bad in wrong:
        with pytest.raises(ValueError, match=r"the action of agent_0 must have shape \(2,\), got"):
            env.step(dict.fromkeys(env.agents, bad))


def random_actions(env: TaskParallelEnv) -> dict[str, NDArray[np.float32]]:
    return {agent: env.action_space(agent).sample() for agent in env.agents}
