"""Blind discovery: find a landmark that agents sense only from nearby, and bring a partner to it.

| | |
|---|---|
| Agents | `agent_0` ... `agent_{N-1}`, 1 <= N <= 64 (done takes two), discs of radius 0.05 m and mass 1 kg |
| Action | Box(-1, 1, (2,), float32): force in newton; what lies outside is clipped |
| | `continuous_actions=False`: Discrete(5), full force: 0 none, 1 left, 2 right, 3 down, 4 up |
| Observation | Box(-inf, inf, (5,), float32): position (m), velocity (m/s), landmark within 0.35 m (1 or 0) |
| World | centres stay in a square of half-width 1 m (sqrt(N / 8) above N = 8); the landmark is not solid |
| Start | agents and landmark uniform in the square, pairwise >= 0.2 m |
| Reward | + 1 to every agent when the landmark is found |
| Collision | surfaces within 0.001 m (reported, not punished) |
| Done | two agents or more within 0.25 m of the landmark; truncated after 500 cycles of 0.1 s |
| Info | `found`, `agent_collision`, `object_collision` (always False) |

Source: Kailas, Jain and Ravichandar (ICML 2025), section "Tasks"; constants of VMAS `discovery`.
What differs from VMAS, and why: envs/README.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from xmarl_envs.constructors import make_constructors
from xmarl_envs.task import Floats, Layout, Outcome, State, Task, distance, scatter


@dataclass(frozen=True)
class BlindDiscovery(Task):
    name: ClassVar[str] = "blind_discovery_v0"
    observation_names: ClassVar[tuple[str, ...]] = (
        "position_x", "position_y", "velocity_x", "velocity_y", "landmark_near",
    )  # fmt: skip
    default_max_cycles: ClassVar[int] = 500
    radius: ClassVar[float] = 0.05
    u_mult: ClassVar[float] = 1.0
    collision_gap: ClassVar[float] = 0.001
    success_key: ClassVar[str] = "found"
    spawn_spacing: ClassVar[float] = 0.2
    sensing_range: ClassVar[float] = 0.35
    covering_range: ClassVar[float] = 0.25
    agents_needed: ClassVar[int] = 2
    found_reward: ClassVar[float] = 1.0

    @property
    def bound(self) -> float:
        return self.spawn_half_width

    def spawn(self, rng: np.random.Generator) -> Layout:
        points = scatter(rng, self.n_agents + 1, self.spawn_half_width, self.spawn_spacing)
        return Layout(points[:-1], points[-1:], np.zeros((0, 2)))

    def observe(self, state: State) -> Floats:
        near = distance(state.position, state.targets) <= self.sensing_range
        return np.concatenate([state.position, state.velocity, near[..., None]], axis=-1)

    def judge(self, before: Floats, state: State, contacts: Floats) -> Outcome:
        covering = distance(state.position, state.targets) < self.covering_range
        done = covering.sum(axis=-1) >= self.agents_needed
        found = np.broadcast_to(done[:, None], covering.shape)
        return Outcome(self.found_reward * found, done, found, np.zeros(found.shape, np.bool_))


parallel_env, env, raw_env = make_constructors(BlindDiscovery)
