"""Episodes that enter and leave shared Spaces lose nothing and leave nothing behind."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from pymunk import Body
from xmarl_envs import TASKS, VectorEnv, make_task
from xmarl_envs.shared_spaces import LARGEST_FLYING_TEAM, SharedSpaces
from xmarl_envs.slotted_space import SlottedSpace
from xmarl_envs.world import World

Floats = NDArray[np.float64]
tasks = pytest.mark.parametrize("name", TASKS)


def pushing(env: VectorEnv, rng: np.random.Generator) -> Floats:
    """Actions (B, N, 2) with which a team crowds in one place (discovery: in a corner)."""
    targets = env.state.targets
    crowd = targets.shape[1] == env.task.n_agents
    meeting = targets.mean(axis=1, keepdims=True) if crowd else 2 * np.sign(targets)
    return 2 * (meeting - env.state.position) + rng.uniform(-1, 1, env.state.position.shape)


@pytest.mark.slow
def test_two_discs_that_meet_repeatedly_move_as_in_their_own_space() -> None:
    """With one contact at a time the order of contacts cannot matter: all 32 agree for 200 steps."""
    task = make_task("blind_navigation_v0", 2)
    own, shared = VectorEnv(task, 32), VectorEnv(task, 32, copies_per_space=32)
    own.reset(range(32))
    shared.reset(range(32))
    rng = np.random.default_rng(0)
    n_contacts = 0
    for _ in range(200):
        action = pushing(own, rng)
        n_contacts += int(own.step(action).agent_collision.any(axis=1).sum())
        shared.step(action)
        np.testing.assert_allclose(shared.state.position, own.state.position, rtol=0, atol=1e-7)
    assert n_contacts > 2500


@pytest.mark.slow
def test_an_overlap_correction_due_in_the_next_step_is_made() -> None:
    """Discs turn round as they touch: nothing pushes them in that step, but Chipmunk stored the overlap."""
    task = make_task("blind_navigation_v0", 2)
    own, shared = World(task, 200), World(task, 200, copies_per_space=64)
    x = task.radius + np.linspace(0.0, 0.01, 200)
    agents = np.zeros((200, 2, 2))
    agents[:, 0, 0], agents[:, 1, 0] = -x, x
    for world in (own, shared):
        world.place(np.arange(200), agents, np.zeros((200, 0, 2)))
    inwards = np.array([[1.0, 0.0], [-1.0, 0.0]])
    for force in (inwards, -inwards, -inwards):
        own.step(np.broadcast_to(force, (200, 2, 2)))
        shared.step(np.broadcast_to(force, (200, 2, 2)))
        np.testing.assert_allclose(shared.position, own.position, rtol=0, atol=1e-9)


@pytest.mark.parametrize("n_agents", [3, LARGEST_FLYING_TEAM + 1])
def test_an_episode_does_not_depend_on_the_one_before(n_agents: int) -> None:
    """Reset in a crowd, all 16 copies fly as in their own Spaces until they touch."""
    task = make_task("blind_navigation_v0", n_agents)
    own, shared = VectorEnv(task, 16), VectorEnv(task, 16, copies_per_space=16)
    shared.reset(range(16))
    rng = np.random.default_rng(0)
    while shared.step(pushing(shared, rng)).agent_collision.any(axis=1).sum() < 12:
        pass
    for half in (range(8), range(8, 16)):
        shared.reset([100 + k for k in half], list(half))
    own.reset(range(100, 116))
    tolerance = 0.0 if n_agents <= LARGEST_FLYING_TEAM else 1e-9
    free: NDArray[np.bool_] = np.ones(16, dtype=np.bool_)
    n_compared = 0
    for _ in range(40):
        action = pushing(own, rng)
        free &= ~own.step(action).agent_collision.any(axis=1)
        shared.step(action)
        n_compared += int(free.sum())
        difference = np.abs(shared.state.position - own.state.position)[free]
        assert (difference <= tolerance).all()
    assert n_compared > 16


@pytest.mark.parametrize("name", ["blind_navigation_v0", "blind_discovery_v0"])
def test_the_next_team_in_a_slot_is_not_pushed_by_the_overlap_of_the_last(name: str) -> None:
    """Two discs away from walls are no crowd: they move as in their own Space, whatever others do."""
    task = make_task(name, 2)
    own, shared = VectorEnv(task, 64), VectorEnv(task, 64, copies_per_space=64)
    own.reset(range(64))
    shared.reset(range(64))
    for cycle in range(60):
        position = own.state.position
        action = np.clip(5 * (position.mean(axis=1, keepdims=True) - position), -1, 1)
        action[:, 1] *= 0.5  # so that they press on one another
        own.step(action)
        shared.step(action)
        assert np.abs(own.state.position - shared.state.position).max() < 1e-9
        again = [k for k in range(1, 64, 2) if 20 + k % 20 == cycle]
        for env in (own, shared):
            env.reset([1000 + k for k in again], again)


@tasks
def test_the_same_batch_repeats_bit_for_bit(name: str) -> None:
    ends = []
    for _ in range(2):
        env = VectorEnv(make_task(name, 4), 20, copies_per_space=20)
        env.reset(range(20))
        rng = np.random.default_rng(0)
        for cycle in range(60):
            env.step(pushing(env, rng))
            if cycle % 7 == 0:
                env.reset([cycle, cycle + 1], [cycle % 20, (cycle + 3) % 20])
        ends.append(env.state.position.copy())
    np.testing.assert_array_equal(ends[0], ends[1])


@pytest.mark.slow
@tasks
@pytest.mark.parametrize("n_agents", [2, 5])
def test_crowded_discs_do_not_overlap(name: str, n_agents: int) -> None:
    """Discs, walls and borders are as solid as in separate Spaces (0.02 m, test_world.py)."""
    task = make_task(name, n_agents)
    env = VectorEnv(task, 32, copies_per_space=32)
    env.reset(range(32))
    rng = np.random.default_rng(0)
    first, second = np.triu_indices(n_agents, k=1)
    n_contacts = 0
    for _ in range(120):
        n_contacts += int(env.step(pushing(env, rng)).agent_collision.sum())
        position = env.state.position
        apart = np.linalg.norm(position[:, first] - position[:, second], axis=-1)
        assert apart.min() >= 2 * task.radius - 0.02
        if task.bound is not None:
            assert np.abs(position).max() <= task.bound + 0.02
    assert n_contacts > 500


@pytest.mark.slow
def test_slots_are_reused() -> None:
    task = make_task("blind_passage_v0", 5)
    env = VectorEnv(task, 32, copies_per_space=8)
    spaces = env.world._spaces
    assert isinstance(spaces, SharedSpaces)
    rng = np.random.default_rng(0)
    for episode in range(20):
        env.reset(range(32 * episode, 32 * episode + 32))
        for _ in range(12):
            env.step(pushing(env, rng))
    assert (spaces._slot >= 0).sum() > 16
    assert spaces._occupant.size <= 2 * 32


def test_episodes_without_contacts_are_in_no_space() -> None:
    env = VectorEnv(make_task("blind_navigation_v0", 3), 32, copies_per_space=8)
    env.reset(range(32))
    env.step(np.zeros((32, 3, 2)))
    assert isinstance(env.world._spaces, SharedSpaces)
    assert not env.world._spaces._spaces


@tasks
def test_writing_a_batch_moves_no_border(name: str) -> None:
    """pymunk.batch also sets Space.static_body, after all others, from the end of the buffer."""
    task = make_task(name, 2)
    space = SlottedSpace(task, 3)
    space.agents[..., 2:] = 1.0
    space.write()
    static = space._space.static_body
    assert (static.position, static.velocity) == ((0.0, 0.0), (0.0, 0.0))
    before = space.agents[..., :2].copy()
    space.step(np.zeros((3, 2, 2)))
    way = space.position - before
    np.testing.assert_allclose(way, 0.05 * (1 + 0.75**0.5), atol=1e-9)


@tasks
@pytest.mark.parametrize("n_slots", [1, 3, 17])
def test_a_slotted_space_s_views_show_its_bodies(name: str, n_slots: int) -> None:
    """The view of pymunk's memory, created once, stays valid for later Spaces."""
    task = make_task(name, 5)
    space = SlottedSpace(task, n_slots)
    rng = np.random.default_rng(0)
    for _ in range(3):
        space.renew()
        space.write()
        for _ in range(20):
            space.step(rng.uniform(-1, 1, space.agents[..., :2].shape))
        discs = [body for body in space._space.bodies if body.body_type == Body.DYNAMIC]
        position = [tuple(at) for at in space.position.reshape(-1, 2)]
        assert [tuple(disc.position) for disc in discs] == position
        assert [tuple(disc.velocity) for disc in discs] == [tuple(v) for v in space.velocity.reshape(-1, 2)]
