"""What the heuristics share: wanted velocities, giving way, and the force that brings a velocity about."""

from __future__ import annotations

import numpy as np

from xmarl_envs.task import Floats, Task
from xmarl_envs.world import TIME_STEP, VELOCITY_KEPT

REACTION = 1.0  # 1/s; how fast a gap to somebody who goes first may be used up

# N per m/s: what it takes to keep a velocity against the drag, and to correct one. The correction is soft:
# a stiff one gains nothing in success or safety, and learners find it harder to imitate.
HOLD = (1.0 - VELOCITY_KEPT**0.5) * 2 / TIME_STEP  # two substeps
CORRECT = 2.0


def unit(vector: Floats) -> Floats:
    """(..., 2) -> (..., 2) of length 1; the zero vector stays."""
    return np.asarray(vector / np.maximum(_length(vector), 1e-9))


def towards(position: Floats, target: Floats, speed: float, gain: float = 2.0) -> Floats:
    """(..., 2) wanted velocity in m/s: straight to the target, slower from speed / gain metres on."""
    to = target - position
    return np.asarray(unit(to) * np.minimum(gain * _length(to), speed))


def force(task: Task, wanted: Floats, velocity: Floats) -> Floats:
    """(B, N, 2) action in [-1, 1] that keeps, or brings about, the velocity `wanted` in m/s."""
    newtons = HOLD * wanted + CORRECT * (wanted - velocity)
    return np.asarray(np.clip(newtons / task.u_mult, -1.0, 1.0))


def give_way(position: Floats, wanted: Floats, rank: Floats, clearance: float, sight: Floats) -> Floats:
    """Wanted velocities made safe, agent after agent: who has the lower rank goes first.

    position, wanted: (B, N, 2); rank: (B, N). Each agent passes those before it on the side that is nearer
    (where one stands within `sight` (B, N) metres of its way), and closes in on none of them faster than
    REACTION times the room left beyond `clearance`, a distance between centres (a control barrier function:
    Ames et al. 2019).
    """
    n_agents = position.shape[1]
    order = rank.argsort(axis=1, kind="stable")
    episode = np.arange(len(position))
    safe = np.zeros_like(wanted)
    for turn in range(n_agents):
        me = order[:, turn]
        velocity, reach = wanted[episode, me], sight[episode, me]
        before = [(position[episode, j] - position[episode, me], safe[episode, j]) for j in order[:, :turn].T]
        for offset, _ in before:
            velocity = _pass_by(velocity, offset, clearance, reach)
        for _ in range(2):  # keeping off one may push into another
            for offset, theirs in before:
                velocity = _keep_off(velocity - theirs, offset, clearance) + theirs
        safe[episode, me] = velocity
    return safe


def _pass_by(velocity: Floats, offset: Floats, clearance: float, reach: Floats) -> Floats:
    """(B, 2): turned by up to 45 degrees away from a partner at `offset` that stands in the way."""
    heading, bearing = unit(velocity), unit(offset)
    ahead = (heading * offset).sum(axis=-1)
    aside = heading[:, 0] * offset[:, 1] - heading[:, 1] * offset[:, 0]  # positive: the partner is left
    in_the_way = (ahead > 0) & (np.abs(aside) < clearance) & (_length(offset)[:, 0] < reach)
    right_of_it = np.stack([bearing[:, 1], -bearing[:, 0]], axis=-1)
    turned = unit(heading + np.where(aside >= 0, 1.0, -1.0)[:, None] * right_of_it) * _length(velocity)
    return np.where(in_the_way[:, None], turned, velocity)


def _keep_off(relative: Floats, offset: Floats, clearance: float) -> Floats:
    """(B, 2): relative velocity without what is too fast towards the partner."""
    bearing = unit(offset)
    room = _length(offset)[:, 0] - clearance
    excess = np.maximum((relative * bearing).sum(axis=-1) - REACTION * room, 0.0)
    return np.asarray(relative - excess[:, None] * bearing)


def _length(vector: Floats) -> Floats:
    return np.asarray(np.sqrt((vector * vector).sum(axis=-1, keepdims=True)))
