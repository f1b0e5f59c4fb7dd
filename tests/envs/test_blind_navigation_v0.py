"""Blind navigation, computed by hand: observations, rewards, endings and starts."""

from __future__ import annotations

import numpy as np
import pytest
from xmarl_envs import BlindNavigation, State, VectorEnv

from tests.envs.layouts import NO_WALLS, closest_pair, row

GOALS = row([1, 0], [0, 1], [-1, 0])


def state(*agents: list[float]) -> State:
    return State(row(*agents), np.zeros((1, len(agents), 2)), GOALS[:, : len(agents)], NO_WALLS)


def test_observation_is_position_velocity_and_offset_from_the_goal() -> None:
    seen = BlindNavigation(2).observe(
        State(row([0.5, 2.0], [3.0, 4.0]), row([0.1, 0.2], [0.3, 0.4]), row([1, 0], [0, 1]), NO_WALLS)
    )
    np.testing.assert_allclose(seen, [[[0.5, 2, 0.1, 0.2, -0.5, 2], [3, 4, 0.3, 0.4, 3, 3]]])


def test_the_team_is_paid_the_sum_of_distances_gained() -> None:
    before, after = row([0.0, 0.0], [0.0, 0.0], [0.0, 0.0]), state([0.3, 0.0], [0.0, -0.5], [0.0, 0.0])
    outcome = BlindNavigation(3).judge(before, after, np.zeros((1, 3)))
    np.testing.assert_allclose(outcome.reward, [[-0.2, -0.2, -0.2]])  # + 0.3 - 0.5 + 0
    assert not outcome.done[0]
    assert not outcome.success.any()


def test_each_colliding_partner_costs_one() -> None:
    still = state([0.0, 0.0], [0.0, 0.0], [0.0, 0.0])
    outcome = BlindNavigation(3).judge(still.position, still, np.array([[2.0, 1.0, 0.0]]))
    np.testing.assert_allclose(outcome.reward, [[-2.0, -1.0, 0.0]])


@pytest.mark.parametrize(("short_of", "arrived"), [(0.099, True), (0.101, False)])
def test_all_within_a_tenth_of_a_metre_is_done_and_paid(short_of: float, arrived: bool) -> None:
    at = state([1 - short_of, 0.0], [0.0, 1.05], [-1.0, 0.0])
    outcome = BlindNavigation(3).judge(at.position, at, np.zeros((1, 3)))
    np.testing.assert_array_equal(outcome.success, [[arrived, True, True]])
    assert outcome.done[0] == arrived
    np.testing.assert_allclose(outcome.reward, 0.01 if arrived else 0.0)
    assert not outcome.object_collision.any()


@pytest.mark.parametrize(("gap", "collides"), [(0.0049, True), (0.0051, False)])
def test_surfaces_within_five_millimetres_collide(gap: float, collides: bool) -> None:
    env = VectorEnv(BlindNavigation(3))
    env.reset([0])
    middle = 0.2 + gap
    env.world.place(np.array([0]), row([0.0, 0.0], [middle, 0.0], [2 * middle, 0.0]), NO_WALLS)
    potential = np.linalg.norm(env.state.position - env.state.targets, axis=-1).sum()
    step = env.step(np.zeros((1, 3, 2)))
    assert step.agent_collision.tolist() == [[collides] * 3]
    gained = potential - np.linalg.norm(env.state.position - env.state.targets, axis=-1).sum()
    penalty = np.array([[1.0, 2.0, 1.0]]) if collides else np.zeros((1, 3))  # the one in the middle has two
    np.testing.assert_allclose(step.reward, gained - penalty, atol=1e-12)


@pytest.mark.parametrize(("n_agents", "half_width"), [(3, 1.0), (8, 1.0), (18, 1.5), (64, 8**0.5)])
def test_agents_and_goals_begin_apart_in_the_square(n_agents: int, half_width: float) -> None:
    task = BlindNavigation(n_agents)
    layouts = [task.spawn(np.random.default_rng(seed)) for seed in range(20 if n_agents < 64 else 3)]
    for agents, goals, walls in layouts:
        assert agents.shape == goals.shape == (n_agents, 2)
        assert walls.shape == (0, 2)
        points = np.concatenate([agents, goals])
        assert np.abs(points).max() <= half_width
        assert closest_pair(points) >= 0.25
    everywhere = np.concatenate([np.concatenate(layout[:2]) for layout in layouts])
    assert np.abs(everywhere).max() > 0.9 * half_width
