"""Shared by the heuristics: wanted velocities, giving way, and the force that reaches a velocity."""

from __future__ import annotations

import numpy as np

from xmarl_envs.task import Floats, Task
from xmarl_envs.world import TIME_STEP, VELOCITY_KEPT

REACTION = 1.0  # 1/s; rate at which the gap to an agent that goes first may shrink

# N per m/s: to hold a velocity against the drag, and to correct one. A stiffer correction gains nothing in
# success or safety.
HOLD = (1.0 - VELOCITY_KEPT**0.5) * 2 / TIME_STEP  # two substeps
CORRECT = 2.0


def unit(vector: Floats) -> Floats:
    """(..., 2) -> (..., 2) of length 1; the zero vector stays."""
    return np.asarray(vector / np.maximum(_length(vector), 1e-9))


def towards(position: Floats, target: Floats, speed: float, gain: float = 2.0) -> Floats:
    """(..., 2) wanted velocity in m/s: straight to the target, slowing down within speed / gain metres."""
    to = target - position
    return np.asarray(unit(to) * np.minimum(gain * _length(to), speed))


def at_most(velocity: Floats, speed: float) -> Floats:
    """(..., 2) m/s: in the same direction, no faster than `speed`."""
    return np.asarray(velocity * np.minimum(1.0, speed / np.maximum(_length(velocity), 1e-9)))


def force(task: Task, wanted: Floats, velocity: Floats) -> Floats:
    """(B, N, 2) action in [-1, 1] that reaches and holds the velocity `wanted` in m/s."""
    newtons = HOLD * wanted + CORRECT * (wanted - velocity)
    return np.asarray(np.clip(newtons / task.u_mult, -1.0, 1.0))


def give_way(position: Floats, wanted: Floats, rank: Floats, clearance: float, sight: Floats) -> Floats:
    """Make wanted velocities safe, one agent after another: the lower rank goes first.

    position, wanted: (B, N, 2); rank: (B, N); sight: (B, N) m. An agent passes those of lower rank that stand
    in its way within `sight` on the nearer side. It approaches none of them faster than REACTION times the
    room left beyond `clearance`, a distance between centres (a control barrier function: Ames et al. 2019).
    """
    order = rank.argsort(axis=1, kind="stable")[..., None]
    place, wish = np.take_along_axis(position, order, axis=1), np.take_along_axis(wanted, order, axis=1)
    reach = np.take_along_axis(sight, order[..., 0], axis=1)
    safe = np.zeros_like(wanted)
    for turn in range(position.shape[1]):
        before = place[:, :turn] - place[:, turn, None]
        velocity = _pass_by(wish[:, turn], before, clearance, reach[:, turn])
        safe[:, turn] = _keep_off(velocity, safe[:, :turn], before, clearance)
    result = np.empty_like(safe)
    np.put_along_axis(result, order, safe, axis=1)
    return result


def _pass_by(velocity: Floats, offset: Floats, clearance: float, reach: Floats) -> Floats:
    """(B, 2): velocities turned by up to 45 degrees away from each partner in the way, one after the other.

    velocity: (B, 2); offset: (B, K, 2) of the partners; reach: (B,) m.
    """
    near = _length(offset)[..., 0] < reach[:, None]
    right_of_it = unit(np.stack([offset[..., 1], -offset[..., 0]], axis=-1))
    episode = np.arange(len(velocity))
    while near.any():
        heading = unit(velocity)
        ahead = (heading[:, None] * offset).sum(axis=-1)
        # Positive: the partner is left.
        aside = heading[:, :1] * offset[..., 1] - heading[:, 1:] * offset[..., 0]
        in_the_way = near & (ahead > 0) & (np.abs(aside) < clearance)
        nobody = ~in_the_way.any(axis=1)
        first = in_the_way.argmax(axis=1)
        side = np.where(aside[episode, first] >= 0, 1.0, -1.0)[:, None]
        turned = unit(heading + side * right_of_it[episode, first]) * _length(velocity)
        velocity = np.where(nobody[:, None], velocity, turned)
        # Go on with the partners after the one just passed.
        near &= (np.arange(near.shape[1]) > first[:, None]) & ~nobody[:, None]
    return velocity


def _keep_off(velocity: Floats, theirs: Floats, offset: Floats, clearance: float) -> Floats:
    """(B, 2): velocities without the excess speed towards each partner, one after the other.

    velocity: (B, 2); theirs, offset: (B, K, 2) velocities and offsets of the partners.
    """
    # Partners first: each turn of the loop then reads contiguous memory.
    others, bearings = np.moveaxis(theirs, 1, 0).copy(), np.moveaxis(unit(offset), 1, 0).copy()
    allowed = REACTION * np.moveaxis(_length(offset)[..., 0] - clearance, 1, 0)
    for _ in range(2):  # twice: avoiding one partner may lead towards another
        for other, bearing, limit in zip(others, bearings, allowed, strict=True):
            relative = velocity - other
            towards_it = relative * bearing
            excess = towards_it[:, 0] + towards_it[:, 1] - limit
            if excess.max() > 0.0:
                relative -= np.maximum(excess, 0.0)[:, None] * bearing
            velocity = relative + other
    return velocity


def _length(vector: Floats) -> Floats:
    return np.asarray(np.sqrt((vector * vector).sum(axis=-1, keepdims=True)))
