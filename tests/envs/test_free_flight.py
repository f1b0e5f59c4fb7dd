"""Free flight on arrays has the bits of a Space, and contacts are never overlooked."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from xmarl_envs import TASKS, Task, make_task
from xmarl_envs.free_flight import MOVES, fly, touching
from xmarl_envs.lone_flight import fly_alone
from xmarl_envs.slotted_space import SlottedSpace
from xmarl_envs.world import World

Floats = NDArray[np.float64]
N_AGENTS, EPISODES = 3, 20


def scene(task: Task, seed: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Position, velocity, force and walls of episodes with agents anywhere, fast and close together."""
    rng = np.random.default_rng(seed)
    reach = 1.2 * (task.bound or 0.5)
    walls = np.array([task.spawn(rng).walls for _ in range(EPISODES)])
    position = rng.uniform(-reach, reach, (EPISODES, task.n_agents, 2))
    velocity = rng.uniform(-0.6, 0.6, position.shape)
    return position, velocity, rng.uniform(-1, 1, position.shape), walls


def in_spaces(
    task: Task, position: Floats, velocity: Floats, force: Floats, walls: Floats
) -> tuple[Floats, Floats]:
    """The same step by Chipmunk, each episode in its own Space."""
    ends = []
    for k in range(len(position)):
        space = SlottedSpace(task)
        space.agents[0] = np.concatenate([position[k], velocity[k]], axis=-1)
        space.walls[0, :, :2] = walls[k]
        space.write()
        space.step(force[k])
        ends.append(np.concatenate([space.position[0], space.velocity[0]], axis=-1))
    return np.array(ends)[..., :2], np.array(ends)[..., 2:]


def pairs(task: Task) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    first, second = np.triu_indices(task.n_agents, k=1)
    return first, second


@pytest.mark.parametrize("name", TASKS)
def test_without_contacts_free_flight_equals_chipmunk(name: str) -> None:
    task = make_task(name, N_AGENTS)
    n_free = 0
    for seed in range(10):
        position, velocity, force, walls = scene(task, seed)
        path, end_velocity = fly(position, velocity, force)
        touches, _ = touching(task, path, walls, pairs(task))
        real_position, real_velocity = in_spaces(task, position, velocity, force, walls)
        np.testing.assert_array_equal(path[-1][~touches], real_position[~touches])
        np.testing.assert_array_equal(end_velocity[~touches], real_velocity[~touches])
        n_free += int((~touches).sum())
    assert 10 < n_free < 10 * EPISODES - 10


def test_a_flight_computed_by_hand() -> None:
    """From rest under 0.6 N: no movement in the first substep, 0.05 s at 0.03 m/s in the second."""
    path, velocity = fly(np.zeros((1, 1, 2)), np.zeros((1, 1, 2)), np.array([[[0.6, 0.0]]]))
    assert path.shape == (MOVES, 1, 1, 2)
    np.testing.assert_allclose(path[:, 0, 0, 0], [0, 0, 0, 5e-4, 1e-3, 1.5e-3], atol=1e-15)
    np.testing.assert_allclose(velocity[0, 0], [0.03 * 0.75**0.5 + 0.03, 0.0], atol=1e-15)


@pytest.mark.parametrize(
    ("gap", "speed", "expected"),
    [
        (0.02, 0.0, False),
        (-1e-6, 0.0, True),
        (0.02, 0.35, True),  # 0.1 s at 0.35 m/s less drag
        (0.02, 0.15, False),
        (0.02, -0.35, False),  # away from each other
    ],
)
def test_two_discs_touch_if_they_meet_within_the_step(gap: float, speed: float, expected: bool) -> None:
    task = make_task("blind_navigation_v0", 2)
    position = np.array([[[0.0, 0.0], [2 * task.radius + gap, 0.0]]])
    velocity = np.array([[[speed, 0.0], [0.0, 0.0]]])
    path, _ = fly(position, velocity, np.zeros_like(position))
    assert touching(task, path, np.zeros((1, 0, 2)), pairs(task))[0].tolist() == [expected]


