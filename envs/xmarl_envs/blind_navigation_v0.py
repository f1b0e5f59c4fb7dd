"""Blind navigation: every agent drives to its own goal without touching the others, which it cannot see.

| | |
|---|---|
| Agents | `agent_0` ... `agent_{N-1}`, 1 <= N <= 64, discs of radius 0.1 m and mass 1 kg |
| Action | Box(-1, 1, (2,), float32): force in newton; what lies outside is clipped |
| | `continuous_actions=False`: Discrete(5), full force: 0 none, 1 left, 2 right, 3 down, 4 up |
| Observation | Box(-inf, inf, (6,), float32): position (m), velocity (m/s), position - goal (m) |
| World | an open plane |
| Start | agents, goals uniform in a square of half-width 1 m (sqrt(N / 8) above N = 8), pairwise >= 0.25 m |
| Reward | the team's sum of distance gained (m), + 0.01 when all are at goal, - 1 per colliding partner |
| Collision | surfaces within 0.005 m |
| Done | all agents within 0.1 m of their goals; truncated after 400 cycles of 0.1 s |
| Info | `at_goal`, `agent_collision`, `object_collision` (always False) |

Source: Kailas, Jain and Ravichandar (ICML 2025), section "Tasks"; constants of VMAS `navigation`.
What differs from VMAS, and why: envs/README.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from xmarl_envs.constructors import make_constructors
from xmarl_envs.task import Floats, Layout, Outcome, State, Task, distance, scatter


@dataclass(frozen=True)
class BlindNavigation(Task):
    name: ClassVar[str] = "blind_navigation_v0"
    observation_names: ClassVar[tuple[str, ...]] = (
        "position_x", "position_y", "velocity_x", "velocity_y", "from_goal_x", "from_goal_y",
    )  # fmt: skip
    default_max_cycles: ClassVar[int] = 400
    radius: ClassVar[float] = 0.1
    u_mult: ClassVar[float] = 1.0
    collision_gap: ClassVar[float] = 0.005
    success_key: ClassVar[str] = "at_goal"
    spawn_spacing: ClassVar[float] = 0.25
    goal_radius: ClassVar[float] = 0.1
    all_at_goal_reward: ClassVar[float] = 0.01
    collision_penalty: ClassVar[float] = 1.0

    def spawn(self, rng: np.random.Generator) -> Layout:
        points = scatter(rng, 2 * self.n_agents, self.spawn_half_width, self.spawn_spacing)
        return Layout(points[: self.n_agents], points[self.n_agents :], np.zeros((0, 2)))

    def observe(self, state: State) -> Floats:
        return np.concatenate([state.position, state.velocity, state.position - state.targets], axis=-1)

    def judge(self, before: Floats, state: State, contacts: Floats) -> Outcome:
        earlier, to_goal = distance(np.array((before, state.position)), state.targets)
        at_goal = to_goal < self.goal_radius
        done = np.asarray(at_goal.all(axis=-1))
        team = (earlier - to_goal).sum(axis=-1)
        if np.count_nonzero(done):  # adding zeros takes longer
            team += self.all_at_goal_reward * done
        reward = team[:, None] - self.collision_penalty * contacts
        return Outcome(reward, done, at_goal, np.zeros(at_goal.shape, np.bool_))


parallel_env, env, raw_env = make_constructors(BlindNavigation)
