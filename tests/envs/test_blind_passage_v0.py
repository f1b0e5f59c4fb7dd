"""Blind passage, computed by hand: observations, rewards, endings and starts."""

from __future__ import annotations

import numpy as np
import pytest
from xmarl_envs import BlindPassage, State, VectorEnv
from xmarl_envs.blind_passage_v0 import SLOTS

from tests.envs.layouts import Floats, row

R = 0.03333
WALLS = row([-1.2515, 0.0], [1.2515, 0.0])  # 2.4 m long each: the gap, 0.103 m wide, is in the middle
GOALS = row([0.0, 0.5], [0.1, 0.5])


def state(*agents: list[float]) -> State:
    return State(row(*agents), np.zeros((1, len(agents), 2)), GOALS[:, : len(agents)], WALLS)


def test_observation_is_position_velocity_and_offsets_to_goal_and_gap() -> None:
    velocity = row([0.1, 0.2], [0.3, 0.4])
    walls = row([-1.0515, 0.0], [1.4515, 0.0])  # the gap's middle is at x = 0.2
    seen = BlindPassage(2).observe(State(row([0.5, -0.6], [0.0, -0.7]), velocity, GOALS, walls))
    expected = [[0.5, -0.6, 0.1, 0.2, -0.5, 1.1, -0.3, 0.6], [0, -0.7, 0.3, 0.4, 0.1, 1.2, 0.2, 0.7]]
    np.testing.assert_allclose(seen, [expected], atol=1e-15)


@pytest.mark.parametrize(("shared", "reward"), [(False, [30.0, -10.0]), (True, [20.0, 20.0])])
def test_a_metre_gained_pays_a_hundred(shared: bool, reward: list[float]) -> None:
    before, after = row([0.0, -0.5], [0.1, -0.5]), state([0.0, -0.2], [0.1, -0.6])
    outcome = BlindPassage(2, shared_reward=shared).judge(before, after, np.zeros((1, 2)))
    np.testing.assert_allclose(outcome.reward, [reward])
    assert not outcome.done[0]


def test_partners_and_the_wall_cost_ten_each() -> None:
    at = state([0.5, -0.1 - R], [0.1, -0.5])
    outcome = BlindPassage(2).judge(at.position, at, np.array([[2.0, 1.0]]))
    np.testing.assert_allclose(outcome.reward, [[-30.0, -10.0]])
    assert outcome.object_collision.tolist() == [[True, False]]


@pytest.mark.parametrize(
    ("agent", "touches"),
    [
        ([0.5, -0.1 - R - 0.0009], True),  # below the wall
        ([0.5, -0.1 - R - 0.0011], False),
        ([-0.5, 0.1 + R + 0.0009], True),  # above it
        ([-0.5, 0.1 + R + 0.0011], False),
        ([0.0, 0.0], False),  # in the gap: 18 mm of clearance on both sides
        ([0.0515 - R - 0.0009, 0.0], True),
        ([-0.0515 + R + 0.0011, 0.05], False),
        (
            [0.0515 - 0.6 * (R + 0.0009), -0.1 - 0.8 * (R + 0.0009)],
            True,
        ),  # at a corner, beyond both of its sides
        ([0.0515 - 0.6 * (R + 0.0011), -0.1 - 0.8 * (R + 0.0011)], False),
    ],
)
def test_surfaces_within_a_millimetre_of_the_wall_touch_it(agent: list[float], touches: bool) -> None:
    assert BlindPassage(1).touches_wall(state(agent)).tolist() == [[touches]]


@pytest.mark.parametrize(("short_of", "arrived"), [(0.4999 * R, True), (0.5001 * R, False)])
def test_all_within_half_a_radius_is_done(short_of: float, arrived: bool) -> None:
    at = state([0.0, 0.5 - short_of], [0.1, 0.5])
    outcome = BlindPassage(2).judge(at.position, at, np.zeros((1, 2)))
    np.testing.assert_array_equal(outcome.success, [[arrived, True]])
    assert outcome.done[0] == arrived


@pytest.mark.parametrize(("gap", "collides"), [(0.0009, True), (0.0011, False)])
def test_agents_within_a_millimetre_collide(gap: float, collides: bool) -> None:
    env = VectorEnv(BlindPassage(3))
    env.reset([0])
    agents = row([0.0, -0.5], [2 * R + gap, -0.5], [0.5, -0.5])
    env.world.place(np.array([0]), agents, env.state.walls)
    step = env.step(np.zeros((1, 3, 2)))
    assert step.agent_collision.tolist() == [[collides, collides, False]]
    assert not step.object_collision.any()


def spawned(n_agents: int, seed: int) -> tuple[Floats, Floats, Floats]:
    agents, goals, walls = BlindPassage(n_agents).spawn(np.random.default_rng(seed))
    return agents, goals, walls


def test_five_agents_begin_as_a_cross_below_the_wall_and_their_goals_above_it() -> None:
    for seed in range(50):
        agents, goals, _ = spawned(5, seed)
        for points in (agents, goals):
            cross = {(round(x, 9), round(y, 9)) for x, y in points - points.mean(axis=0)}
            assert cross == {(0.0, 0.0), (0.1, 0.0), (-0.1, 0.0), (0.0, 0.1), (0.0, -0.1)}
            assert np.abs(points).max() <= 1.0 - R
        assert agents[:, 1].max() <= -0.1 - R
        assert goals[:, 1].min() >= 0.1 + R
        np.testing.assert_allclose(agents - agents.mean(axis=0), goals - goals.mean(axis=0), atol=1e-12)


def test_places_in_the_cross_are_drawn_at_random() -> None:
    centres = {
        int(np.linalg.norm(a - a.mean(axis=0), axis=1).argmin()) for a, _, _ in map(spawned5, range(50))
    }
    assert centres == set(range(5))


def spawned5(seed: int) -> tuple[Floats, Floats, Floats]:
    return spawned(5, seed)


@pytest.mark.parametrize("n_agents", [1, 2, 3, 4])
def test_smaller_teams_take_some_of_the_five_slots(n_agents: int) -> None:
    """With the same seed the formation of five stands at the same place."""
    taken = set()
    for seed in range(100):
        agents, goals, _ = spawned(n_agents, seed)
        five, five_goals, _ = spawned(5, seed)
        np.testing.assert_allclose(agents, five[:n_agents], atol=1e-12)
        np.testing.assert_allclose(goals, five_goals[:n_agents], atol=1e-12)
        slots = (agents - five.mean(axis=0)) / 0.1
        nearest = np.linalg.norm(slots[:, None] - SLOTS[None], axis=-1).argmin(axis=1)
        assert len(set(nearest)) == n_agents
        taken.add(frozenset(nearest.tolist()))
    assert len(taken) == {1: 5, 2: 10, 3: 10, 4: 5}[n_agents]


def test_the_gap_is_at_one_of_twenty_slots() -> None:
    gaps = set()
    for seed in range(400):
        _, _, walls = spawned(3, seed)
        left_end, right_end = walls[0, 0] + 1.2, walls[1, 0] - 1.2
        assert right_end - left_end == pytest.approx(0.103)
        assert walls[0, 0] - 1.2 <= -1 - R + 1e-9  # the boxes reach past the border on both sides
        assert walls[1, 0] + 1.2 >= 1 + R - 1e-9
        assert (walls[:, 1] == 0).all()
        gaps.add(round((left_end + right_end) / 2, 9))
    spaced = sorted(gaps)
    assert len(spaced) == 20
    np.testing.assert_allclose(np.diff(spaced), 0.103)
    assert spaced[0] == pytest.approx(-1 - R + 0.0515)
