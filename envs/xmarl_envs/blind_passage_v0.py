"""Blind passage: a team in formation goes through a gap one agent wide, one after the other.

| | |
|---|---|
| Agents | `agent_0` ... `agent_{N-1}`, 1 <= N <= 5, discs of radius 0.03333 m and mass 1 kg |
| Action | Box(-1, 1, (2,), float32), times 0.7: force in newton; what lies outside is clipped |
| | `continuous_actions=False`: Discrete(5), full force: 0 none, 1 left, 2 right, 3 down, 4 up |
| Observation | Box(-inf, inf, (8,), float32): position, velocity (m/s), goal - position, gap - position (m) |
| World | centres stay in [-1, 1]^2; a wall 0.2 m thick on y = 0, one gap 0.103 m wide at one of 20 slots |
| Start | a cross (centre and 4 arms, spacing 0.1 m) below the wall, goals the same slots above it |
| | N < 5: N of the 5 slots at random |
| Reward | 100 per metre of distance gained, - 10 per colliding partner, - 10 for touching the wall |
| | `shared_reward=True`: the distance gained is the team's sum |
| Collision | surfaces within 0.001 m |
| Done | all agents within 0.016665 m (radius / 2) of their goals; truncated after 300 cycles of 0.1 s |
| Info | `at_goal`, `agent_collision`, `object_collision` (touches the wall) |

Source: Kailas, Jain and Ravichandar (ICML 2025), section "Tasks"; constants of VMAS `passage`.
What differs from VMAS, and why: envs/README.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from xmarl_envs.constructors import make_constructors
from xmarl_envs.task import Bools, Floats, Layout, Outcome, State, Task, distance

SLOTS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])  # the cross, in spacings
N_GAPS = 20
WALL_LENGTH = 2.4  # m; long enough for both boxes to reach past the border at every gap position


@dataclass(frozen=True)
class BlindPassage(Task):
    shared_reward: bool = False  # VMAS's default; False: each agent is paid for its own distance

    name: ClassVar[str] = "blind_passage_v0"
    observation_names: ClassVar[tuple[str, ...]] = (
        "position_x", "position_y", "velocity_x", "velocity_y",
        "to_goal_x", "to_goal_y", "to_gap_x", "to_gap_y",
    )  # fmt: skip
    default_max_cycles: ClassVar[int] = 300
    radius: ClassVar[float] = 0.03333
    u_mult: ClassVar[float] = 0.7
    collision_gap: ClassVar[float] = 0.001
    success_key: ClassVar[str] = "at_goal"
    max_agents: ClassVar[int] = 5
    spacing: ClassVar[float] = 0.1
    gap_width: ClassVar[float] = 0.103
    wall_thickness: ClassVar[float] = 0.2
    wall_size: ClassVar[tuple[float, float]] = (WALL_LENGTH, wall_thickness)
    n_walls: ClassVar[int] = 2
    distance_reward: ClassVar[float] = 100.0  # per metre
    collision_penalty: ClassVar[float] = 10.0

    @property
    def bound(self) -> float:
        return 1.0

    def spawn(self, rng: np.random.Generator) -> Layout:
        slots = self.spacing * SLOTS[rng.permutation(len(SLOTS))[: self.n_agents]]
        margin = 3 * self.radius + self.spacing
        near, far = margin + self.wall_thickness / 2, 1.0 - margin
        start = rng.uniform([-far, -far], [far, -near])
        goal = rng.uniform([-far, near], [far, far])
        gap_x = -1.0 - self.radius + self.gap_width * (0.5 + rng.integers(N_GAPS))
        shift = (self.gap_width + WALL_LENGTH) / 2
        walls = np.array([[gap_x - shift, 0.0], [gap_x + shift, 0.0]])
        return Layout(start + slots, goal + slots, walls)

    def gap(self, state: State) -> Floats:
        """(B, 1, 2): the middle of the gap."""
        return np.asarray(state.walls.mean(axis=1, keepdims=True))

    def observe(self, state: State) -> Floats:
        to_goal = state.targets - state.position
        to_gap = self.gap(state) - state.position
        return np.concatenate([state.position, state.velocity, to_goal, to_gap], axis=-1)

    def judge(self, before: Floats, state: State, contacts: Floats) -> Outcome:
        to_goal = distance(state.position, state.targets)
        gained = distance(before, state.targets) - to_goal
        if self.shared_reward:
            gained = np.broadcast_to(gained.sum(axis=-1, keepdims=True), gained.shape)
        touches_wall = self.touches_wall(state)
        reward = self.distance_reward * gained - self.collision_penalty * (contacts + touches_wall)
        at_goal = to_goal <= self.radius / 2
        return Outcome(reward, np.asarray(at_goal.all(axis=-1)), at_goal, touches_wall)

    def touches_wall(self, state: State) -> Bools:
        """(B, N): whether a disc's surface is within `collision_gap` of a wall box."""
        offset = np.abs(state.position[:, :, None] - state.walls[:, None])  # (B, N, W, 2)
        outside = np.maximum(offset - np.array(self.wall_size) / 2, 0.0)
        gap = np.sqrt(outside[..., 0] ** 2 + outside[..., 1] ** 2) - self.radius
        return np.asarray((gap <= self.collision_gap).any(axis=-1))


parallel_env, env, raw_env = make_constructors(BlindPassage)