@pytest.mark.parametrize(("x", "expected"), [(0.99, False), (1.001, True), (-1.001, True)])
def test_the_border_is_touched(x: float, expected: bool) -> None:
    task = make_task("blind_discovery_v0", 1)
    path, _ = fly(np.array([[[x, 0.0]]]), np.zeros((1, 1, 2)), np.zeros((1, 1, 2)))
    assert touching(task, path, np.zeros((1, 0, 2)), pairs(task))[0].tolist() == [expected]


@pytest.mark.parametrize(("x", "y", "expected"), [(0.0, 0.0, False), (0.03, 0.0, True), (0.5, 0.2, False)])
def test_walls_are_touched(x: float, y: float, expected: bool) -> None:
    """In the middle of a gap at x = 0 with 0.018 m of clearance, outside it, and away from the wall."""
    task = make_task("blind_passage_v0", 1)
    shift = (0.103 + task.wall_size[0]) / 2
    walls = np.array([[[-shift, 0.0], [shift, 0.0]]])
    path, _ = fly(np.array([[[x, y]]]), np.zeros((1, 1, 2)), np.zeros((1, 1, 2)))
    assert touching(task, path, walls, pairs(task))[0].tolist() == [expected]


@pytest.mark.slow
@given(seed=st.integers(0, 1_000_000), name=st.sampled_from(list(TASKS)))
def test_no_contact_is_overlooked(seed: int, name: str) -> None:
    """If Chipmunk's step differs from free flight, `touching` is True."""
    task = make_task(name, N_AGENTS)
    position, velocity, force, walls = scene(task, seed)
    path, _ = fly(position, velocity, force)
    real_position, _ = in_spaces(task, position, velocity, force, walls)
    met = (real_position != path[-1]).any(axis=(1, 2))
    assert met.any()
    assert touching(task, path, walls, pairs(task))[0][met].all()


@pytest.mark.parametrize("name", TASKS)
@pytest.mark.parametrize("n_agents", [1, 3, 5])
def test_a_lone_flight_is_one_of_many(name: str, n_agents: int) -> None:
    task = make_task(name, n_agents)
    n_flown = 0
    for seed in range(10):
        position, velocity, force, walls = scene(task, seed)
        path, end_velocity = fly(position, velocity, force)
        touches, close = touching(task, path, walls, pairs(task))
        for k in range(EPISODES):
            now, speed = position[k].copy(), velocity[k].copy()
            touched, near = fly_alone(task, now, speed, force[k], walls[k])
            assert touched == touches[k]
            np.testing.assert_array_equal(now, position[k] if touched else path[-1, k])
            np.testing.assert_array_equal(speed, velocity[k] if touched else end_velocity[k])
            assert near or touched or not close[k]
            n_flown += not touched
    assert n_flown > 0


@pytest.mark.slow
@pytest.mark.parametrize("copies_per_space", [1, 8])
@pytest.mark.parametrize("n_episodes", [2, 30])
@pytest.mark.parametrize("name", TASKS)
def test_agents_in_collision_are_close(name: str, n_episodes: int, copies_per_space: int) -> None:
    """What `World.step` calls not close has no pair within `collision_gap`; and most teams are not close."""
    task = make_task(name, N_AGENTS)
    world = World(task, n_episodes, copies_per_space)
    rng = np.random.default_rng(0)
    layouts = [task.spawn(rng) for _ in range(n_episodes)]
    world.place(
        np.arange(n_episodes),
        np.array([layout.agents for layout in layouts]),
        np.array([layout.walls for layout in layouts]),
    )
    first, second = pairs(task)
    n_collided = n_close = 0
    for step in range(60):
        pull = -2 * world.position if step < 40 else 3 * world.position
        close = world.step(pull + rng.uniform(-1, 1, world.position.shape))
        gap = np.linalg.norm(world.position[:, first] - world.position[:, second], axis=-1) - 2 * task.radius
        collided = (gap <= task.collision_gap).any(axis=-1)
        assert (close | ~collided).all()
        n_collided += int(collided.sum())
        n_close += int(close.sum())
    assert 0 < n_collided <= n_close < 60 * n_episodes
