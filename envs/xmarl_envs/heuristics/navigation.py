"""Navigation with full sight: straight to the goal; the agent nearer to its goal goes first."""

from __future__ import annotations

import numpy as np

from xmarl_envs.blind_navigation_v0 import BlindNavigation
from xmarl_envs.heuristics.steering import force, give_way, towards
from xmarl_envs.task import Floats, State, distance

SPEED = 0.36  # m/s; full force reaches 0.37
MARGIN = 0.06  # m kept between surfaces, beyond the distance that counts as a collision
SIGHT = 0.5  # m


def drive(task: BlindNavigation, state: State) -> Floats:
    """(B, N, 2) actions in [-1, 1]."""
    left = distance(state.position, state.targets)
    wanted = towards(state.position, state.targets, SPEED)
    clearance = 2 * task.radius + task.collision_gap + MARGIN
    sight = np.minimum(SIGHT, left + task.goal_radius)
    wanted = give_way(state.position, wanted, left, clearance, sight)
    return force(task, wanted, state.velocity)
