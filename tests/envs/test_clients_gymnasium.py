"""Gymnasium: our vector environment equals its own over one environment per team, bit for bit."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils import performance
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import DictInfoToList, NormalizeObservation, RecordEpisodeStatistics
from numpy.typing import NDArray
from xmarl_envs import TASKS, Task, make_task
from xmarl_envs.actions import nearest_actions
from xmarl_envs.gymnasium_env import TeamEnv
from xmarl_envs.gymnasium_vector_env import TeamVectorEnv

NUM_ENVS, N_AGENTS, MAX_CYCLES = 5, 3, 40
tasks = pytest.mark.parametrize("name", TASKS)
both_actions = pytest.mark.parametrize("continuous", [True, False], ids=["box", "discrete"])
modes = pytest.mark.parametrize("mode", list(AutoresetMode))
Act = Callable[[NDArray[np.float32]], NDArray[Any]]


def peer(task: Task, mode: AutoresetMode) -> SyncVectorEnv:
    return SyncVectorEnv([lambda: TeamEnv(task, MAX_CYCLES)] * NUM_ENVS, autoreset_mode=mode)


def ours(task: Task, mode: AutoresetMode) -> TeamVectorEnv:
    return TeamVectorEnv(task, NUM_ENVS, MAX_CYCLES, autoreset_mode=mode)


NAVIGATION = make_task("blind_navigation_v0", N_AGENTS)


def steering(task: Task, seed: int = 0) -> Act:
    """Navigation drives to its goals, so that episodes end at different times; the others push at random."""
    rng = np.random.default_rng(seed)

    def act(observation: NDArray[np.float32]) -> NDArray[Any]:
        noise = rng.uniform(-1, 1, (NUM_ENVS, N_AGENTS, 2)).astype(np.float32)
        if task.name != "blind_navigation_v0":
            return nearest_actions(task, noise)
        pull = -4 * observation[..., 4:6] - 2 * observation[..., 2:4]
        if not task.continuous_actions:
            return nearest_actions(task, 10 * pull)  # hard along the longer of the two ways
        return np.clip(pull + 0.1 * noise, -1, 1)

    return act


@both_actions
def test_a_team_is_a_valid_gymnasium_environment(continuous: bool) -> None:
    task = make_task("blind_navigation_v0", N_AGENTS, continuous_actions=continuous)
    check_env(TeamEnv(task), skip_render_check=True)


def test_a_team_needs_an_episode_and_an_action_per_agent() -> None:
    env = TeamEnv(NAVIGATION)
    with pytest.raises(ValueError, match="no episode is under way: call reset first"):
        env.step(np.zeros((N_AGENTS, 2)))
    env.reset(seed=0)
    for wrong in (np.zeros((2, 2)), np.array(1.0)):
        with pytest.raises(ValueError, match="a team of 3 needs as many actions, got shape"):
            env.step(wrong)


@pytest.mark.slow
@tasks
@modes
@both_actions
def test_every_step_equals_that_of_gymnasium_s_vector_environment(
    name: str, mode: AutoresetMode, continuous: bool
) -> None:
    task = make_task(name, N_AGENTS, continuous_actions=continuous)
    envs = [peer(task, mode), ours(task, mode)]
    act = steering(task)
    results: list[Any] = [env.reset(seed=3) for env in envs]
    same(results)
    begun_again = n_terminated = n_truncated = 0
    for cycle in range(3 * MAX_CYCLES):
        actions = act(results[1][0])
        results = [env.step(actions) for env in envs]
        same(results)
        terminated, truncated = results[1][2:4]
        n_terminated, n_truncated = n_terminated + terminated.sum(), n_truncated + truncated.sum()
        over = (terminated | truncated) if mode is AutoresetMode.DISABLED else np.zeros(NUM_ENVS, np.bool_)
        over[1] |= cycle == 5  # so that entries get out of step
        if over.any():
            begun_again += 1
            seeds = [100 + cycle if cycle == 5 else None] * NUM_ENVS
            results = [env.reset(seed=seeds, options={"reset_mask": over}) for env in envs]  # type: ignore[arg-type]
            same(results)
    assert begun_again >= (3 if mode is AutoresetMode.DISABLED else 1)
    assert n_truncated > 0
    assert n_terminated > 0 or name != "blind_navigation_v0"


def same(results: list[Any]) -> None:
    """Asserts the same bits and types; a key without any valid entry is optional."""
    for mine, theirs in zip(results[1][:-1], results[0][:-1], strict=True):
        assert mine.dtype == theirs.dtype
        np.testing.assert_array_equal(mine, theirs)
    same_infos(results[1][-1], results[0][-1])


def same_infos(mine: dict[str, Any], theirs: dict[str, Any]) -> None:
    assert set(mine) == set(theirs)
    for key, value in theirs.items():
        if isinstance(value, dict):
            same_infos(mine[key], value)
        elif value.dtype == object:
            for a, b in zip(mine[key], value, strict=True):
                np.testing.assert_array_equal(a, b)
        else:
            assert mine[key].dtype == value.dtype
            np.testing.assert_array_equal(mine[key], value)


@tasks
@both_actions
def test_spaces_and_metadata(name: str, continuous: bool) -> None:
    task = make_task(name, N_AGENTS, continuous_actions=continuous)
    mine, theirs = ours(task, AutoresetMode.SAME_STEP), peer(task, AutoresetMode.SAME_STEP)
    assert mine.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert (mine.num_envs, mine.observation_space, mine.action_space) == (
        theirs.num_envs,
        theirs.observation_space,
        theirs.action_space,
    )
    assert mine.single_observation_space == theirs.single_observation_space
    assert mine.single_action_space == theirs.single_action_space
    assert mine.observation_space.contains(mine.reset(seed=0)[0])


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_gymnasium_s_statistics_of_episodes_are_the_same_on_both(mode: AutoresetMode) -> None:
    recorded = []
    for env in (peer(NAVIGATION, mode), ours(NAVIGATION, mode)):
        act, wrapped = steering(NAVIGATION), RecordEpisodeStatistics(env)
        observation, _ = wrapped.reset(seed=3)
        for _ in range(100):
            observation = wrapped.step(act(observation))[0]
        recorded.append((list(wrapped.return_queue), list(wrapped.length_queue)))
    assert recorded[0] == recorded[1]
    assert len(recorded[0][1]) > NUM_ENVS


def test_gymnasium_s_wrappers_work_on_it() -> None:
    env = NormalizeObservation(DictInfoToList(ours(NAVIGATION, AutoresetMode.NEXT_STEP)))
    env.action_space.seed(0)
    env.reset(seed=3)
    for _ in range(100):
        observation, _, _, _, infos = env.step(env.action_space.sample())
    assert 0.3 < observation.std() < 3  # normalised
    assert isinstance(infos, list)
    assert [info["at_goal"].shape for info in infos if info] == [(N_AGENTS,)] * NUM_ENVS


@pytest.mark.skipif(
    not hasattr(performance, "benchmark_vector_step"), reason="Gymnasium measures vectors from 1.4 on"
)
def test_gymnasium_measures_its_speed() -> None:
    env = gymnasium.make_vec("xmarl/blind_navigation-v0", num_envs=4, max_cycles=5)
    assert env.num_envs == 4
    assert performance.benchmark_vector_step(env, target_duration=0, seed=1) > 0


@modes
def test_a_step_needs_an_episode_of_every_team(mode: AutoresetMode) -> None:
    env, still = ours(NAVIGATION, mode), np.zeros((NUM_ENVS, N_AGENTS, 2), np.float32)
    with pytest.raises(ValueError, match="call reset first"):
        env.step(still)
    env.reset(seed=0, options={"reset_mask": np.arange(NUM_ENVS) == 0})
    with pytest.raises(ValueError, match="call reset first"):
        env.step(still)
    env.reset(seed=0)
    env.step(still)


def test_invalid_arguments_are_refused_with_a_reason() -> None:
    env = ours(NAVIGATION, AutoresetMode.DISABLED)
    with pytest.raises(ValueError, match="each entry needs one seed: got 2 seeds for 5 entries"):
        env.reset(seed=[1, 2])
    with pytest.raises(ValueError, match="a seed must be a whole number from 0 on, got -1"):
        env.reset(seed=-1)
    with pytest.raises(ValueError, match=r"must be a boolean array of shape \(5,\)"):
        env.reset(options={"reset_mask": np.ones(5)})
    env.reset(seed=0)
    for _ in range(MAX_CYCLES):
        env.step(np.zeros((NUM_ENVS, N_AGENTS, 2), np.float32))
    with pytest.raises(
        ValueError, match=r"the episodes of entries \[0, 1, 2, 3, 4\] are over: begin new ones"
    ):
        env.step(np.zeros((NUM_ENVS, N_AGENTS, 2), np.float32))


def test_lists_and_tensors_are_actions_and_those_of_entries_that_reset_are_ignored() -> None:
    """As in Gymnasium's vector environments."""
    task = make_task("blind_navigation_v0", 2)
    env, again = (TeamVectorEnv(task, 2, max_cycles=3) for _ in range(2))
    env.reset(seed=0)
    again.reset(seed=0)
    actions = np.full((2, 2, 2), 0.5, dtype=np.float32)
    for given in (actions.tolist(), torch.tensor(actions), actions):
        np.testing.assert_array_equal(env.step(given)[0], again.step(actions)[0])
    nowhere = np.full_like(actions, np.nan)  # the third step was the last: both entries begin anew
    np.testing.assert_array_equal(env.step(nowhere)[0], again.step(actions)[0])
    with pytest.raises(ValueError, match="must be finite numbers"):
        env.step(nowhere)
