"""The batch: shapes, seeds, single resets, and copies that share a Space."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from xmarl_envs import TASKS, Step, VectorEnv, make_task

tasks = pytest.mark.parametrize("name", TASKS)


@tasks
def test_shapes_and_types(name: str) -> None:
    task = make_task(name, 4)
    env = VectorEnv(task, 6, copies_per_space=4)  # the last Space is not full
    assert env.reset(range(6)).shape == (6, 4, task.obs_dim)
    step = env.step(np.zeros((6, 4, 2)))
    shapes = {field: getattr(step, field).shape for field in Step._fields}
    assert shapes == {
        "observation": (6, 4, task.obs_dim),
        "reward": (6, 4),
        "terminated": (6,),
        "truncated": (6,),
        "success": (6, 4),
        "agent_collision": (6, 4),
        "object_collision": (6, 4),
    }
    assert step.observation.dtype == np.float32
    assert step.reward.dtype == np.float64
    assert {getattr(step, field).dtype for field in Step._fields[2:]} == {np.dtype(np.bool_)}


@pytest.mark.slow
@tasks
@pytest.mark.parametrize("copies", [8, 64])
def test_copies_in_one_space_agree_with_spaces_of_their_own(name: str, copies: int) -> None:
    """To 1e-9 until the first contact, which comes at different times in the episodes."""
    task = make_task(name, 3)
    own, shared = VectorEnv(task, 64), VectorEnv(task, 64, copies_per_space=copies)
    own.reset(range(64))
    shared.reset(range(64))
    rng = np.random.default_rng(0)
    free: NDArray[np.bool_] = np.ones(64, dtype=np.bool_)
    for _ in range(60):
        action = rng.uniform(-1, 1, (64, 3, 2))
        step = own.step(action)
        shared.step(action)
        touched = step.agent_collision | step.object_collision
        if task.bound is not None:
            touched |= np.abs(own.state.position).max(axis=-1) > task.bound - 1e-3
        free &= ~touched.any(axis=1)
        for mine, other in zip(own.state[:2], shared.state[:2], strict=True):
            np.testing.assert_allclose(mine[free], other[free], rtol=0, atol=1e-9)
    assert free.sum() > 16


@tasks
def test_resetting_one_copy_does_not_change_the_others(name: str) -> None:
    envs = [VectorEnv(make_task(name, 3), 8, copies_per_space=8) for _ in range(2)]
    for env in envs:
        env.reset(range(8))
    for cycle in range(10):
        if cycle == 5:
            envs[0].reset([77], [2])
            assert envs[0].cycles.tolist() == [5, 5, 0, 5, 5, 5, 5, 5]
        for env in envs:
            env.step(np.zeros((8, 3, 2)))
    neighbours = np.arange(8) != 2
    positions = [env.state.position for env in envs]
    np.testing.assert_allclose(positions[0][neighbours], positions[1][neighbours], rtol=0, atol=1e-9)
    expected = VectorEnv(make_task(name, 3))
    start = expected.reset([77])
    np.testing.assert_allclose(envs[0].observe()[2], start[0], rtol=0, atol=1e-6)


def test_episodes_that_are_not_live_may_stand_still() -> None:
    env = VectorEnv(make_task("blind_navigation_v0", 3), 2)
    env.reset([0, 1])
    before = env.state.position.copy()
    for _ in range(2):  # a body at rest moves from the second step on
        env.step(np.ones((2, 3, 2)), live=np.array([True, False]))
    assert (env.state.position[0] != before[0]).all()
    np.testing.assert_array_equal(env.state.position[1], before[1])


def test_a_terminated_team_is_not_truncated() -> None:
    env = VectorEnv(make_task("blind_navigation_v0", 3), 2, max_cycles=1)
    env.reset([0, 1])
    env.world.place(np.array([0]), env.state.targets[:1], np.zeros((1, 0, 2)))
    step = env.step(np.zeros((2, 3, 2)))
    assert step.terminated.tolist() == [True, False]
    assert step.truncated.tolist() == [False, True]


def test_actions_outside_the_box_are_clipped() -> None:
    positions = []
    for thrust in (1.0, 5.0):
        env = VectorEnv(make_task("blind_navigation_v0", 3))
        env.reset([0])
        env.step(np.full((1, 3, 2), thrust))
        env.step(np.zeros((1, 3, 2)))
        positions.append(env.state.position.copy())
    np.testing.assert_array_equal(positions[0], positions[1])


@pytest.mark.parametrize(
    ("action", "sentence"),
    [
        (np.zeros((2, 3, 3)), r"actions must have shape \(2, 3, 2\), got \(2, 3, 3\)\."),
        (np.zeros((3, 2)), r"actions must have shape \(2, 3, 2\), got \(3, 2\)\."),
        (
            np.full((2, 3, 2), np.nan),
            "actions of blind_navigation_v0 must be finite numbers, got NaN or infinity",
        ),
        (
            np.full((2, 3, 2), np.inf),
            "actions of blind_navigation_v0 must be finite numbers, got NaN or infinity",
        ),
    ],
)
def test_invalid_actions_are_refused(action: NDArray[np.float64], sentence: str) -> None:
    env = VectorEnv(make_task("blind_navigation_v0", 3), 2)
    env.reset([0, 1])
    with pytest.raises(ValueError, match=sentence):
        env.step(action)


def test_a_wrong_number_of_seeds_is_refused() -> None:
    env = VectorEnv(make_task("blind_navigation_v0", 3), 3)
    with pytest.raises(ValueError, match="each episode needs one seed: got 2 seeds for 3 episodes"):
        env.reset([0, 1])


@pytest.mark.parametrize("episodes", [[3], [-1], [0.5], [True, False, True]])
def test_episodes_that_do_not_exist_are_refused(episodes: list[float]) -> None:
    env = VectorEnv(make_task("blind_navigation_v0", 3), 3)
    env.reset([0, 1, 2])
    with pytest.raises(ValueError, match="episodes must be whole numbers from 0 to 2"):
        env.reset(range(len(episodes)), episodes)


@pytest.mark.parametrize(("n_episodes", "copies"), [(0, 1), (1, 0)])
def test_an_empty_batch_is_refused(n_episodes: int, copies: int) -> None:
    with pytest.raises(ValueError, match="n_episodes and copies_per_space must be at least 1"):
        VectorEnv(make_task("blind_navigation_v0", 3), n_episodes, copies_per_space=copies)


def test_episodes_in_which_agents_could_reach_another_copy_are_refused() -> None:
    """At full speed, 0.373 m/s, from the corner at 1 m to the middle between copies, at 32 m: 831 cycles."""
    task = make_task("blind_navigation_v0", 2)
    VectorEnv(task, 4, 830, copies_per_space=4)
    VectorEnv(task, 4, 10**6)
    VectorEnv(make_task("blind_discovery_v0", 2), 4, 10**6, copies_per_space=4)  # has a border
    with pytest.raises(ValueError, match="may have at most 830 cycles"):
        VectorEnv(task, 4, 831, copies_per_space=4)


@tasks
def test_an_episode_restarted_in_the_middle_goes_on_to_the_bit(name: str) -> None:
    """While nothing touches: a Space then holds nothing but positions and velocities."""
    env = VectorEnv(make_task(name, 1), 1)
    action = np.array([[[0.3, -0.8]]])
    env.reset([4])
    for _ in range(5):
        env.step(action)
    copies = VectorEnv(make_task(name, 1), 2)
    copies.reset([8, 9])
    position, velocity = (np.repeat(each, 2, axis=0) for each in env.state[:2])
    observation = copies.restart(4, position, velocity)
    assert np.array_equal(observation, np.repeat(env.observe(), 2, axis=0))
    assert np.abs(velocity).min() > 0.0
    for _ in range(5):
        one, two = env.step(action), copies.step(np.repeat(action, 2, axis=0))
        for field in Step._fields:
            assert np.array_equal(getattr(two, field), np.repeat(getattr(one, field), 2, axis=0))
    assert copies.cycles.tolist() == [5, 5]
