"""The heuristic made to be imitated: it solves passage without touching, with noise on its actions too."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from xmarl_envs import BlindPassage, State
from xmarl_envs.heuristics.ladder import FAR_FIRST, RIGHT_FIRST, RUNG, SPEED, ladder, precedence
from xmarl_envs.heuristics.steering import force

from tests.envs.played import noisy, play

EPISODES = 50


@pytest.mark.parametrize(("n_agents", "noise"), [(3, 0.0), (4, 0.15), (5, 0.0), (5, 0.15)])
def test_it_solves_the_task_and_nobody_touches(n_agents: int, noise: float) -> None:
    played = play(BlindPassage(n_agents), noisy(ladder, noise), EPISODES)
    assert played.success >= 0.98
    assert played.touched <= 0.02


def test_the_order_by_hand() -> None:
    goals = np.array([[[0.5, 0.6], [0.6, 0.5], [0.5, 0.5], [0.4, 0.5], [0.5, 0.4]]])
    left, right = precedence(goals, np.array([[[-0.2, 0.0]]])), precedence(goals, np.array([[[0.9, 0.0]]]))
    assert left[0, 1] == pytest.approx(0.5 + (FAR_FIRST + RIGHT_FIRST) * 0.8)
    assert np.argsort(-left[0]).tolist() == [0, 1, 2, 3, 4]  # top, far from the gap, middle, near, bottom
    assert np.argsort(-right[0]).tolist() == [0, 3, 2, 1, 4]


def two_below(lower_by: float, beside: float = 0.0) -> State:
    """Agent 0 goes first; both stand at rest beside the column below the gap at x = 0."""
    position = np.array([[[0.3, -0.5], [0.3 + beside, -0.5 - lower_by]]])
    targets = np.array([[[0.3, 0.6], [0.3, 0.5]]])
    walls = np.array([[[-1.2515, 0.0], [1.2515, 0.0]]])
    return State(position, np.zeros_like(position), targets, walls)


def test_who_is_a_rung_below_rests_there_and_moves_to_the_column() -> None:
    task = BlindPassage(2)
    action = ladder(task, two_below(RUNG))[0]
    both_at_once = SPEED / np.sqrt(2)
    np.testing.assert_allclose(action[0], force(task, np.array([-both_at_once, both_at_once]), np.zeros(2)))
    np.testing.assert_allclose(action[1], force(task, np.array([-SPEED, 0.0]), np.zeros(2)), atol=1e-12)


def test_who_is_level_with_one_before_it_sinks_and_waits() -> None:
    level = ladder(BlindPassage(2), two_below(0.0, beside=0.14))[0]
    assert level[1, 1] < 0 and level[1, 0] == 0
    assert level[0, 1] > 0 and level[0, 0] < 0  # the first does not wait


@given(st.integers(0, 2**32 - 1))
def test_actions_are_in_range_and_do_not_depend_on_how_agents_are_numbered(seed: int) -> None:
    rng = np.random.default_rng(seed)
    task = BlindPassage(4)
    layout = task.spawn(rng)
    position = rng.uniform(-1.0, 1.0, (1, 4, 2))
    state = State(position, rng.normal(0, 0.1, (1, 4, 2)), layout.targets[None], layout.walls[None])
    action = ladder(task, state)
    assert np.isfinite(action).all() and np.abs(action).max() <= 1.0
    other = rng.permutation(4)
    shuffled = State(position[:, other], state.velocity[:, other], state.targets[:, other], state.walls)
    np.testing.assert_allclose(ladder(task, shuffled), action[:, other], atol=1e-12)
