"""The heuristic made to be imitated: it solves navigation without touching, with noise on its actions too."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from xmarl_envs import BlindNavigation, State
from xmarl_envs.heuristics.wide_berth import ASIDE, AWAY, NEAR, SIGHT, push, wide_berth

from tests.envs.played import noisy, play

EPISODES = 50


@pytest.mark.parametrize(("n_agents", "noise"), [(3, 0.0), (3, 0.15), (5, 0.0)])
def test_it_solves_the_task_and_nobody_touches(n_agents: int, noise: float) -> None:
    played = play(BlindNavigation(n_agents), noisy(wide_berth, noise), EPISODES)
    assert played.success >= 0.98
    assert played.touched <= 0.02


def test_the_push_by_hand() -> None:
    east_of_it = push(np.array([[[0.0, 0.0], [NEAR, 0.0]]]))[0]
    np.testing.assert_allclose(east_of_it, [[-AWAY, ASIDE], [AWAY, -ASIDE]], atol=1e-12)
    half = push(np.array([[[0.0, 0.0], [0.0, (NEAR + SIGHT) / 2]]]))[0]
    np.testing.assert_allclose(half[1], [ASIDE / 2, AWAY / 2], atol=1e-12)  # clockwise of north is east
    beyond = push(np.array([[[0.0, 0.0], [SIGHT, 0.0]]]))
    assert not beyond.any()


@given(st.integers(0, 2**32 - 1))
def test_pushes_add_up_and_are_equal_and_opposite(seed: int) -> None:
    position = np.random.default_rng(seed).uniform(-0.4, 0.4, (1, 4, 2))
    pairs = np.zeros((1, 4, 2))
    for i in range(4):
        for j in range(i):
            pairs[:, [i, j]] += push(position[:, [i, j]])
    np.testing.assert_allclose(push(position), pairs, atol=1e-9)
    np.testing.assert_allclose(pairs.sum(axis=1), 0.0, atol=1e-9)


def test_actions_are_in_range_even_where_two_agents_stand_in_one_place() -> None:
    position = np.zeros((1, 2, 2))
    state = State(position, np.zeros_like(position), np.ones_like(position), np.zeros((1, 0, 2)))
    action = wide_berth(BlindNavigation(2), state)
    assert np.isfinite(action).all() and np.abs(action).max() <= 1.0
