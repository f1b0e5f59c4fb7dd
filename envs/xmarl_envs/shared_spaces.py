"""Spaces shared by many episodes. Only episodes with a contact are in a Space; all others fly freely.

Free flight is arithmetic on arrays, with the same bits as in a Space. An episode enters a Space for the step
in which it has a contact. It leaves after a whole step without one: Chipmunk then remembers nothing of it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from xmarl_envs.free_flight import fly, touching
from xmarl_envs.slotted_space import SlottedSpace
from xmarl_envs.task import Bools, Floats, Task

FREE, COOLING = -1, -2  # slots without an episode; Chipmunk still remembers contacts of a cooling one
NO_SLOT = -1
ROUNDING = 1e-9  # m, m/s: a contact changes the result by more, the frame of a slot by less
# Slots; each further Space has twice as many as the last, so that few contacts cost little.
SMALLEST_SPACE = 8
# Nearly every larger team has a contact, and checking all its pairs costs more than a Space.
LARGEST_FLYING_TEAM = 8
BLOCK = 1024  # episodes whose paths are computed together: what they need stays in the processor's cache


class SharedSpaces:
    """The physics of `World` with at most `largest_space` copies per Space; Spaces are built when needed."""

    def __init__(self, task: Task, n_episodes: int, largest_space: int) -> None:
        self._task = task
        self._largest_space = largest_space
        self._spaces: list[tuple[SlottedSpace, slice]] = []  # each with its range of all slots
        self._occupant: NDArray[np.intp] = np.empty(0, dtype=np.intp)  # (slots of all Spaces,) -> episode
        self._slot: NDArray[np.intp] = np.full(n_episodes, NO_SLOT)  # (B,) -> slot
        self._touched: Bools = np.zeros(n_episodes, dtype=np.bool_)  # (B,) in the last step
        self._pairs = np.triu_indices(task.n_agents, k=1)

    def __getstate__(self) -> dict[str, Any]:
        if self._spaces:
            raise TypeError(
                "an environment with copies_per_space above 1 cannot be copied or pickled after its first "
                "contact: make it with copies_per_space=1."
            )
        return self.__dict__

    def place(self, episodes: NDArray[np.intp], agents: Floats, velocity: Floats, walls: Floats) -> None:
        """Begin episodes (E,): they fly freely until their first contact."""
        slots = self._slot[episodes]
        self._occupant[slots[slots != NO_SLOT]] = COOLING
        self._slot[episodes] = NO_SLOT
        self._touched[episodes] = False

    def step(
        self, position: Floats, velocity: Floats, force: Floats, walls: Floats, live: Bools | None
    ) -> Bools:
        """Advance position and velocity (B, N, 2), in place, under force (B, N, 2).

        Returns (B,): False where no two agents are within `collision_gap` afterwards.
        """
        end_position, end_velocity = np.empty_like(position), np.empty_like(velocity)
        touches, close = np.ones((2, len(position)), dtype=np.bool_)
        for first in range(0, len(position), BLOCK):
            some = slice(first, first + BLOCK)
            path, end_velocity[some] = fly(position[some], velocity[some], force[some])
            end_position[some] = path[-1]
            if self._task.n_agents <= LARGEST_FLYING_TEAM:
                touches[some], close[some] = touching(self._task, path, walls[some], self._pairs)
        needs_space = touches | self._touched
        if live is not None:
            needs_space &= live
        self._assign_slots(needs_space)
        self._touched = touches
        for space, its_slots in self._spaces:
            occupant = self._occupant[its_slots]
            in_use = np.count_nonzero(occupant != FREE)
            if not in_use:
                continue
            (slots,) = (occupant >= 0).nonzero()
            inside = occupant[slots]
            offset = space.offset[slots]
            # Discs without an episode rest apart: an overlap left there would push the next team.
            space.agents[occupant < 0, :, :2] = space.parked[occupant < 0]
            space.agents[..., 2:] = 0.0
            space.agents[slots, :, :2] = position[inside] + offset
            space.agents[slots, :, 2:] = velocity[inside]
            if self._task.n_walls:
                space.walls[slots, :, :2] = walls[inside] + offset
            space.write()
            thrust = np.zeros((occupant.size, *force.shape[1:]))
            thrust[slots] = force[inside]
            space.step(thrust)
            real_position, real_velocity = space.position[slots] - offset, space.velocity[slots]
            # An overlap correction left from the last step may have caused another contact.
            off_course = np.abs(real_position - end_position[inside]) > ROUNDING
            off_course |= np.abs(real_velocity - end_velocity[inside]) > ROUNDING
            self._touched[inside] |= off_course.any(axis=(1, 2))
            close[inside] = True
            end_position[inside], end_velocity[inside] = real_position, real_velocity
            if slots.size < in_use:
                occupant[occupant == COOLING] = FREE
        position[...] = end_position
        velocity[...] = end_velocity
        return close

    def _assign_slots(self, needs_space: Bools) -> None:
        has_slot = self._slot != NO_SLOT
        changing = np.flatnonzero(needs_space != has_slot)
        if not changing.size:
            return
        leaving, entering = changing[has_slot[changing]], changing[needs_space[changing]]
        self._occupant[self._slot[leaving]] = np.where(self._touched[leaving], COOLING, FREE)
        self._slot[leaving] = NO_SLOT
        free = np.flatnonzero(self._occupant == FREE)
        while free.size < entering.size:
            self._build_space(entering.size - free.size)
            free = np.flatnonzero(self._occupant == FREE)
        self._slot[entering] = free[: entering.size]
        self._occupant[free[: entering.size]] = entering

    def _build_space(self, n_wanted: int) -> None:
        first = self._occupant.size
        n_slots = min(max(n_wanted, SMALLEST_SPACE * 2 ** len(self._spaces)), self._largest_space)
        self._spaces.append((SlottedSpace(self._task, n_slots), slice(first, first + n_slots)))
        self._occupant = np.append(self._occupant, np.full(n_slots, FREE))
