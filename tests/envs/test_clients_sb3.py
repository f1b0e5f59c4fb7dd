"""stable-baselines3: one entry per agent, seeded, reset and bootstrapped as in SB3."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from numpy.typing import NDArray
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor, VecNormalize
from xmarl_envs import TASKS, Task, TaskParallelEnv, make_task
from xmarl_envs.actions import nearest_actions
from xmarl_envs.sb3_vec_env import AgentVecEnv

from tests.envs.learning import MAX_CYCLES, N_AGENTS, distances_before_and_after_learning

tasks = pytest.mark.parametrize("name", TASKS)
both_actions = pytest.mark.parametrize("continuous", [True, False], ids=["box", "discrete"])


class LoneAgentEnv(gymnasium.Env[NDArray[np.float32], Any]):
    """A team of one as an ordinary Gymnasium environment, for SB3's DummyVecEnv."""

    def __init__(self, task: Task, max_cycles: int) -> None:
        self.env = TaskParallelEnv(task, max_cycles)
        self.observation_space = self.env.observation_space("agent_0")
        self.action_space = self.env.action_space("agent_0")

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        return self.env.reset(seed)[0]["agent_0"], {}

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        observations, rewards, terminations, truncations, infos = self.env.step({"agent_0": action})
        agent = "agent_0"
        return observations[agent], rewards[agent], terminations[agent], truncations[agent], infos[agent]


def steered(task: Task, observation: NDArray[np.float32], noise: NDArray[np.float32]) -> NDArray[Any]:
    """(entries, 2) noise -> actions. Navigation drives to its goals, so episodes end at different times."""
    if task.name != "blind_navigation_v0":
        return nearest_actions(task, noise)
    pull = -4 * observation[:, 4:6] - 2 * observation[:, 2:4]
    if not task.continuous_actions:
        return nearest_actions(task, 10 * pull)  # hard along the longer of the two ways
    return np.clip(pull + 0.1 * noise, -1, 1)


@both_actions
def test_the_peer_passes_sb3_s_check(continuous: bool) -> None:
    check_env(LoneAgentEnv(make_task("blind_navigation_v0", 1, continuous_actions=continuous), 20))


@pytest.mark.slow
@tasks
@both_actions
def test_teams_of_one_equal_sb3_s_dummy_vec_env(name: str, continuous: bool) -> None:
    """Every bit of observations, rewards, dones and infos, over terminations and truncations."""
    task = make_task(name, 1, continuous_actions=continuous)
    peer = DummyVecEnv([lambda: LoneAgentEnv(task, 30)] * 6)
    ours = AgentVecEnv(task, 6, max_cycles=30)
    assert ours.observation_space == peer.observation_space
    assert ours.action_space == peer.action_space
    rng, n_done, n_truncated = np.random.default_rng(0), 0, 0
    observation: Any
    for seed in (3, None):  # a reset without a seed draws the next seeds
        if seed is not None:
            assert ours.seed(seed) == peer.seed(seed)
        expected, observation = peer.reset(), ours.reset()
        for _ in range(100):
            np.testing.assert_array_equal(observation, expected)
            action = steered(task, observation, rng.uniform(-1, 1, (6, 2)).astype(np.float32))
            expected, expected_reward, expected_done, expected_infos = peer.step(action)
            observation, reward, done, infos = ours.step(action)
            for mine, other in ((reward, expected_reward), (done, expected_done)):
                assert mine.dtype == other.dtype
                np.testing.assert_array_equal(mine, other)
            for info, expected_info, over in zip(infos, expected_infos, done, strict=True):
                assert info.pop("is_success", None) == (info[task.success_key] if over else None)
                last, expected_last = (i.pop("terminal_observation", None) for i in (info, expected_info))
                np.testing.assert_array_equal(last, expected_last)
                assert info == expected_info
                n_truncated += info["TimeLimit.truncated"]
            n_done += int(done.sum())
    assert n_truncated > 0
    assert n_done > n_truncated or name != "blind_navigation_v0"


