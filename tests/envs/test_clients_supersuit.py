"""SuperSuit: its wrappers, its vector environments, and stable-baselines3 through them."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
import supersuit
from pettingzoo.test import api_test, parallel_api_test
from pettingzoo.utils import parallel_to_aec
from stable_baselines3 import PPO
from xmarl_envs import TASKS, TaskParallelEnv, blind_navigation_v0, blind_passage_v0, make_task
from xmarl_envs.actions import nearest_actions
from xmarl_envs.sb3_vec_env import AgentVecEnv, SuperSuitVecEnv

from tests.envs.learning import MAX_CYCLES, N_AGENTS, distances_before_and_after_learning

tasks = pytest.mark.parametrize("name", TASKS)
both_actions = pytest.mark.parametrize("continuous", [True, False], ids=["box", "discrete"])


def concatenated(env: Any, copies: int, base_class: str = "gymnasium", num_cpus: int = 0) -> Any:
    venv = supersuit.pettingzoo_env_to_vec_env_v1(env)
    return supersuit.concat_vec_envs_v1(venv, copies, num_cpus=num_cpus, base_class=base_class)


@tasks
@both_actions
def test_our_vector_environment_plays_the_same_episodes_as_supersuit_s(name: str, continuous: bool) -> None:
    task = make_task(name, 3, continuous_actions=continuous)
    theirs = SuperSuitVecEnv(concatenated(TaskParallelEnv(task, 10), 4))
    ours = AgentVecEnv(task, 4, max_cycles=10)
    rng = np.random.default_rng(0)
    assert ours.seed(7) == theirs.seed(7) == [7] * 3 + [8] * 3 + [9] * 3 + [10] * 3
    observation: Any = ours.reset()
    expected: Any = theirs.reset()
    n_done = 0
    for _ in range(25):
        np.testing.assert_array_equal(observation, expected)
        action = nearest_actions(task, rng.uniform(-1, 1, (12, 2)).astype(np.float32))
        observation, reward, done, infos = ours.step(action)
        expected, expected_reward, expected_done, expected_infos = theirs.step(action)
        for mine, other in ((reward, expected_reward), (done, expected_done)):
            assert mine.dtype == other.dtype
            np.testing.assert_array_equal(mine, other)
        for info, expected_info in zip(infos, expected_infos, strict=True):
            info.pop("is_success", None)
            last, expected_last = (i.pop("terminal_observation", None) for i in (info, expected_info))
            np.testing.assert_array_equal(last, expected_last)
            assert info == expected_info
        n_done += int(done.sum())
    assert n_done >= 2 * 12


class TellsBoth(TaskParallelEnv):
    """An episode that is both terminated and truncated, which PettingZoo allows and ours never is."""

    def step(self, actions: dict[str, Any]) -> Any:
        observations, rewards, terminations, _, infos = super().step(actions)
        return observations, rewards, terminations, dict.fromkeys(terminations, not self.agents), infos


def test_a_terminated_team_is_not_reported_as_truncated() -> None:
    """An agent that drives straight terminates at its goal; the same agent held still is truncated."""
    env = SuperSuitVecEnv(concatenated(TellsBoth(make_task("blind_navigation_v0", 1), 90), 2))
    env.seed(0)
    observation: Any = env.reset()
    ended: dict[bool, int] = {}
    for cycle in range(90):
        action = np.clip(-4 * observation[:, 4:6] - 2 * observation[:, 2:4], -1, 1)
        action[1] = 0.0
        observation, _, done, infos = env.step(action)
        for info, over in zip(infos, done, strict=True):
            if over:
                ended.setdefault(info["TimeLimit.truncated"], cycle + 1)
    assert ended[True] == 90
    assert ended[False] < 90


@pytest.mark.training
def test_ppo_through_supersuit_gets_nearer_to_the_goals() -> None:
    env = blind_navigation_v0.parallel_env(n_agents=N_AGENTS, max_cycles=MAX_CYCLES)
    before, after = distances_before_and_after_learning(SuperSuitVecEnv(concatenated(env, 16)))
    assert before > 1.0
    assert after < 0.8 * before


def test_supersuit_s_own_vec_env_cannot_be_seeded() -> None:
    """If SuperSuit fixes this, remove `SuperSuitVecEnv`."""
    env = blind_navigation_v0.parallel_env(max_cycles=2)
    theirs = concatenated(env, 2, base_class="stable_baselines3")
    for broken in (
        lambda: theirs.seed(0),
        lambda: theirs.reset(seed=0),
        lambda: PPO("MlpPolicy", theirs, seed=0),
    ):
        with pytest.raises(AttributeError, match="'ConcatVecEnv' object has no attribute 'seed'"):
            broken()
    theirs.reset()
    *_, done, infos = [theirs.step(np.zeros((6, 2), np.float32)) for _ in range(2)][-1]
    assert done.all()
    assert not any("TimeLimit.truncated" in info for info in infos)


def test_unseeded_copies_differ() -> None:
    venv = concatenated(blind_navigation_v0.parallel_env(), 4)
    assert len(np.unique(venv.reset()[0], axis=0)) == 12


@pytest.mark.slow
def test_several_processes_work_in_supersuit_but_are_refused_by_our_adapter() -> None:
    venv = concatenated(blind_passage_v0.parallel_env(max_cycles=3), 2, num_cpus=2)
    try:
        assert venv.reset()[0].shape == (6, 8)
        for _ in range(4):
            observation, *_ = venv.step(np.zeros((6, 2), np.float32))
        assert np.isfinite(observation).all()
        with pytest.raises(ValueError, match=r"num_cpus=0 and base_class=\"gymnasium\", got ProcConcatVec"):
            SuperSuitVecEnv(venv)
    finally:
        venv.close()
        for process in venv.procs:
            process.terminate()


@tasks
def test_frames_are_stacked(name: str) -> None:
    plain, stacked = (TaskParallelEnv(make_task(name, 3), 20) for _ in range(2))
    wrapped = supersuit.frame_stack_v1(stacked, stack_size=3)
    obs_dim = plain.task.obs_dim
    frames: list[Any] = [np.zeros(obs_dim), np.zeros(obs_dim), plain.reset(seed=1)[0]["agent_1"]]
    observations, _ = wrapped.reset(seed=1)
    rng = np.random.default_rng(0)
    for _ in range(5):
        np.testing.assert_array_equal(observations["agent_1"], np.concatenate(frames[-3:]))
        assert wrapped.observation_space("agent_1").contains(observations["agent_1"])
        actions = dict(zip(plain.agents, rng.uniform(-1, 1, (3, 2)).astype(np.float32), strict=True))
        frames.append(plain.step(actions)[0]["agent_1"])
        observations, *_ = wrapped.step(actions)
    parallel_api_test(wrapped, num_cycles=30)


def test_rewards_and_actions_are_clipped() -> None:
    plain, clipped = (blind_passage_v0.parallel_env() for _ in range(2))
    wrapped = supersuit.clip_reward_v0(supersuit.clip_actions_v0(clipped), -1, 1)
    plain.reset(seed=2), wrapped.reset(seed=2)
    far = []
    for _ in range(10):
        actions = {agent: np.full(2, 5.0, np.float32) for agent in plain.agents}
        expected, rewards, *_ = plain.step({agent: np.ones(2, np.float32) for agent in plain.agents})
        observations, clipped_rewards, *_ = wrapped.step(actions)
        for agent in plain.agents:
            np.testing.assert_array_equal(observations[agent], expected[agent])
            assert clipped_rewards[agent] == np.clip(rewards[agent], -1, 1)
            far.append(abs(rewards[agent]) > 1)
    assert any(far) and not all(far)


@tasks
def test_wrapped_turn_by_turn_environments_pass_pettingzoo_s_test(name: str) -> None:
    env = parallel_to_aec(TaskParallelEnv(make_task(name)))
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        warnings.filterwarnings("ignore", message=".*observation space value is.*infinity.*")
        api_test(supersuit.frame_stack_v1(supersuit.clip_actions_v0(env), 2), num_cycles=30)
