"""Blind discovery, computed by hand: observations, rewards, endings and starts."""

from __future__ import annotations

import numpy as np
import pytest
from xmarl_envs import BlindDiscovery, State, VectorEnv

from tests.envs.layouts import NO_WALLS, closest_pair, row

LANDMARK = row([0.2, -0.1])


def state(*agents: list[float]) -> State:
    return State(row(*agents), np.zeros((1, len(agents), 2)), LANDMARK, NO_WALLS)


def away(distance: float) -> list[float]:
    return [0.2 + distance, -0.1]


def test_observation_is_position_velocity_and_whether_the_landmark_is_near() -> None:
    seen = BlindDiscovery(3).observe(
        State(row(away(0.349), away(0.351), [1, 1]), row([0.1, 0.2], [0.3, 0.4], [0, 0]), LANDMARK, NO_WALLS)
    )
    expected = [[0.549, -0.1, 0.1, 0.2, 1], [0.551, -0.1, 0.3, 0.4, 0], [1.0, 1.0, 0.0, 0.0, 0]]
    np.testing.assert_allclose(seen, [expected])


@pytest.mark.parametrize(
    ("distances", "found"),
    [
        ((0.249, 0.249, 0.9), True),
        ((0.249, 0.251, 0.9), False),
        ((0.0, 0.5, 0.9), False),
        ((0.1, 0.2, 0.2), True),
    ],
)
def test_two_within_a_quarter_metre_find_the_landmark_for_all(
    distances: tuple[float, ...], found: bool
) -> None:
    at = state(*(away(distance) for distance in distances))
    outcome = BlindDiscovery(3).judge(at.position, at, np.zeros((1, 3)))
    assert outcome.done.tolist() == [found]
    assert outcome.success.tolist() == [[found] * 3]
    np.testing.assert_array_equal(outcome.reward, [[float(found)] * 3])
    assert not outcome.object_collision.any()


def test_collisions_are_not_punished() -> None:
    at = state([0.9, 0.9], [0.9, 0.9], [0.0, 0.9])
    outcome = BlindDiscovery(3).judge(at.position, at, np.array([[1.0, 1.0, 0.0]]))
    np.testing.assert_array_equal(outcome.reward, np.zeros((1, 3)))


@pytest.mark.parametrize(("gap", "collides"), [(0.0009, True), (0.0011, False)])
def test_surfaces_within_a_millimetre_collide(gap: float, collides: bool) -> None:
    env = VectorEnv(BlindDiscovery(3))
    env.reset([0])
    env.world.place(np.array([0]), row([0.7, 0.0], [0.8 + gap, 0.0], [-0.9, 0.0]), NO_WALLS)
    assert env.step(np.zeros((1, 3, 2))).agent_collision.tolist() == [[collides, collides, False]]


def test_the_landmark_is_not_solid() -> None:
    env = VectorEnv(BlindDiscovery(3))
    env.reset([0])
    landmark = env.state.targets[0, 0]
    env.world.place(np.array([0]), np.stack([landmark, landmark + 0.3, landmark - 0.3])[None], NO_WALLS)
    for _ in range(10):
        env.step(np.zeros((1, 3, 2)))
    np.testing.assert_array_equal(env.state.position[0, 0], landmark)


@pytest.mark.parametrize(("n_agents", "half_width"), [(3, 1.0), (8, 1.0), (18, 1.5), (64, 8**0.5)])
def test_agents_and_landmark_begin_apart_in_the_square(n_agents: int, half_width: float) -> None:
    task = BlindDiscovery(n_agents)
    assert task.bound == half_width
    layouts = [task.spawn(np.random.default_rng(seed)) for seed in range(20 if n_agents < 64 else 3)]
    for agents, landmarks, walls in layouts:
        assert (agents.shape, landmarks.shape, walls.shape) == ((n_agents, 2), (1, 2), (0, 2))
        points = np.concatenate([agents, landmarks])
        assert np.abs(points).max() <= half_width
        assert closest_pair(points) >= 0.2
    assert np.abs(np.concatenate([layout.agents for layout in layouts])).max() > 0.9 * half_width
