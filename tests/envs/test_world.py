"""The physics: free flight follows the formula, solids do not overlap, the gap is the only way through."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from xmarl_envs import TASKS, BlindDiscovery, BlindNavigation, BlindPassage, Task, VectorEnv, make_task
from xmarl_envs.world import World

Floats = NDArray[np.float64]
H = 0.05  # s, a substep
KEPT = 0.75**0.5  # of the velocity, per substep
PENETRATION = 0.02  # m, the largest tolerated overlap
PUSHES = st.sampled_from([-1.0, 0.0, 1.0])


def world_with(task: Task, agents: Floats, walls: Floats | None = None) -> World:
    world = World(task, 1)
    world.place(np.array([0]), agents[None], np.zeros((1, 0, 2)) if walls is None else walls[None])
    return world


def pair_penetration(position: Floats, radius: float) -> float:
    """(N, 2) -> m, the deepest overlap of a pair of discs; negative if none touches."""
    first, second = np.triu_indices(len(position), k=1)
    return float((2 * radius - np.linalg.norm(position[first] - position[second], axis=-1)).max())


def wall_penetration(position: Floats, walls: Floats, size: tuple[float, float], radius: float) -> float:
    """(N, 2), (W, 2) -> m, the deepest overlap of a disc with a box, its centre inside or outside."""
    beyond = np.abs(position[:, None] - walls[None]) - np.array(size) / 2
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)
    inside = np.minimum(beyond.max(axis=-1), 0.0)
    return float((radius - (outside + inside)).max())


@pytest.mark.parametrize("name", TASKS)
def test_free_flight_under_random_forces_follows_the_recursion(name: str) -> None:
    task = make_task(name, 1)
    env = VectorEnv(task)
    env.reset([5])
    position, velocity = env.state.position[0, 0].copy(), np.zeros(2)
    rng = np.random.default_rng(0)
    for _ in range(60):
        action = rng.uniform(-1, 1, 2)
        step = env.step(action[None, None])
        assert not step.object_collision.any()
        for _ in range(2):  # Chipmunk moves by the old velocity, then updates it
            position += velocity * H
            velocity = velocity * KEPT + action * task.u_mult * H
        np.testing.assert_allclose(env.state.position[0, 0], position, rtol=0, atol=1e-9)
        np.testing.assert_allclose(env.state.velocity[0, 0], velocity, rtol=0, atol=1e-9)


def test_free_flight_under_a_constant_force_follows_the_closed_form() -> None:
    """v_n = a h (1 - k^n) / (1 - k) and p_n = p_0 + a h^2 / (1 - k) (n - (1 - k^n) / (1 - k))."""
    force = np.array([0.6, -1.0])
    world = world_with(BlindNavigation(1), np.array([[0.2, -0.3]]))
    for cycle in range(1, 401):
        world.step(force[None, None])
        n = 2 * cycle
        series = (1 - KEPT**n) / (1 - KEPT)
        np.testing.assert_allclose(world.velocity[0, 0], force * H * series, rtol=0, atol=1e-9)
        travelled = force * H**2 / (1 - KEPT) * (n - series)
        np.testing.assert_allclose(world.position[0, 0], np.array([0.2, -0.3]) + travelled, rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("task", [BlindNavigation(2), BlindPassage(2), BlindDiscovery(2)])
@pytest.mark.parametrize("push", [(1.0, 0.0), (1.0, 1.0)])  # along the diagonal force and speed are greatest
@pytest.mark.parametrize("lateral", [0.0, 0.3])  # of a radius: head-on, and glancing
def test_two_discs_driven_into_each_other_do_not_overlap(
    task: Task, push: tuple[float, float], lateral: float
) -> None:
    force = task.u_mult * np.array([push, push]) * [[1.0], [-1.0]]
    beside = lateral * task.radius * np.array([-push[1], push[0]]) / np.hypot(*push)
    walls = np.array([[0.0, -30.0], [0.0, -30.0]])[: task.n_walls]
    deepest = -np.inf
    for distance in np.linspace(0.65, 0.75, 15):  # so they meet at various moments of a step
        start = distance * np.array([push, push]) * [[-1.0], [1.0]] + [beside, -beside]
        world = world_with(task, start, walls)
        for _ in range(60):
            world.step(force[None])
            deepest = max(deepest, pair_penetration(world.position[0], task.radius))
    assert -1e-3 < deepest <= PENETRATION


def test_equal_discs_meeting_head_on_stop() -> None:
    """With elasticity 0 and equal masses both velocities become their mean, 0."""
    world = world_with(BlindNavigation(2), np.array([[-0.6, 0.0], [0.6, 0.0]]))
    for _ in range(150):
        world.step(np.array([[[1.0, 0.0], [-1.0, 0.0]]]))
    np.testing.assert_allclose(world.position[0], [[-0.1, 0.0], [0.1, 0.0]], atol=1e-3)
    np.testing.assert_allclose(world.velocity[0], 0.0, atol=0.06)  # a substep's push, before it is resolved


@pytest.mark.parametrize("task", [BlindNavigation(5), BlindNavigation(24), BlindDiscovery(24)])
@pytest.mark.parametrize("seed", range(3))
def test_a_crowd_driven_to_the_centre_does_not_overlap(task: Task, seed: int) -> None:
    env = VectorEnv(task)
    env.reset([seed])
    deepest = -np.inf
    for _ in range(200):
        away = env.state.position / np.maximum(
            np.linalg.norm(env.state.position, axis=-1, keepdims=True), 1e-9
        )
        env.step(-away)
        deepest = max(deepest, pair_penetration(env.state.position[0], task.radius))
    assert -1e-3 < deepest <= PENETRATION


@pytest.mark.parametrize("name", ["blind_passage_v0", "blind_discovery_v0"])
@pytest.mark.parametrize("direction", [(1, 1), (-1, 1), (1, -1), (-1, -1), (1, 0), (0, -1)])
def test_the_border_holds_a_pushing_team(name: str, direction: tuple[int, int]) -> None:
    task = make_task(name, 5)
    assert task.bound is not None
    env = VectorEnv(task)
    env.reset([1])
    for _ in range(150):
        env.step(np.broadcast_to(np.array(direction, dtype=np.float64), (1, 5, 2)))
        assert np.abs(env.state.position).max() <= task.bound + PENETRATION
        assert pair_penetration(env.state.position[0], task.radius) <= PENETRATION
    if abs(direction[1]) == 1 and name == "blind_discovery_v0":
        assert np.abs(env.state.position).max() >= task.bound - 1e-3  # they reached the border


@pytest.mark.slow
@given(seed=st.integers(0, 10_000), push=st.tuples(PUSHES, st.just(1.0)))
def test_a_team_pushing_against_the_wall_stays_below_it(seed: int, push: tuple[float, float]) -> None:
    task = BlindPassage(5)
    env = VectorEnv(task)
    env.reset([seed])
    for _ in range(100):
        env.step(np.broadcast_to(np.array(push), (1, 5, 2)))
        walls = env.state.walls[0]
        assert wall_penetration(env.state.position[0], walls, task.wall_size, task.radius) <= PENETRATION
        assert pair_penetration(env.state.position[0], task.radius) <= PENETRATION


@pytest.mark.slow
@given(seed=st.integers(0, 1_000_000), hold=st.integers(1, 40), drawn=st.floats(0.0, 3.0))
def test_agents_cross_the_wall_only_through_the_gap(seed: int, hold: int, drawn: float) -> None:
    """Full thrust in random directions, held for a while; `drawn` pulls towards the gap's entrance."""
    crossings(seed, hold, drawn)


