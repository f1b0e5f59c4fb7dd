"""One Space per episode: an episode repeats bit for bit, whatever the others do.

Few steps need one. An episode without a contact flies: arithmetic with the same bits. While no disc has two
contacts at once, any Space that remembers no earlier ones gives the same bits, so the episode borrows one.
Where a disc has several, the order in which Chipmunk solves them matters, and that follows from all earlier
steps: the episode's own Space then takes these first, and the next ones until the team is apart.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xmarl_envs.free_flight import fly, touching
from xmarl_envs.lone_flight import fly_alone
from xmarl_envs.slotted_space import SlottedSpace
from xmarl_envs.task import Bools, Floats, Task

FEWEST_TOGETHER = 5  # fewer teams fly one by one
LARGEST_FLYING_TEAM = 8  # nearly every larger team has a contact
PATIENCE = 8  # steps between two looks whether a team in its own Space is apart
TRIAL = 1000  # steps without the own Space, after which more than half of them taken again are too many


class SeparateSpaces:
    """The physics of `World` with one copy per Space.

    Can be copied and pickled. A copy plays an episode again from its beginning when it needs its own Space,
    because a pickled Space goes on with other contacts.
    """

    def __init__(self, task: Task, n_episodes: int) -> None:
        self._task = task
        self._agents: Floats = np.zeros((n_episodes, task.n_agents, 4))  # position and velocity at `place`
        self._walls: Floats = np.zeros((n_episodes, task.n_walls, 2))
        self._forces = [bytearray() for _ in range(n_episodes)]  # (steps, N, 2) float64 since `place`
        self._flying: Bools = np.zeros(n_episodes, dtype=np.bool_)
        self._lent: dict[int, SlottedSpace] = {}
        self._idle: list[SlottedSpace] = []  # remember no contacts
        self._in_own: set[int] = set()
        self._own: dict[int, SlottedSpace] = {}
        self._caught_up: dict[int, int] = {}  # bytes of `_forces` that the own Space has taken
        self._n_spared = 0  # steps without the own Space
        self._n_missed = 0  # those of them that it had to take after all
        self._pairs = np.triu_indices(task.n_agents, k=1)

    def _may_fly(self) -> bool:
        if self._task.n_agents > LARGEST_FLYING_TEAM or not flight_has_the_bits_of_a_space():
            return False
        return self._n_spared < TRIAL or 2 * self._n_missed < self._n_spared

    def place(self, episodes: NDArray[np.intp], agents: Floats, velocity: Floats, walls: Floats) -> None:
        """Begin episodes (E,) with agents (E, N, 2), their velocity (E, N, 2) and walls (E, W, 2)."""
        self._agents[episodes, :, :2] = agents
        self._agents[episodes, :, 2:] = velocity
        self._walls[episodes] = walls
        begun = episodes.tolist()
        for k in begun:
            self._forces[k].clear()
            self._caught_up.pop(k, None)
            if k in self._lent:
                self._take_back(k)
        flying = self._may_fly()
        self._flying[episodes] = flying
        self._in_own.difference_update(begun) if flying else self._in_own.update(begun)

    def step(
        self, position: Floats, velocity: Floats, force: Floats, walls: Floats, live: Bools | None
    ) -> Bools:
        """Advance position and velocity (B, N, 2), in place, under force (B, N, 2).

        Returns (B,): False where no two agents of a live episode are within `collision_gap` afterwards.
        """
        close: Bools = np.zeros(len(position), dtype=np.bool_)
        steps, size = force.tobytes(), force[0].nbytes
        for k in range(len(position)) if live is None else live.nonzero()[0].tolist():
            self._forces[k] += steps[k * size : (k + 1) * size]
        in_spaces = [*self._lent, *self._in_own]
        (which,) = (self._flying if live is None else self._flying & live).nonzero()
        self._n_spared += which.size + len(self._lent)
        if which.size < FEWEST_TOGETHER:
            for k in which.tolist():
                touches, near = fly_alone(self._task, position[k], velocity[k], force[k], walls[k])
                close[k] = near
                if touches:
                    self._lend(k, position[k], velocity[k])
                    in_spaces.append(k)
        else:
            path, end_velocity = fly(position[which], velocity[which], force[which])
            met, all_near = touching(self._task, path, walls[which], self._pairs)
            touching_ones = which[met].tolist()
            for k in touching_ones:
                self._lend(k, position[k], velocity[k])
            in_spaces += touching_ones
            position[which], velocity[which], close[which] = path[-1], end_velocity, all_near
        for k in in_spaces:
            if live is None or live[k]:
                step = self._step_lent if k in self._lent else self._step_own
                space = step(k, force[k])
                position[k], velocity[k], close[k] = space.position, space.velocity, True
        return close

    def _lend(self, k: int, position: Floats, velocity: Floats) -> None:
        self._flying[k] = False
        self._lent[k] = space = self._idle.pop() if self._idle else SlottedSpace(self._task)
        space.agents[0, :, :2], space.agents[0, :, 2:] = position, velocity
        space.walls[0, :, :2] = self._walls[k]
        space.write()

    def _take_back(self, k: int) -> None:
        space = self._lent.pop(k)
        space.renew()
        self._idle.append(space)

    def _step_lent(self, k: int, force: Floats) -> SlottedSpace:
        space = self._lent[k]
        contacts = space.advance(force, watch=True)
        if contacts > 1:
            if k in self._own:
                self._take_back(k)
            else:
                self._own[k] = self._lent.pop(k)
            self._in_own.add(k)
            return self._step_own(k, force)
        space.read()
        if not contacts:  # Chipmunk remembers nothing of the last one either
            self._idle.append(self._lent.pop(k))
            self._flying[k] = True
        return space

    def _step_own(self, k: int, force: Floats) -> SlottedSpace:
        """Step the own Space of episode k, after all earlier steps since `place` that it missed."""
        forces = self._forces[k]
        done, due = self._caught_up.get(k), len(forces) - force.nbytes
        space = self._begin_own(k) if done is None else self._own[k]
        if done != due:
            missed = np.frombuffer(bytes(forces[done or 0 : due])).reshape(-1, *force.shape)
            for each in missed:
                space.advance(each)
            self._n_missed += len(missed)
        space.step(force)
        self._caught_up[k] = len(forces)
        if due // force.nbytes % PATIENCE == 0 and self._may_fly() and not space.contacts():
            self._in_own.remove(k)
            self._flying[k] = True
        return space

    def _begin_own(self, k: int) -> SlottedSpace:
        """The own Space of episode k as at `place`."""
        if k in self._own:
            self._own[k].renew()
        else:
            self._own[k] = SlottedSpace(self._task)
        space = self._own[k]
        space.agents[0] = self._agents[k]
        space.walls[0, :, :2] = self._walls[k]
        space.write()
        return space

    def __getstate__(self) -> dict[str, Any]:
        spaces: dict[str, Any] = {"_lent": {}, "_idle": [], "_own": {}, "_caught_up": {}}
        return {**self.__dict__, **spaces, "_in_own": self._in_own | set(self._lent)}


@cache
def flight_has_the_bits_of_a_space() -> bool:
    """Whether this machine's Chipmunk computes free flight with the same bits as numpy.

    A compiler may fuse a multiplication with an addition, as on some processors. Then every step is a
    Space's.
    """
    from xmarl_envs.blind_navigation_v0 import BlindNavigation  # which imports nothing of physics

    task, rng = BlindNavigation(n_agents=1), np.random.default_rng(0)
    space = SlottedSpace(task)
    space.agents[...] = rng.uniform(-1, 1, (1, 1, 4))
    space.write()
    position, velocity = space.agents[..., :2].copy(), space.agents[..., 2:].copy()
    for force in rng.uniform(-1, 1, (50, 1, 1, 2)):
        space.step(force)
        path, velocity = fly(position, velocity, force)
        position = path[-1]
        if (space.position != position).any() or (space.velocity != velocity).any():
            return False
    return True
