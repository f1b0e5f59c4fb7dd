"""Discrete actions are MPE2's five, each a push at full force."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given
from hypothesis import strategies as st
from mpe2 import simple_v3
from numpy.typing import NDArray
from xmarl_envs import TASKS, TaskParallelEnv, VectorEnv, make_task
from xmarl_envs.actions import action_space, nearest_actions, random_actions, team_action_space
from xmarl_envs.task import PUSHES

tasks = pytest.mark.parametrize("name", TASKS)
NAVIGATION = make_task("blind_navigation_v0", 3, continuous_actions=False)


@pytest.mark.parametrize("number", range(5))
def test_the_numbers_mean_the_same_as_in_mpe2(number: int) -> None:
    """The same number moves our agent and MPE2's in the same direction."""
    theirs, ours = (
        simple_v3.parallel_env(),
        TaskParallelEnv(make_task("blind_navigation_v0", 1, continuous_actions=False)),
    )
    theirs.reset(seed=0), ours.reset(seed=0)
    assert ours.action_space("agent_0") == theirs.action_space("agent_0") == spaces.Discrete(5)
    their_velocity = theirs.step({"agent_0": number})[0]["agent_0"][:2]
    our_velocity = ours.step({"agent_0": number})[0]["agent_0"][2:4]
    np.testing.assert_array_equal(np.sign(our_velocity), np.sign(their_velocity))
    np.testing.assert_array_equal(np.sign(our_velocity), PUSHES[number])


@pytest.mark.slow
@tasks
@pytest.mark.parametrize("copies", [1, 8])
def test_an_episode_equals_that_of_the_same_pushes_bit_for_bit(name: str, copies: int) -> None:
    envs = [
        VectorEnv(make_task(name, 3, continuous_actions=continuous), 8, copies_per_space=copies)
        for continuous in (True, False)
    ]
    rng = np.random.default_rng(0)
    for env in envs:
        env.reset(range(8))
    held: NDArray[Any] = np.empty(0)
    for cycle in range(60):
        if cycle % 10 == 0:
            held = random_actions(envs[1].task, 8, rng)
        steps = [envs[0].step(PUSHES[held]), envs[1].step(held)]
        for one, other in zip(*steps, strict=True):
            np.testing.assert_array_equal(one, other)
    assert np.abs(envs[1].state.velocity).max() > 0.1


def test_spaces_and_random_actions() -> None:
    assert action_space(NAVIGATION) == spaces.Discrete(5)
    assert team_action_space(NAVIGATION) == spaces.MultiDiscrete([5, 5, 5])
    drawn = random_actions(NAVIGATION, 400, np.random.default_rng(0))
    assert drawn.shape == (400, 3)
    assert np.bincount(drawn.ravel(), minlength=5).min() > 150  # about 240 of each
    continuous = make_task("blind_navigation_v0", 3)
    box = random_actions(continuous, 1000, np.random.default_rng(0))
    assert box.shape == (1000, 3, 2) and -1 <= box.min() < -0.99 and 0.99 < box.max() <= 1


@given(st.lists(st.floats(-1, 1), min_size=6, max_size=6))
def test_the_nearest_action_is_the_nearest_push(numbers: list[float]) -> None:
    wanted = np.array(numbers).reshape(3, 2)
    chosen = nearest_actions(NAVIGATION, wanted)
    for push, number in zip(wanted, chosen, strict=True):
        distances = [np.linalg.norm(push - each) for each in PUSHES]
        assert distances[number] == pytest.approx(min(distances), abs=1e-12)
    assert nearest_actions(make_task("blind_navigation_v0", 3), wanted) is wanted


@pytest.mark.parametrize(
    ("bad", "got"),
    [
        (np.array([[0, 1, 5]]), "0 to 5"),
        (np.array([[0, -1, 4]]), "-1 to 4"),
        (np.array([[0.0, 1.0, 2.0]]), "numbers of type float64"),
        (np.array([[True, False, True]]), "numbers of type bool"),
    ],
)
def test_invalid_action_numbers_are_refused(bad: NDArray[Any], got: str) -> None:
    env = VectorEnv(NAVIGATION)
    env.reset([0])
    with pytest.raises(
        ValueError,
        match=f"with continuous_actions=False must be whole numbers from 0 to 4, got {got}.",
    ):
        env.step(bad)


@pytest.mark.parametrize(
    ("bad", "sentence"),
    [
        (5, r"must be whole numbers from 0 to 4, got 0 to 5\."),
        (0.5, r"must be whole numbers from 0 to 4, got numbers of type float64\."),
        (None, r"must be whole numbers from 0 to 4, got numbers of type object\."),
        (np.zeros(2), r"the action of agent_1 must have shape \(\), got \(2,\)\."),
    ],
)
def test_an_agent_s_invalid_action_is_refused_and_leaves_the_episode_unchanged(
    bad: Any, sentence: str
) -> None:
    env = TaskParallelEnv(NAVIGATION)
    env.reset(seed=0)
    before = env.state()
    with pytest.raises(ValueError, match=sentence):
        env.step({"agent_0": 0, "agent_1": bad, "agent_2": 0})
    with pytest.raises(ValueError, match="every live agent needs an action, none was given for agent_2"):
        env.step({"agent_0": 0, "agent_1": 1})
    np.testing.assert_array_equal(env.state(), before)


def test_numbers_are_refused_by_a_box_and_vectors_by_discrete_actions() -> None:
    env = VectorEnv(make_task("blind_navigation_v0", 3))
    with pytest.raises(ValueError, match=r"actions must have shape \(1, 3, 2\), got \(1, 3\)"):
        env.step(np.zeros((1, 3), dtype=np.int64))
    with pytest.raises(ValueError, match=r"actions must have shape \(1, 3\), got \(1, 3, 2\)"):
        VectorEnv(NAVIGATION).step(np.zeros((1, 3, 2)))
