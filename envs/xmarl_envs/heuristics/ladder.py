"""Blind passage as a ladder: agents take rungs below one another, move beside the gap as a column, pass it.

Made to be imitated. The order never changes, margins are wide, the wanted velocity changes gently with the
heights of those before, nobody passes anybody, and noise of 0.15 on the actions costs nothing.

The order stands in the goals: whose goal is higher goes first, and of those level, whose goal is farther to
the side of the gap; it lies beyond the others' goals, so nobody has to fly round those who have arrived.
Start and goals are the same formation, so it is also nearly the order of the agents' heights at the start.
Agents on different heights can move to the column below the gap without meeting; nobody moves there from
beside one that goes before it.
"""

from __future__ import annotations

import numpy as np

from xmarl_envs.blind_passage_v0 import BlindPassage
from xmarl_envs.heuristics.steering import at_most, force, partners, towards
from xmarl_envs.task import Bools, Floats, State

SPEED = 0.24  # m/s, of 0.26 that full force reaches
RUNG = 0.13  # m that an agent stays below each of those before it
CLIMB = 1.5  # 1/s: velocity to the own rung, per metre; slow enough for those who see the others but dimly
FAR_FIRST, RIGHT_FIRST = 0.5, 0.15  # metres of height that a metre to the side, from gap to goal, is worth
ALIGN, CENTRE = 1.5, 2.5  # 1/s: velocity to the middle of the gap per metre, below the wall and inside it
LEVEL, APART = 0.07, 0.04  # m between heights up to which an agent waits with that, and over which it starts
BESIDE = 0.16  # m to the side; who is farther away does not count
KEEP_OFF, CROWDED = 0.13, 0.055  # m between centres below which two part, and how much less is worth SPEED
CENTRED = 0.012  # m beside the middle of the gap at which an agent may enter it
WAITING_LINE = 0.175  # m below the middle of the wall ...
SLOPE, WIDEST = 0.6, 0.15  # ... and lower by this much per metre beside the gap, up to so many metres
FLOOR = -0.985  # m; nobody is sent lower


def ladder(task: BlindPassage, state: State) -> Floats:
    """(B, N, 2) actions in [-1, 1]."""
    gap = task.gap(state)
    aside, height = gap[..., 0] - state.position[..., 0], state.position[..., 1]
    half = task.wall_thickness / 2 + task.radius + 0.004
    beyond, inside = height > half, np.abs(height) < half
    first = precedence(state.targets, gap)

    off_middle = np.maximum(np.abs(aside) - CENTRED, 0.0)
    highest = np.where(off_middle > 0, -WAITING_LINE - SLOPE * np.minimum(off_middle, WIDEST), np.inf)
    highest = np.where(inside, np.inf, highest)  # who has come in goes on
    rung = np.minimum(np.minimum(highest, _rungs(state.position, first, beyond)), 1.0)
    climb = np.clip(CLIMB * (rung - height), -SPEED, SPEED)
    align = np.clip(ALIGN * aside, -SPEED, SPEED) * _may_align(state.position, first, beyond)
    align = np.where(inside, np.clip(CENTRE * aside, -SPEED, SPEED), align)
    wanted = np.stack([align, climb], axis=-1)
    wanted += np.where(inside[..., None], 0.0, SPEED * _push(state.position, beyond))
    wanted = np.where(
        beyond[..., None], towards(state.position, state.targets, SPEED), at_most(wanted, SPEED)
    )
    return force(task, wanted, state.velocity)


def precedence(targets: Floats, gap: Floats) -> Floats:
    """(B, N) m, the same all along an episode: who has more of it goes first."""
    to_side = targets[..., 0] - gap[..., 0]
    return np.asarray(targets[..., 1] + FAR_FIRST * np.abs(to_side) + RIGHT_FIRST * to_side)


def _rungs(position: Floats, first: Floats, beyond: Bools) -> Floats:
    """(B, N) m: the height that each agent may climb to. One after the other, from the first in the order on:
    what counts is where those before it are, or are sent if that is lower."""
    order = np.argsort(-first, axis=1, kind="stable")
    aside, height = position[..., 0], position[..., 1]
    place, rung = height.copy(), np.full_like(height, np.inf)
    episode = np.arange(len(height))
    for turn in range(height.shape[1]):
        agent = order[:, turn]
        for before in order[:, :turn].T:
            beside = aside[episode, before] - aside[episode, agent]
            # Behind the wall agents fan out: there the distance counts, not the height.
            near = np.sqrt(np.maximum((RUNG - 0.01) ** 2 - beside**2, 0.0))
            room = np.where(beyond[episode, before], near, RUNG)
            rung[episode, agent] = np.minimum(rung[episode, agent], place[episode, before] - room)
        place[episode, agent] = np.minimum(height[episode, agent], rung[episode, agent])
    return np.maximum(rung, FLOOR)


def _may_align(position: Floats, first: Floats, beyond: Bools) -> Floats:
    """(B, N) in [0, 1]: 0 beside a partner that is as high and goes before, 1 where there is none."""
    apart = np.abs(position[:, :, None] - position[:, None, :])
    before = (first[:, None, :] > first[:, :, None]) & ~beyond[:, None, :]  # [b, i, j]: j goes before i
    heights = np.where(before & (apart[..., 0] < BESIDE), apart[..., 1], np.inf).min(axis=-1)
    return np.asarray(np.clip((heights - LEVEL) / APART, 0.0, 1.0))


def _push(position: Floats, beyond: Bools) -> Floats:
    """(B, N, 2): away from partners nearer than KEEP_OFF, before the wall, in units of SPEED."""
    apart, length = partners(position, itself=KEEP_OFF)  # nobody pushes itself
    both = ~(beyond[:, :, None] | beyond[:, None, :])
    strength = np.where(both, np.clip((KEEP_OFF - length) / CROWDED, 0.0, 1.3), 0.0)
    return np.asarray(((strength / np.maximum(length, 1e-9))[..., None] * apart).sum(axis=2))
