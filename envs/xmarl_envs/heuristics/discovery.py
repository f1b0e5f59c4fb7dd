"""Blind discovery: fly straight and bounce off the borders; fly to the agent that senses the landmark.

Unlike the other two it uses only what the team observes: a team whose agents share all their observations
could act like this.
"""

from __future__ import annotations

import numpy as np

from xmarl_envs.blind_discovery_v0 import BlindDiscovery
from xmarl_envs.heuristics.steering import force, unit
from xmarl_envs.task import Floats, State, distance

SPEED = 0.36  # m/s; full force reaches 0.37
BORDER = 0.1  # m over which a border turns agents back
CIRCLING = 0.07  # rad per cycle; an agent that senses the landmark circles slowly to stay near it
SLOW = 0.6  # fraction of SPEED


def search(task: BlindDiscovery, state: State) -> Floats:
    """(B, N, 2) actions in [-1, 1]."""
    position, velocity = state.position, state.velocity
    senses = task.observe(state)[..., -1] > 0
    still = np.abs(velocity).sum(axis=-1, keepdims=True) < 0.02
    heading = np.where(still, unit(np.array([1e-3, 3e-4]) - position), unit(velocity))
    over = np.clip((np.abs(position) - (task.bound - BORDER)) / BORDER, 0.0, 1.0)
    bounced = unit(heading - 2.0 * over * np.sign(position))
    apart = np.where(senses[:, None, :], distance(position[:, :, None], position[:, None, :]), np.inf)
    helped = np.take_along_axis(position, apart.argmin(axis=-1)[..., None], axis=1)
    cosine, sine = np.cos(CIRCLING), np.sin(CIRCLING)
    circled = np.stack(
        [
            cosine * heading[..., 0] - sine * heading[..., 1],
            sine * heading[..., 0] + cosine * heading[..., 1],
        ],
        axis=-1,
    )
    direction = np.where(np.asarray(senses.any(axis=1))[:, None, None], unit(helped - position), bounced)
    direction = np.where(senses[..., None], circled, direction)
    speed = np.where(senses, SLOW, 1.0) * SPEED
    return force(task, direction * speed[..., None], velocity)
