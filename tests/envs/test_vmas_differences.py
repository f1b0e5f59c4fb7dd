"""Intended differences between our tasks and VMAS, each compared with VMAS; envs/README.md says why."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from xmarl_envs import State, VectorEnv, make_task

from tests.envs.layouts import row
from tests.envs.vmas_twin import VmasTwin

Floats = NDArray[np.float64]
NO_WALLS = np.zeros((1, 0, 2))


def judged(name: str, position: Floats, targets: Floats, walls: Floats) -> tuple[Floats, Floats, bool, bool]:
    """Reward (N,) and done for standing still at some positions: ours, VMAS's."""
    task = make_task(name, position.shape[1])
    state = State(position, np.zeros_like(position), targets, walls)
    apart = np.linalg.norm(position[:, :, None] - position[:, None], axis=-1) + 9 * np.eye(task.n_agents)
    contacts = (apart <= 2 * task.radius + task.collision_gap).sum(axis=-1).astype(np.float64)
    ours = task.judge(position, state, contacts)
    twin = VmasTwin(name, task.n_agents, len(position))
    twin.place(state)
    reward, done = twin.judge()
    return ours.reward[0], reward[0], bool(ours.done[0]), bool(done[0])


@pytest.mark.parametrize(("distance", "theirs"), [(0.04, 0.01), (0.07, 0.0)])
def test_navigation_pays_the_bonus_when_the_episode_ends(distance: float, theirs: float) -> None:
    """VMAS ends it at 0.1 m and pays at 0.05 m, the default radius of its goals."""
    goals = row([-0.5, 0.0], [0.5, 0.0])
    ours, vmas, ours_done, vmas_done = judged(
        "blind_navigation_v0", goals + np.array([distance, 0.0]), goals, NO_WALLS
    )
    assert ours_done
    assert vmas_done
    np.testing.assert_allclose(ours, [0.01, 0.01])
    np.testing.assert_allclose(vmas, [theirs, theirs], atol=1e-6)


def test_navigation_punishes_a_near_miss_independently_of_other_episodes() -> None:
    """VMAS does so only if that pair overlaps in some environment of the batch."""
    near, far = row([0.0, 0.0], [0.203, 0.0])[0], row([0.0, 0.0], [0.9, 0.0])[0]
    overlap = row([0.0, 0.0], [0.19, 0.0])[0]
    for other, theirs in ((far, 0.0), (overlap, -1.0)):
        batch = np.stack([near, other])
        goals = np.full_like(batch, 5.0) * [[[1.0, 1.0], [-1.0, 1.0]]]
        ours, vmas, _, _ = judged("blind_navigation_v0", batch, goals, np.zeros((2, 0, 2)))
        np.testing.assert_allclose(ours, [-1.0, -1.0])
        np.testing.assert_allclose(vmas, [theirs, theirs], atol=1e-5)


def crowd(*first: list[float]) -> Floats:
    """Five agents of passage: the given ones, and the others far away."""
    rest = [[-0.9 + 0.3 * k, -0.9] for k in range(5 - len(first))]
    return row(*first, *rest)


@pytest.mark.slow
def test_passage_counts_touching_where_vmas_counts_overlap_of_agents_and_nearness_to_walls() -> None:
    task = make_task("blind_passage_v0", 5)
    gap_x = -1 - 0.03333 + 0.103 * 10.5  # slot 10 of 20
    walls = np.array([[[gap_x - (0.103 + 2.4) / 2, 0.0], [gap_x + (0.103 + 2.4) / 2, 0.0]]])

    def reward(*first: list[float]) -> tuple[float, float]:
        agents = crowd(*first)
        ours, vmas, _, _ = judged(task.name, agents, agents + np.array([0.0, 1.0]), walls)
        return float(ours[0]), round(float(vmas[0]), 3)

    touching = 2 * task.radius
    assert reward([0.0, -0.5], [touching + 0.0005, -0.5]) == (-10.0, 0.0)
    assert reward([0.0, -0.5], [touching - 0.0005, -0.5]) == (-10.0, -10.0)
    below = -0.1 - task.radius  # the wall's lower side touches a disc here
    slot_middle = gap_x + 2 * 0.103
    assert reward([slot_middle, below - 0.0005]) == (-10.0, -10.0)
    assert reward([slot_middle, below - 0.005]) == (0.0, -10.0)
    between = slot_middle + 0.103 / 2  # VMAS's wall consists of 19 boxes, of which two are near
    assert reward([between, below - 0.0005]) == (-10.0, -20.0)


def test_passage_draws_gap_and_slots_for_every_episode() -> None:
    """VMAS draws them once for all environments that reset together."""
    twin, env = VmasTwin("blind_passage_v0", 5, 8), VectorEnv(make_task("blind_passage_v0", 5), 8)
    env.reset(range(8))
    for gap, position, one_for_all in (
        (twin.gap, twin.position, True),
        (env.state.walls.mean(axis=1), env.state.position, False),
    ):
        slots = position - position[:, :1]
        for drawn in (gap, slots):
            assert (len(np.unique(drawn.round(4), axis=0)) == 1) == one_for_all


def test_discovery_pays_one_to_all_and_vmas_half_per_covering_agent() -> None:
    landmark = row([0.0, 0.0])
    for covering, theirs in ((2, 1.0), (3, 1.5)):
        agents = row(*[[0.2 * np.cos(a), 0.2 * np.sin(a)] for a in (0.0, 2.0, 4.0)])
        agents[:, covering:] = 0.9
        ours, vmas, ours_done, vmas_done = judged("blind_discovery_v0", agents, landmark, NO_WALLS)
        assert ours_done
        assert vmas_done
        np.testing.assert_allclose(ours, 1.0)
        np.testing.assert_allclose(vmas, theirs)


@pytest.mark.slow
def test_discovery_lets_agents_onto_the_landmark_and_stops_them_at_the_border() -> None:
    """VMAS's landmark is solid, and agents keep their velocity at its border."""
    env, twin = VectorEnv(make_task("blind_discovery_v0", 1)), VmasTwin("blind_discovery_v0", 1, 1)
    env.reset([0])
    start = State(row([-0.5, 0.0]), np.zeros((1, 1, 2)), row([0.0, 0.0]), NO_WALLS)
    env.world.place(np.array([0]), start.position, start.walls)
    env.state.targets[:] = start.targets
    twin.place(start)
    nearest = [9.0, 9.0]
    for _ in range(80):
        action = np.array([[[1.0, 0.0]]])
        env.step(action)
        twin.step(action)
        for k, position in enumerate((env.state.position, twin.position)):
            nearest[k] = min(nearest[k], float(np.linalg.norm(position)))
    assert nearest[0] < 0.03
    assert nearest[1] > 0.05
    assert env.state.position[0, 0, 0] == pytest.approx(1.0, abs=0.01)
    assert abs(env.state.velocity[0, 0, 0]) < 0.05
    twin.place(start._replace(position=row([0.9, 0.0]), targets=row([-0.9, 0.9])))
    for _ in range(40):
        twin.step(action)
    assert twin.position[0, 0, 0] == 1.0
    assert twin.velocity[0, 0, 0] == pytest.approx(0.4, abs=0.01)