@pytest.mark.slow
def test_agents_cross_the_wall_in_some_examples() -> None:
    assert sum(crossings(seed, 15, 1.5) for seed in range(5)) >= 5


def crossings(seed: int, hold: int, drawn: float, n_episodes: int = 4) -> int:
    """How often agents change sides in some episodes; asserts that each time is inside the gap."""
    task = BlindPassage(5)
    env = VectorEnv(task, n_episodes)
    env.reset(range(seed, seed + n_episodes))
    rng = np.random.default_rng(seed)
    gap = task.gap(env.state)[..., 0]  # (B, 1)
    thrust = np.zeros((n_episodes, 5, 2))
    count = 0
    for cycle in range(200):
        if cycle % hold == 0:
            thrust = rng.choice([-1.0, 1.0], size=(n_episodes, 5, 2))
            thrust[..., 1] += 0.5  # a little up, towards the wall
        pull = drawn * np.sign(gap - env.state.position[..., 0])
        before = env.state.position.copy()
        env.step(thrust + np.stack([pull, np.zeros_like(pull)], axis=-1))
        after = env.state.position
        crossed = np.sign(before[..., 1]) != np.sign(after[..., 1])
        for moment in (before, after):
            assert (np.abs(moment[..., 0] - gap)[crossed] <= task.gap_width / 2).all()
        for episode in range(n_episodes):
            walls = env.state.walls[episode]
            assert wall_penetration(after[episode], walls, task.wall_size, task.radius) <= PENETRATION
        count += int(crossed.sum())
    return count


@pytest.mark.parametrize("off_centre", [0.0, 0.01, 0.03])
def test_an_agent_gets_through_the_gap(off_centre: float) -> None:
    """Straight up: in the middle, off centre, and touching a corner that pushes it in."""
    task = BlindPassage(1)
    env = VectorEnv(task)
    env.reset([2])
    gap = float(task.gap(env.state)[0, 0, 0])
    env.world.place(np.array([0]), np.array([[[gap + off_centre, -0.3]]]), env.state.walls)
    touched = False
    for _ in range(60):
        touched |= bool(env.step(np.array([[[0.0, 1.0]]])).object_collision.any())
    assert env.state.position[0, 0, 1] > 0.2
    assert touched == (off_centre > 0.02)