@tasks
@both_actions
def test_entries_are_ordered_by_team_and_agent(name: str, continuous: bool) -> None:
    task = make_task(name, 3, continuous_actions=continuous)
    env = AgentVecEnv(task, 4, seed=20, max_cycles=45)
    teams = [TaskParallelEnv(task, 45) for _ in range(4)]
    ends: list[list[bool]] = []
    observation: Any = env.reset()
    expected = [team.reset(seed=20 + k)[0] for k, team in enumerate(teams)]
    rng = np.random.default_rng(1)
    for _ in range(100):
        np.testing.assert_array_equal(observation, [seen for team in expected for seen in team.values()])
        action = steered(task, observation, rng.uniform(-1, 1, (12, 2)).astype(np.float32))
        observation, reward, done, infos = env.step(action)
        for k, team in enumerate(teams):
            seen, rewards, terminated, truncated, info = team.step(
                dict(zip(team.agents, action[3 * k : 3 * k + 3], strict=True))
            )
            over = terminated["agent_0"] or truncated["agent_0"]
            for i, agent in enumerate(team.possible_agents):
                entry = 3 * k + i
                assert (reward[entry], done[entry]) == (np.float32(rewards[agent]), over)
                assert info[agent].items() <= infos[entry].items()
                assert infos[entry]["TimeLimit.truncated"] == truncated[agent]
                assert ("terminal_observation" in infos[entry]) == over
                if over:
                    np.testing.assert_array_equal(infos[entry]["terminal_observation"], seen[agent])
                    assert infos[entry]["is_success"] == info[agent][team.task.success_key]
            expected[k] = team.reset()[0] if over else seen
        ends.append(done[::3].tolist())
    assert all(any(ended[k] for ended in ends) for k in range(4))
    if name == "blind_navigation_v0":
        assert any(any(ended) and not all(ended) for ended in ends)  # teams end at different times


@pytest.mark.training
@both_actions
def test_ppo_with_shared_parameters_gets_nearer_to_the_goals(continuous: bool) -> None:
    task = make_task("blind_navigation_v0", N_AGENTS, continuous_actions=continuous)
    env = AgentVecEnv(task, 16, max_cycles=MAX_CYCLES, copies_per_space=64)
    before, after = distances_before_and_after_learning(env)
    assert before > 1.0
    assert after < 0.8 * before  # measured: 0.33 to 0.39 times over three seeds


@both_actions
def test_a_seeded_ppo_repeats_and_another_seed_differs(continuous: bool) -> None:
    weights = []
    for seed in (5, 5, 6):
        model = PPO(
            "MlpPolicy",
            AgentVecEnv(make_task("blind_passage_v0", continuous_actions=continuous), 2),
            n_steps=32,
            batch_size=64,
            n_epochs=1,
            seed=seed,
            device="cpu",
        )
        model.learn(192)
        weights.append(model.policy.state_dict()["action_net.weight"].numpy().copy())
    np.testing.assert_array_equal(weights[0], weights[1])
    assert (weights[0] != weights[2]).any()


@pytest.mark.slow
def test_sb3_s_wrappers_saving_and_other_algorithms_work(tmp_path: Path) -> None:
    env = VecNormalize(VecMonitor(AgentVecEnv(make_task("blind_discovery_v0"), 2, seed=0, max_cycles=10)))
    model = SAC("MlpPolicy", env, learning_starts=30, batch_size=32, seed=0, device="cpu")
    model.learn(120)
    assert model.ep_info_buffer is not None and model.ep_success_buffer is not None
    assert {episode["l"] for episode in model.ep_info_buffer} == {10}
    assert len(model.ep_success_buffer) == 12  # 20 cycles, episodes of 10, two teams of three
    model.save(tmp_path / "model")
    observation = env.reset()
    assert isinstance(observation, np.ndarray)
    again = SAC.load(tmp_path / "model", env, device="cpu")
    np.testing.assert_array_equal(
        again.predict(observation, deterministic=True)[0], model.predict(observation, deterministic=True)[0]
    )


def test_a_step_needs_an_episode() -> None:
    env = AgentVecEnv(make_task("blind_navigation_v0"), 2)
    with pytest.raises(ValueError, match="call reset first"):
        env.step(np.zeros((6, 2)))
    env.reset()
    env.step(np.zeros((6, 2)))


def test_unseeded_environments_differ() -> None:
    starts = [AgentVecEnv(make_task("blind_navigation_v0"), 2).reset() for _ in range(2)]
    assert len(np.unique(np.concatenate(starts), axis=0)) == 12
