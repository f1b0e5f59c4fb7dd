"""One step of discs that touch nothing, for many episodes at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xmarl_envs.slotted_space import CONTACT_CHECKS, DAMPING, MOVE, PUSH, SUBSTEPS
from xmarl_envs.task import Bools, Floats, Task

MOVES = SUBSTEPS * CONTACT_CHECKS  # per step; Chipmunk checks for contacts after each
VELOCITY_KEPT = np.array(DAMPING**MOVE)  # per substep; an array: numpy takes longer with a Python float
DURATION = np.array(MOVE)  # s, of a move
MARGIN = 1e-9  # m, allowance for rounding


def fly(position: Floats, velocity: Floats, force: Floats) -> tuple[Floats, Floats]:
    """Advance (B, N, 2) m and m/s by one step under (B, N, 2) newton on mass 1.

    Returns the positions after each move, (MOVES, B, N, 2), and the velocity at the end, (B, N, 2). The
    operations are those of Chipmunk's cpBodyUpdatePosition and cpBodyUpdateVelocity in the order of
    `SlottedSpace.step`, so the results have the same bits as those of a Space.
    """
    path = np.empty((MOVES, *position.shape))
    push = force * PUSH * DURATION
    for move in range(MOVES):
        if move % CONTACT_CHECKS == 0:
            leap = velocity * DURATION
            velocity = velocity * VELOCITY_KEPT + push
        position = np.add(position, leap, out=path[move])
    return path, velocity


def touching(
    task: Task, path: Floats, walls: Floats, pairs: tuple[NDArray[np.intp], NDArray[np.intp]]
) -> tuple[Bools, Bools]:
    """What discs meet along their `path` (MOVES, B, N, 2).

    walls: (B, W, 2); pairs: first and second agent of each pair, two arrays (pairs,).

    Returns:
        touches: (B,) a disc may touch another, the border or a wall. False is certain; True may also mean
            that one only gets near a wall.
        close: (B,). False: no two agents are within `task.collision_gap` at the end.
    """
    apart = path.take(pairs[0], axis=2)
    apart -= path.take(pairs[1], axis=2)
    apart *= apart
    squared = apart[..., 0] + apart[..., 1]  # (MOVES, B, pairs)
    touches = (squared < (2 * task.radius + MARGIN) ** 2).any(axis=0).any(axis=-1)
    close = (squared[-1] < (2 * task.radius + max(task.collision_gap, 0.0) + MARGIN) ** 2).any(axis=-1)
    if task.bound is not None or task.n_walls:
        # The moves of a substep lie on a line.
        turns = (path[0], path[CONTACT_CHECKS - 1], path[-1])
        low, high = np.minimum.reduce(turns), np.maximum.reduce(turns)
        if task.bound is not None:
            touches |= ((low < MARGIN - task.bound) | (high > task.bound - MARGIN)).any(axis=(1, 2))
        if task.n_walls:
            reach = np.array(task.wall_size) / 2 + task.radius + MARGIN
            at_wall = low[:, :, None] < (walls + reach)[:, None]  # (B, N, W, 2)
            at_wall &= high[:, :, None] > (walls - reach)[:, None]
            touches |= at_wall.all(axis=-1).any(axis=(1, 2))
    return np.asarray(touches), np.asarray(close)
