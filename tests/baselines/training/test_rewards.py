"""The reward that the trainer optimises, and the reward that it reports."""

from __future__ import annotations

import numpy as np
import pytest
from xmarl_baselines.training.search import Search
from xmarl_baselines.training.shaping import Shaping, distance_through_gap, training_reward
from xmarl_baselines.training.team_vec_env import TeamVecEnv
from xmarl_envs import TASKS, BlindDiscovery, BlindPassage, State, VectorEnv, make_task


def test_teams_report_the_reward_of_the_task_not_the_shaped_one() -> None:
    env = TeamVecEnv(make_task("blind_passage_v0"), 4, seed=0, max_cycles=5, shaping=Shaping(scale=0.0))
    env.reset()
    returns = []
    for _ in range(5):
        env.step_async(np.ones((4, 3, 2), np.float32))
        _, reward, _, infos = env.step_wait()
        assert (reward == 0).all()
        returns += [info["episode"]["r"] for info in infos if "episode" in info]
    assert len(returns) == 4
    assert all(value != 0 for value in returns)


def test_without_shaping_the_trainer_sees_the_reward_of_the_task() -> None:
    for name in TASKS:
        env = VectorEnv(make_task(name), 16)
        env.reset(range(16))
        rng = np.random.default_rng(0)
        for _ in range(40):
            before = env.world.position.copy()
            step = env.step(rng.uniform(-1, 1, (16, 3, 2)))
            shaped = training_reward(env.task, Shaping(), before, env.state, step)
            np.testing.assert_allclose(shaped, step.reward, atol=1e-12)


def test_proximity_is_one_at_contact_and_zero_out_of_range() -> None:
    task = make_task("blind_navigation_v0")
    env = VectorEnv(task, 1)
    env.reset([0])
    step = env.step(np.zeros((1, 3, 2)))
    shaping = Shaping(proximity_penalty=2.0, proximity_range=0.4)
    position = np.array([[[0.0, 0.0], [0.4, 0.0], [5.0, 0.0]]])  # surfaces 0.2 m apart: half way
    state = State(position, np.zeros_like(position), position.copy(), np.zeros((1, 0, 2)))
    near = training_reward(task, shaping, position, state, step)
    far = training_reward(task, Shaping(), position, state, step)
    np.testing.assert_allclose(near - far, [[-1.0, -1.0, 0.0]])


def test_a_penalty_of_the_wall_alone_replaces_the_tasks() -> None:
    task = make_task("blind_passage_v0")
    env = VectorEnv(task, 1)
    env.reset([0])
    before, step = env.state.position.copy(), env.step(np.zeros((1, 3, 2)))
    step = step._replace(object_collision=np.array([[1.0, 0.0, 0.0]]))
    none, three = (
        training_reward(task, Shaping(wall_penalty=penalty), before, env.state, step)
        for penalty in (0.0, 3.0)
    )
    np.testing.assert_allclose(none - three, [[3.0, 0.0, 0.0]])


def test_the_distance_through_the_gap() -> None:
    task = BlindPassage(n_agents=1)
    walls = np.array([[[-1.2515, 0.0], [1.2515, 0.0]]])  # the gap is at x = 0
    goal = np.array([[[0.0, 0.5]]])

    def way(x: float, y: float) -> float:
        position = np.array([[[x, y]]])
        state = State(position, np.zeros_like(position), goal, walls)
        return float(distance_through_gap(task, position, state)[0, 0])

    assert way(0.0, -0.5) == pytest.approx(1.0)  # straight below the gap it is the straight line
    assert way(0.0, 0.0) == pytest.approx(0.5)
    assert way(0.3, 0.5) == pytest.approx(0.3)
    assert way(0.5, -0.2) > way(0.2, -0.2) > way(0.0, -0.2)


def test_an_agent_is_paid_for_what_it_senses_first() -> None:
    """Of 256 points 0.125 m apart, 24 are within 0.35 m of the middle, and 6 of a corner."""
    search = Search(BlindDiscovery(n_agents=3), 2)
    middle, corner, other = [0.0, 0.0], [1.0, 1.0], [-1.0, -1.0]
    alone, together = [middle, corner, other], [middle, middle, other]
    np.testing.assert_array_equal(
        256 * search.newly_sensed(np.array([alone, together])), [[24, 6, 6], [24, 24, 6]]
    )
    again = 256 * search.newly_sensed(np.array([alone, alone]))
    np.testing.assert_array_equal(again, [[0, 0, 0], [0, 6, 0]])
    search.begin(np.array([1]))
    np.testing.assert_array_equal(
        256 * search.newly_sensed(np.array([alone, alone])), [[0, 0, 0], [24, 6, 6]]
    )


def test_an_agent_at_rest_is_paid_once_in_an_episode_for_where_it_starts() -> None:
    task = BlindDiscovery(n_agents=1)
    env = TeamVecEnv(task, 1, seed=0, max_cycles=3, shaping=Shaping(scale=0.5, search_reward=3.0))
    place, paid, expected, ended = env.reset()[..., :2], [], [], [True]
    for _ in range(9):
        share = Search(task, 1).newly_sensed(place)[0, 0]
        env.step_async(np.zeros((1, 1, 2), np.float32))
        observation, reward, done, _ = env.step_wait()
        place = observation[..., :2]
        paid.append(reward[0, 0])
        expected.append(0.5 * 3.0 * share * ended[-1])
        ended.append(done[0])
    np.testing.assert_allclose(paid, expected, rtol=1e-6)
    assert sum(ended) >= 3
