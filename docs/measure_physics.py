"""Prints the CPU time of scoring physics beside a Space for every step, in turns in one run.

python docs/measure_physics.py
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import torch
from xmarl_envs import make_task, separate_spaces, world
from xmarl_envs.task import Bools

from xmarl_bench.plugins.names import find_policies
from xmarl_bench.policy import Policy, PolicyCard, load_policy
from xmarl_bench.reproducible import episode_seeds
from xmarl_bench.rollout.episodes import roll_out

POLICIES = (
    "navigation-n3-residual-lambda0-seed0", "navigation-n5-residual-lambda0.1-seed0",
    "passage-n3-residual-lambda0-seed0", "passage-n4-residual-lambda0-seed0",
    "discovery-n3-residual-lambda0-seed0", "discovery-n5-residual-lambda0.03-seed0",
)  # fmt: skip
EPISODES, ROUNDS = 50, 3


class Timed(separate_spaces.SeparateSpaces):
    """Counts the CPU seconds of its steps."""

    seconds = 0.0

    def step(self, *arguments: Any) -> Bools:
        started = time.process_time()
        close = super().step(*arguments)
        Timed.seconds += time.process_time() - started
        return close


def physics_seconds(policy: Policy, card: PolicyCard, largest_flying: int) -> tuple[float, float]:
    """CPU seconds of the physics and of the whole rollout of EPISODES episodes."""
    separate_spaces.LARGEST_FLYING_TEAM = largest_flying
    Timed.seconds, started = 0.0, time.process_time()
    task = make_task(card.task, card.n_agents)
    roll_out(task, policy, episode_seeds(0, EPISODES), parallel_episodes=EPISODES)
    return Timed.seconds, time.process_time() - started


def free_flight(n_episodes: int, largest_flying: int) -> float:
    """CPU microseconds of a step of so many teams of three that never touch."""
    separate_spaces.LARGEST_FLYING_TEAM = largest_flying
    task = make_task("blind_navigation_v0", 3)
    spaces = separate_spaces.SeparateSpaces(task, n_episodes)
    position = np.tile(np.array([[-3.0, 0.0], [0.0, 0.0], [3.0, 0.0]]), (n_episodes, 1, 1))
    velocity, walls = np.zeros_like(position), np.zeros((n_episodes, 0, 2))
    spaces.place(np.arange(n_episodes), position, velocity, walls)
    force = np.random.default_rng(0).uniform(-0.3, 0.3, (100, *position.shape))
    started = time.process_time()
    for each in force:
        spaces.step(position, velocity, each, walls, None)
    return (time.process_time() - started) / len(force) * 1e6


def main() -> None:
    torch.set_num_threads(1)
    flying = separate_spaces.LARGEST_FLYING_TEAM
    for n_episodes in (1, 4, 16, 50, 200):
        pairs = [(free_flight(n_episodes, 0), free_flight(n_episodes, flying)) for _ in range(ROUNDS)]
        spaces, flown = np.min(pairs, axis=0)
        print(
            f"| free flight, {n_episodes} teams | {spaces:.0f} us | {flown:.0f} us | {spaces / flown:.1f} |"
        )
    vars(world)["SeparateSpaces"] = Timed
    for name in POLICIES:
        policy, card = load_policy(find_policies()[name])
        rounds = [
            (*physics_seconds(policy, card, 0), *physics_seconds(policy, card, flying)) for _ in range(ROUNDS)
        ]
        spaces, whole, flown, _ = np.min(rounds, axis=0)
        print(
            f"| {name}, {whole:.2f} s in all | {spaces:.2f} s | {flown:.2f} s | {spaces / flown:.1f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
