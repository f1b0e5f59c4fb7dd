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
        self._forces = [bytearray() for _ in range(n_episodes)]  # (steps, N, 2) float64 since `place`
        self._caught_up = [0] * n_episodes  # bytes of these that the episode's Space has taken
        self._stale = [True] * n_episodes  # the Space is of an earlier episode
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
        for episode in episodes.tolist():
            self._forces[episode].clear()
            self._caught_up[episode] = 0
            self._stale[episode] = True
        self._placed[episodes] = True
        self._touched[episodes] = False

    def step(
        self, position: Floats, velocity: Floats, force: Floats, walls: Floats, live: Bools | None
    ) -> None:
        """Advance position and velocity (B, N, 2), in place, under force (B, N, 2)."""
        going = self._placed if live is None else self._placed & live
        (which,) = going.nonzero()
        if (
            which.size < FEWEST_FLYING
            or self._task.n_agents > LARGEST_FLYING_TEAM
            or not flight_has_the_bits_of_a_space()
        ):
            for k in which.tolist():
                space = self._space_of(k)
                space.step(force[k])
                self._forces[k] += force[k].tobytes()
                self._caught_up[k] = len(self._forces[k])
                position[k], velocity[k] = space.position, space.velocity
            self._touched[which] = True
            return
        for k in which.tolist():
            self._forces[k] += force[k].tobytes()
        path, end_velocity = fly(position[which], velocity[which], force[which])
        flown = path[-1]
        touches = touching(self._task, path, walls[which], self._pairs)
        for row in (touches | self._touched[which]).nonzero()[0].tolist():
            space = self._space_of(int(which[row]))
            # An overlap correction left from the last step moves what touches nothing in this one.
            moved = (space.position != flown[row]).any() or (space.velocity != end_velocity[row]).any()
            touches[row] |= moved
            flown[row], end_velocity[row] = space.position, space.velocity
        position[which], velocity[which], self._touched[which] = flown, end_velocity, touches

    def _space_of(self, k: int) -> SlottedSpace:
        """The Space of episode k after all steps whose forces are recorded."""
        space, done, forces = self._spaces[k], self._caught_up[k], self._forces[k]
        if space is None or self._stale[k]:
            if space is None:
                self._spaces[k] = space = SlottedSpace(self._task)
            else:
                space.renew()
            space.agents[0] = self._agents[k]
            space.walls[0, :, :2] = self._walls[k]
            space.write()
            self._stale[k] = False
        if done < len(forces):
            for force in np.frombuffer(bytes(forces[done:])).reshape(-1, self._task.n_agents, 2):
                space.advance(force)
            space.read()
            self._caught_up[k] = len(forces)
        return space

    def __getstate__(self) -> dict[str, Any]:
        n_episodes = len(self._spaces)
        return {**self.__dict__, "_spaces": [None] * n_episodes, "_caught_up": [0] * n_episodes}


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
