"""One Space per episode: an episode repeats bit for bit, whatever the others do.

An episode without a contact needs no Space: free flight is arithmetic on arrays, with the same bits. A Space
catches up, step by step from where it stopped, when its episode comes near a contact. So its search tree and
contacts are those of a Space that took every step, and steps after the last contact of an episode cost
little.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xmarl_envs.free_flight import fly, touching
from xmarl_envs.slotted_space import SlottedSpace
from xmarl_envs.task import Bools, Floats, Task

# Below so many episodes their Spaces are as fast as arithmetic on arrays. Of larger teams nearly every one
# has a contact, and checking all its pairs costs more than its Space.
FEWEST_FLYING, LARGEST_FLYING_TEAM = 4, 8
FIRST_STEPS = 64  # steps that the record of forces holds at first; it grows twofold


class SeparateSpaces:
    """The physics of `World` with one copy per Space.

    Can be copied and pickled. A copy plays every episode again from its beginning, because a pickled Space
    goes on with other contacts.
    """

    def __init__(self, task: Task, n_episodes: int) -> None:
        self._task = task
        self._spaces: list[SlottedSpace | None] = [None] * n_episodes
        self._agents: Floats = np.zeros((n_episodes, task.n_agents, 4))  # position and velocity at `place`
        self._walls: Floats = np.zeros((n_episodes, task.n_walls, 2))
        self._forces: Floats = np.zeros((n_episodes, FIRST_STEPS, task.n_agents, 2))  # since `place`
        self._steps: NDArray[np.intp] = np.zeros(n_episodes, dtype=np.intp)  # since `place`
        self._caught_up: NDArray[np.intp] = np.zeros(n_episodes, dtype=np.intp)  # of these, by the Space
        self._placed: Bools = np.zeros(n_episodes, dtype=np.bool_)
        self._touched: Bools = np.zeros(n_episodes, dtype=np.bool_)  # in the last step
        self._pairs = np.triu_indices(task.n_agents, k=1)

    def place(self, episodes: NDArray[np.intp], agents: Floats, velocity: Floats, walls: Floats) -> None:
        """Begin episodes (E,) with agents (E, N, 2), their velocity (E, N, 2) and walls (E, W, 2).

        Each gets a new Space, so that earlier episodes cannot influence it.
        """
        self._agents[episodes, :, :2] = agents
        self._agents[episodes, :, 2:] = velocity
        self._walls[episodes] = walls
        self._steps[episodes] = self._caught_up[episodes] = 0
        self._placed[episodes] = True
        self._touched[episodes] = False

    def step(
        self, position: Floats, velocity: Floats, force: Floats, walls: Floats, live: Bools | None
    ) -> None:
        """Advance position and velocity (B, N, 2), in place, under force (B, N, 2)."""
        going = self._placed if live is None else self._placed & live
        (which,) = going.nonzero()
        self._record(which, force)
        if (
            which.size < FEWEST_FLYING
            or self._task.n_agents > LARGEST_FLYING_TEAM
            or not flight_has_the_bits_of_a_space()
        ):
            for k in which.tolist():
                space = self._space_of(k)
                position[k], velocity[k] = space.position, space.velocity
            self._touched[which] = True
            return
        path, end_velocity = fly(position[which], velocity[which], force[which])
        flown = path[-1]
        touches = touching(self._task, path, walls[which], self._pairs)
        for row in (touches | self._touched[which]).nonzero()[0].tolist():
            space = self._space_of(int(which[row]))
            # An overlap correction left from the last step moves what touches nothing in this one.
            touches[row] |= (space.position != flown[row]).any() or (
                space.velocity != end_velocity[row]
            ).any()
            flown[row], end_velocity[row] = space.position, space.velocity
        position[which], velocity[which], self._touched[which] = flown, end_velocity, touches

    def _record(self, which: NDArray[np.intp], force: Floats) -> None:
        if which.size and self._steps[which].max() == self._forces.shape[1]:
            self._forces = np.concatenate([self._forces, np.zeros_like(self._forces)], axis=1)
        self._forces[which, self._steps[which]] = force[which]
        self._steps[which] += 1

    def _space_of(self, k: int) -> SlottedSpace:
        """The Space of episode k after all its steps."""
        space, done = self._spaces[k], self._caught_up[k]
        if space is None:
            self._spaces[k] = space = SlottedSpace(self._task)
        elif done == 0:
            space.renew()
        if done == 0:
            space.agents[0] = self._agents[k]
            space.walls[0, :, :2] = self._walls[k]
            space.write()
        for force in self._forces[k, done : self._steps[k]]:
            space.advance(force)
        space.read()
        self._caught_up[k] = self._steps[k]
        return space

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_spaces": [None] * len(self._spaces), "_caught_up": self._caught_up * 0}


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
