"""Blind navigation in a field of forces: every agent is drawn to its goal and pushed round whoever is near.

Slower than `drive` (makespan 68 and 85 at N = 3 and 5, against 47) and made to be imitated: nobody has a
rank, the wanted velocity changes smoothly with everybody's position, the pushes of several partners add up,
and the margins are so wide that noise of 0.15 on the actions costs nothing. Two agents head on both swerve to
their left, so they do not wait for each other.

Source: potential fields, Khatib 1986, "Real-time obstacle avoidance for manipulators and mobile robots"; the
part that turns, De Medio and Oriolo 1991, "Robot obstacle avoidance using vortex fields".
"""

from __future__ import annotations

import numpy as np

from xmarl_envs.blind_navigation_v0 import BlindNavigation
from xmarl_envs.heuristics.steering import at_most, force, partners, towards
from xmarl_envs.task import Floats, State

SPEED = 0.25  # m/s, of 0.37 that full force reaches
GOAL_GAIN = 1.5  # 1/s; the speed falls from SPEED / GOAL_GAIN metres before the goal on
SIGHT = 0.45  # m between centres; who is farther away does not matter
NEAR = 0.24  # m between centres at which the push is whole; beyond contact it goes on growing
AWAY, ASIDE = 1.5, 0.9  # of SPEED: the push straight away from a partner, and clockwise round it


def wide_berth(task: BlindNavigation, state: State) -> Floats:
    """(B, N, 2) actions in [-1, 1]."""
    wanted = towards(state.position, state.targets, SPEED, GOAL_GAIN) + SPEED * push(state.position)
    return force(task, at_most(wanted, SPEED), state.velocity)


def push(position: Floats) -> Floats:
    """(B, N, 2) m -> (B, N, 2): what partners nearer than SIGHT do to each agent, in units of SPEED."""
    apart, length = partners(position, itself=SIGHT)  # nobody pushes itself
    away = apart / np.maximum(length, 1e-9)[..., None]
    clockwise = np.stack([away[..., 1], -away[..., 0]], axis=-1)
    strength = np.maximum(SIGHT - length, 0.0) / (SIGHT - NEAR)
    return np.asarray((strength[..., None] * (AWAY * away + ASIDE * clockwise)).sum(axis=2))
