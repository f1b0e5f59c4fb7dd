"""Plays the same layouts by the same rule in our tasks and in VMAS, contacts included.

`python -m tests.envs.fly_both` prints the table of envs/README.md.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from xmarl_envs import State, Task, VectorEnv, make_task
from xmarl_envs.heuristics import heuristic

from tests.envs.vmas_twin import VmasTwin

Floats = NDArray[np.float64]
Rule = Callable[[Task, State], Floats]


class Flown(NamedTuple):
    """Means over episodes, and the deepest overlap of all."""

    success: float  # fraction of agents at their goals at the end; discovery: the landmark is found
    done: float  # fraction of episodes
    makespan: float  # steps until done, the task's limit if never
    collision_free: float  # fraction of episodes without a collision between agents
    deepest: float  # m, overlap of two agents


def straight(task: Task, state: State) -> Floats:
    """Straight to the goal at full force, slower near it, without avoiding others."""
    action = 4 * (state.targets - state.position) - 2 * state.velocity
    return np.asarray(action / np.maximum(1.0, np.linalg.norm(action, axis=-1, keepdims=True)))


def fly_ours(task: Task, rule: Rule, n_episodes: int) -> Flown:
    env = VectorEnv(task, n_episodes)
    env.reset(range(n_episodes))

    def step() -> tuple[State, NDArray[np.bool_]]:
        done = env.step(rule(task, env.state).astype(np.float32)).terminated
        return env.state, done

    return _fly(task, n_episodes, step)


def fly_vmas(task: Task, rule: Rule, n_episodes: int, our_order: bool = False) -> Flown:
    """our_order: VMAS integrates like Chipmunk, with its own springs, walls and landmark."""
    env = VectorEnv(task, n_episodes)
    env.reset(range(n_episodes))
    targets, walls = env.state.targets, env.state.walls
    twin = VmasTwin(task.name, task.n_agents, n_episodes)
    twin.place(env.state)
    if our_order:
        twin.use_our_order()

    def step() -> tuple[State, NDArray[np.bool_]]:
        now = State(twin.position, twin.velocity, targets, walls)
        _, _, done = twin.step(rule(task, now).astype(np.float32))
        return State(twin.position, twin.velocity, targets, walls), done

    return _fly(task, n_episodes, step)


def _fly(task: Task, n_episodes: int, step: Callable[[], tuple[State, NDArray[np.bool_]]]) -> Flown:
    """Collisions and success follow our rules in both, endings each one's own."""
    going = np.ones(n_episodes, dtype=np.bool_)
    makespan = np.full(n_episodes, float(task.default_max_cycles))
    collided, success = np.zeros(n_episodes, dtype=np.bool_), np.zeros(n_episodes)
    deepest = 0.0
    contacts = np.zeros((n_episodes, task.n_agents))
    for cycle in range(task.default_max_cycles):
        state, done = step()
        apart = np.linalg.norm(state.position[:, :, None] - state.position[:, None], axis=-1)
        gap = (apart + 9.0 * np.eye(task.n_agents)).min(axis=(1, 2)) - 2 * task.radius
        collided |= going & (gap <= task.collision_gap)
        deepest = max(deepest, float(-gap[going].min()))
        reached = task.judge(state.position, state, contacts).success.mean(axis=1)
        success[going] = reached[going]
        makespan[going & done] = cycle + 1
        going &= ~done
        if not going.any():
            break
    return Flown(
        success=float(success.mean()),
        done=float(1 - going.mean()),
        makespan=float(makespan.mean()),
        collision_free=float(1 - collided.mean()),
        deepest=deepest,
    )


def main() -> None:
    for name, n_agents, rule in (
        ("blind_navigation_v0", 3, straight),
        ("blind_navigation_v0", 3, heuristic),
        ("blind_passage_v0", 5, heuristic),
        ("blind_discovery_v0", 3, heuristic),
    ):
        task = make_task(name, n_agents)
        flown = [
            fly_ours(task, rule, 200),
            fly_vmas(task, rule, 200, our_order=True),
            fly_vmas(task, rule, 200),
        ]
        digits = {"success": 2, "done": 2, "makespan": 1, "collision_free": 2, "deepest": 3}
        cells = [" / ".join(f"{getattr(one, what):.{n}f}" for one in flown) for what, n in digits.items()]
        print("|", " | ".join([f"{name}, {n_agents} agents", rule.__name__, *cells]), "|")


if __name__ == "__main__":
    main()
