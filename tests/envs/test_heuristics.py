"""Heuristics solve the tasks; random agents do not."""

from __future__ import annotations

import numpy as np
import pytest
from xmarl_envs import TASKS, State, Task, VectorEnv, make_task
from xmarl_envs.heuristics import heuristic
from xmarl_envs.heuristics.steering import REACTION, force, give_way
from xmarl_envs.task import Floats

from tests.envs.played import Act, play

EPISODES = 40


def success(task: Task, act: Act) -> float:
    return play(task, act, EPISODES, copies_per_space=EPISODES).success


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "n_agents", "bar"),
    [
        *(("blind_navigation_v0", n, 0.95) for n in (3, 5, 8)),
        *(("blind_passage_v0", n, 0.9) for n in (3, 4, 5)),
        *(("blind_discovery_v0", n, 0.97) for n in (3, 5)),  # 0.99 and more over 200 episodes
    ],
)
def test_the_heuristic_solves_its_task(name: str, n_agents: int, bar: float) -> None:
    assert success(make_task(name, n_agents), heuristic) >= bar


@pytest.mark.slow
@pytest.mark.parametrize("name", TASKS)
def test_random_agents_do_not_solve_the_tasks(name: str) -> None:
    rng = np.random.default_rng(0)
    task = make_task(name, 3)
    assert success(task, lambda _, state: rng.uniform(-1, 1, state.position.shape)) < 0.5


@pytest.mark.parametrize("name", TASKS)
def test_actions_are_in_range_and_depend_only_on_the_episode(name: str) -> None:
    task = make_task(name, 3)
    env = VectorEnv(task, 3)
    env.reset([5, 6, 7])
    for _ in range(20):
        together = heuristic(task, env.state)
        assert together.shape == (3, 3, 2) and np.abs(together).max() <= 1.0
        alone = heuristic(task, State(*(array[1:2] for array in env.state)))
        np.testing.assert_allclose(alone, together[1:2], rtol=0, atol=1e-12)
        env.step(together)


def test_a_task_without_heuristic_is_refused() -> None:
    class Other(Task):
        name = "other"
        observe = spawn = judge = None  # type: ignore[assignment]

    with pytest.raises(TypeError, match="other has no heuristic"):
        heuristic(Other(2), VectorEnv(make_task("blind_navigation_v0", 2)).state)


def test_the_second_agent_approaches_no_faster_than_allowed() -> None:
    position = np.array([[[0.0, 0.0], [0.5, 0.0]]])
    wanted = np.array([[[0.0, 0.0], [-1.0, 0.0]]])
    see_nobody = np.zeros((1, 2))
    safe = give_way(position, wanted, np.array([[0.0, 1.0]]), clearance=0.3, sight=see_nobody)
    np.testing.assert_allclose(safe[0], [[0.0, 0.0], [-REACTION * 0.2, 0.0]])
    free = give_way(position, wanted, np.array([[1.0, 0.0]]), clearance=0.3, sight=see_nobody)
    np.testing.assert_allclose(free[0, 1], [-1.0, 0.0])  # the first moves freely, the other backs off
    assert free[0, 0, 0] <= -1.0 + REACTION * 0.2 + 1e-12


@pytest.mark.parametrize("n_agents", [1, 2, 9])
@pytest.mark.parametrize("seed", range(5))
def test_giving_way_equals_a_loop_over_partners(n_agents: int, seed: int) -> None:
    """Crowded enough that most agents pass one partner and avoid several."""
    rng = np.random.default_rng(seed)
    position = rng.uniform(-0.7, 0.7, (3, n_agents, 2))
    wanted = rng.uniform(-0.4, 0.4, position.shape)
    rank, sight = rng.uniform(0, 1, (3, n_agents)), rng.uniform(0, 0.8, (3, n_agents))
    safe = give_way(position, wanted, rank, 0.25, sight)
    n_turned = 0
    for episode in range(3):
        velocities: dict[int, Floats] = {}
        for me in np.argsort(rank[episode]):
            velocity = wanted[episode, me]
            offsets = {j: position[episode, j] - position[episode, me] for j in velocities}
            for to in offsets.values():
                velocity = passed_by(velocity, to, 0.25, sight[episode, me])
            for _ in range(2):
                for j, to in offsets.items():
                    length = np.hypot(*to)
                    closing = (velocity - velocities[j]) @ to / length
                    velocity = velocity - max(closing - REACTION * (length - 0.25), 0.0) * to / length
            velocities[int(me)] = velocity
            np.testing.assert_allclose(safe[episode, me], velocity, atol=1e-12)
            n_turned += not np.allclose(velocity, wanted[episode, me])
    assert n_turned > n_agents or n_agents < 9


def passed_by(velocity: Floats, to: Floats, clearance: float, reach: float) -> Floats:
    speed, length = np.hypot(*velocity), np.hypot(*to)
    heading = velocity / speed
    left = heading[0] * to[1] - heading[1] * to[0]
    if length >= reach or heading @ to <= 0 or abs(left) >= clearance:
        return velocity
    across = np.array([to[1], -to[0]]) / length * (1 if left >= 0 else -1)
    turned = heading + across
    return np.asarray(speed * turned / np.hypot(*turned))


def test_the_force_holds_a_velocity() -> None:
    """At the wanted velocity, `force` compensates the drag."""
    task = make_task("blind_navigation_v0", 1)
    env = VectorEnv(task)
    env.reset([0])
    wanted = np.array([[[0.2, -0.1]]])
    for _ in range(60):
        env.step(force(task, wanted, env.state.velocity))
    np.testing.assert_allclose(env.state.velocity, wanted, atol=1e-6)
