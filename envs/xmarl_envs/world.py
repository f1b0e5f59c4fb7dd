"""Rigid-body physics of many episodes at once: pymunk Spaces read and written through numpy buffers.

One code path, one parameter: `copies_per_space`. With 1, each episode has a Space of its own and repeats
bit for bit: that is what scoring uses. With 64, copies of the task lie side by side in one Space, which
is about ten times faster and what training uses; copies then agree to rounding, not to the bit.
"""

from __future__ import annotations

import numpy as np
import pymunk
from pymunk.batch import BodyFields, Buffer, get_space_bodies, set_space_bodies

from xmarl_envs.task import Bools, Floats, Task

TIME_STEP = 0.1  # s per environment step
SUBSTEPS = 2
# Contacts are looked for this often within a substep. Two discs at full thrust close in at 1.06 m/s: looked
# for once per substep, they would get 0.053 m into each other before they are stopped; this way 0.018 m.
CONTACT_CHECKS = 3
MOVE = TIME_STEP / SUBSTEPS / CONTACT_CHECKS  # s
VELOCITY_KEPT = 0.75  # per TIME_STEP, VMAS's drag of 0.25
COPY_SPACING = 64.0  # m between copies in a shared Space: nobody gets that far in an episode
BORDER_THICKNESS = 0.5  # m
COLLISION_SLOP = 1e-4  # m; pymunk's default of 0.1 is as large as an agent


