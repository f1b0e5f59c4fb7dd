"""Passage with full sight: line up below the gap, go through one by one, spread to the goals."""

from __future__ import annotations

import numpy as np

from xmarl_envs.blind_passage_v0 import BlindPassage
from xmarl_envs.heuristics.steering import at_most, force, give_way, towards
from xmarl_envs.task import Floats, State, distance

SPEED = 0.26  # m/s, about what full force reaches
MARGIN = 0.015  # m kept between surfaces, beyond the distance that counts as a collision
SIGHT = 0.16  # m
CENTRED = 0.012  # m; an agent this close to the middle of the gap may enter it
WAITING_LINE = 0.175  # m below the middle of the wall ...
SLOPE = 0.6  # ... and lower by this much per metre beside the gap


def queue(task: BlindPassage, state: State) -> Floats:
    """(B, N, 2) actions in [-1, 1]."""
    gap = task.gap(state)
    x = gap[..., 0] - state.position[..., 0]  # m to the gap
    y = state.position[..., 1]  # m above the middle of the wall
    half = task.wall_thickness / 2 + task.radius + 0.004
    beyond, inside = y > half, np.abs(y) <= half
    aside = np.maximum(np.abs(x) - CENTRED, 0.0)
    highest = np.where(aside > 0, -WAITING_LINE - SLOPE * aside, np.inf)
    rise = np.clip(2.0 * (np.minimum(highest, 1.0) - y), -SPEED, SPEED)
    climb = np.where(inside, SPEED, rise)
    approach = at_most(np.stack([np.clip(2.5 * x, -SPEED, SPEED), climb], axis=-1), SPEED)
    wanted = np.where(beyond[..., None], towards(state.position, state.targets, SPEED), approach)
    # Agents beyond the wall go first (nearest to the goal first), then those in the gap, then the queue.
    left = distance(state.position, state.targets)
    waiting = distance(state.position, gap - np.array([0.0, half]))
    rank = np.where(beyond, left - 100.0, np.where(inside, -50.0 - y, waiting))
    clearance = 2 * task.radius + task.collision_gap + MARGIN
    sight = np.where(beyond, np.minimum(SIGHT, left + 0.02), 0.0)  # no overtaking in the queue
    return force(task, give_way(state.position, wanted, rank, clearance, sight), state.velocity)
