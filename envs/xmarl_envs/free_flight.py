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
MANY_PAIRS, MANY_EPISODES = 10, 100  # with fewer, to look at all pairs in every move is faster


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
    n_episodes, n_agents = path.shape[1:3]
    contact, collision = 2 * task.radius + MARGIN, 2 * task.radius + max(task.collision_gap, 0.0) + MARGIN
    if pairs[0].size < MANY_PAIRS or n_episodes < MANY_EPISODES:
        squared = _squared(path.take(pairs[0], axis=2), path.take(pairs[1], axis=2))  # (MOVES, B, pairs)
        touches = _any(np.asarray((squared < contact**2).any(axis=0)))
        close = _any(squared[-1] < collision**2)
    else:
        squared = _squared(path[-1].take(pairs[0], axis=1), path[-1].take(pairs[1], axis=1))  # (B, pairs)
        close = _any(squared < collision**2)
        # Before, no two discs were nearer than this allows. Only a few pairs are worth a look at each move.
        way = np.abs(path[CONTACT_CHECKS - 1] - path[0])
        way += np.abs(path[-1] - path[CONTACT_CHECKS - 1])
        reach = contact + 2 * np.sqrt(2.0) * way.reshape(n_episodes, -1).max(axis=1)
        episode, pair = (squared < (reach * reach)[:, None]).nonzero()
        discs = path.reshape(MOVES, -1, 2)
        squared = _squared(
            discs.take(episode * n_agents + pairs[0].take(pair), axis=1),
            discs.take(episode * n_agents + pairs[1].take(pair), axis=1),
        )
        touches = np.zeros(n_episodes, dtype=np.bool_)
        touches[episode[(squared < contact**2).any(axis=0)]] = True
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


def _squared(one: Floats, other: Floats) -> Floats:
    """(..., 2), (..., 2) -> (...) squared distances. Overwrites `one`."""
    one -= other
    one *= one
    squared: Floats = one[..., 0] + one[..., 1]
    return squared


def _any(flags: Bools) -> Bools:
    """(B, pairs) -> (B,): `flags.any(axis=-1)`, which is slow where rows are short."""
    result = np.zeros(len(flags), dtype=np.bool_)
    result[np.flatnonzero(flags) // max(flags.shape[1], 1)] = True
    return result