class World:
    """Discs (and walls) of `n_episodes` copies of one task.

    position, velocity: (B, N, 2) float64, m and m/s, in each copy's own frame; refreshed by `step`.
    """

    def __init__(self, task: Task, n_episodes: int, copies_per_space: int = 1) -> None:
        if n_episodes < 1 or copies_per_space < 1:
            raise ValueError(
                f"n_episodes and copies_per_space must be at least 1, got {n_episodes}, {copies_per_space}."
            )
        self.task = task
        self.n_episodes = n_episodes
        self.copies_per_space = min(copies_per_space, n_episodes)
        self.position: Floats = np.zeros((n_episodes, task.n_agents, 2))
        self.velocity: Floats = np.zeros((n_episodes, task.n_agents, 2))
        self._blocks = [
            np.arange(start, min(start + self.copies_per_space, n_episodes))
            for start in range(0, n_episodes, self.copies_per_space)
        ]
        side = int(np.ceil(np.sqrt(self.copies_per_space)))
        slot = np.arange(self.copies_per_space)
        self._offset: Floats = np.stack([slot % side, slot // side], axis=1).astype(np.float64) * COPY_SPACING
        self._chambers: list[_Chamber | None] = [None] * len(self._blocks)

    def place(self, episodes: np.ndarray, agents: Floats, walls: Floats) -> None:
        """Put the agents (E, N, 2) and walls (E, W, 2) of the given episodes; all velocities become 0.

        A Space all of whose copies are placed at once is built anew: nothing of earlier episodes
        (cached contacts, the order in its search tree) can reach the new ones.
        """
        for k, block in enumerate(self._blocks):
            rows = np.flatnonzero(np.isin(episodes, block))
            if rows.size == 0:
                continue
            chamber = self._chambers[k]
            if chamber is None or rows.size == block.size:
                chamber = _Chamber(self.task, self._offset[: block.size])
                self._chambers[k] = chamber
            for row in rows:
                chamber.place(int(episodes[row] - block[0]), agents[row], walls[row])
        self.position[episodes] = agents
        self.velocity[episodes] = 0.0

    def step(self, force: Floats, live: Bools | None = None) -> None:
        """Advance by TIME_STEP under constant forces (B, N, 2) in newton.

        live: (B,) episodes that matter; a Space without one is left as it is.
        """
        for block, chamber in zip(self._blocks, self._chambers, strict=True):
            if chamber is None or (live is not None and not live[block].any()):
                continue
            state = chamber.step(force[block])
            self.position[block] = state[:, :, :2] - self._offset[: block.size, None]
            self.velocity[block] = state[:, :, 2:]


class _Chamber:
    """One Space that holds some copies of the task, built in a fixed order: agents, walls, borders."""

    def __init__(self, task: Task, offset: Floats) -> None:
        self._offset = offset
        self._n_copies, self._n_agents = len(offset), task.n_agents
        self._space = space = pymunk.Space()
        space.collision_slop = COLLISION_SLOP
        self._discs = [pymunk.Body(1.0, float("inf")) for _ in range(self._n_copies * task.n_agents)]
        for disc in self._discs:
            space.add(disc, _frictionless(pymunk.Circle(disc, task.radius)))
        # Kinematic, not static: they move between episodes, and Chipmunk re-indexes kinematic shapes itself.
        self._walls = [
            pymunk.Body(body_type=pymunk.Body.KINEMATIC) for _ in range(self._n_copies * task.n_walls)
        ]
        for wall in self._walls:
            space.add(wall, _immovable(pymunk.Poly.create_box(wall, task.wall_size)))
        if task.bound is not None:
            for x, y in offset:
                self._add_border(float(x), float(y), task.bound + task.radius)
        n_bodies = len(self._discs) + len(self._walls)
        self._force = np.zeros((n_bodies, 2))
        self._force_buffer, self._state_buffer = Buffer(), Buffer()
        self._force_buffer.set_float_buf(self._force)  # an alias: writing to the array sets the forces

    def _add_border(self, x: float, y: float, half_width: float) -> None:
        reach = half_width + BORDER_THICKNESS
        signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
        corners = [(x + sx * reach, y + sy * reach) for sx, sy in signs]
        for a, b in zip(corners, corners[1:] + corners[:1], strict=True):
            self._space.add(_immovable(pymunk.Segment(self._space.static_body, a, b, BORDER_THICKNESS)))

    def place(self, copy: int, agents: Floats, walls: Floats) -> None:
        # Through the attributes: setting positions by batch was seen not to repeat beside polygons.
        first = copy * self._n_agents
        for disc, (x, y) in zip(self._discs[first:], agents + self._offset[copy], strict=False):
            disc.position = (float(x), float(y))
            disc.velocity = (0.0, 0.0)
        first = copy * len(walls)
        for wall, (x, y) in zip(self._walls[first:], walls + self._offset[copy], strict=False):
            wall.position = (float(x), float(y))

    def step(self, force: Floats) -> Floats:
        """(copies, N, 2) newton -> (copies, N, 4): position in the Space's frame, velocity."""
        # A substep moves by the old velocity, then changes the velocity. Its first moves only coast, and the
        # last brings the whole substep's drag and force: contacts are found early, free flight is the same.
        self._force[: len(self._discs)] = force.reshape(-1, 2) * CONTACT_CHECKS
        for _ in range(SUBSTEPS):
            self._space.damping = 1.0
            for _ in range(CONTACT_CHECKS - 1):
                self._space.step(MOVE)
            self._space.damping = VELOCITY_KEPT ** (1.0 / (SUBSTEPS * MOVE))
            set_space_bodies(self._space, BodyFields.FORCE, self._force_buffer)  # every Space.step clears it
            self._space.step(MOVE)
        self._state_buffer.clear()
        get_space_bodies(self._space, BodyFields.POSITION | BodyFields.VELOCITY, self._state_buffer)
        # Read through pymunk's own memory: it reallocates the buffer while filling it, so no alias is safe.
        state = np.frombuffer(self._state_buffer.float_buf(), dtype=np.float64).reshape(-1, 4)
        return state[: len(self._discs)].reshape(self._n_copies, self._n_agents, 4)


def _immovable(shape: pymunk.Shape) -> pymunk.Shape:
    """Walls reach into borders. In one group they are not tested against each other: between two infinite
    masses Chipmunk would look for contacts in every step and divide by zero to resolve them."""
    shape.filter = pymunk.ShapeFilter(group=1)
    return _frictionless(shape)


def _frictionless(shape: pymunk.Shape) -> pymunk.Shape:
    shape.friction = 0.0
    shape.elasticity = 0.0
    return shape
