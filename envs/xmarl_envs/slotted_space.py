"""A pymunk Space with slots for copies of a task side by side, read and written through numpy buffers."""

from __future__ import annotations

import numpy as np
import pymunk
from pymunk.batch import (
    ArbiterFields,
    BodyFields,
    Buffer,
    get_space_arbiters,
    get_space_bodies,
    set_space_bodies,
)

from xmarl_envs.task import Floats, Task

TIME_STEP = 0.1  # s per environment step
SUBSTEPS = 2
# Contact checks per substep. Two discs at full thrust approach at 1.06 m/s: with one check per substep they
# overlap by up to 0.053 m before they stop, with three by 0.018 m.
CONTACT_CHECKS = 3
MOVE = TIME_STEP / SUBSTEPS / CONTACT_CHECKS  # s
VELOCITY_KEPT = 0.75  # per TIME_STEP, VMAS's drag of 0.25
DAMPING = VELOCITY_KEPT ** (1.0 / (SUBSTEPS * MOVE))  # per s; only the last move of a substep has drag
COPY_SPACING = 64.0  # m between slots
TOP_SPEED = TIME_STEP / SUBSTEPS / (1.0 - DAMPING**MOVE)  # m/s per newton of a lasting force
BORDER_THICKNESS = 0.5  # m
COLLISION_SLOP = 1e-4  # m; pymunk's default of 0.1 is as large as an agent
PUSH = np.array(float(CONTACT_CHECKS))  # an array: numpy takes twice as long with a Python float
STATE, FORCE = BodyFields.POSITION | BodyFields.VELOCITY, BodyFields.FORCE
BODIES = ArbiterFields.BODY_A_ID | ArbiterFields.BODY_B_ID


class SlottedSpace:
    """One Space with `n_slots` copies of the task, built in a fixed order: agents, walls, borders.

    Coordinates are in the Space's frame: slot k has its origin at `offset[k]`, slot 0 at (0, 0). Besides
    positions and velocities, a Space keeps lasting contacts, overlap corrections due in the next move, and
    the order of its search tree.

    Attributes:
        offset: (n_slots, 1, 2) m.
        agents: (n_slots, N, 4) position (m) and velocity (m/s) that `write` sets.
        walls: (n_slots, W, 4) the same for the walls, which do not move by themselves.
        parked: (n_slots, N, 2) m, where the agents of unused slots lie.
        position, velocity: (n_slots, N, 2) m and m/s of the agents after the last `step`.
    """

    def __init__(self, task: Task, n_slots: int = 1) -> None:
        self._task = task
        side = int(np.ceil(np.sqrt(n_slots)))
        slot = np.arange(n_slots)
        grid = np.stack([slot % side, slot // side], axis=1).astype(np.float64)
        self.offset: Floats = grid[:, None] * COPY_SPACING
        # Pymunk reads these arrays directly. The extra row is for Space.static_body, last in a batch:
        # without the row pymunk would read past the end.
        n_discs, n_walls = n_slots * task.n_agents, n_slots * task.n_walls
        state = np.zeros((n_discs + n_walls + 1, 4))
        force = np.zeros((n_discs + n_walls + 1, 2))
        self._state_in, self._force_in, self._state_out, self._bodies = Buffer(), Buffer(), Buffer(), Buffer()
        self._state_in.set_float_buf(state)
        self._force_in.set_float_buf(force)
        self.agents = state[:n_discs].reshape(n_slots, task.n_agents, 4)
        self.walls = state[n_discs:-1].reshape(n_slots, task.n_walls, 4)
        self._force = force[:n_discs].reshape(n_slots, task.n_agents, 2)
        # Unused slots: discs in a row, far from the walls.
        self.agents[..., 0] = self.offset[..., 0] + 3 * task.radius * np.arange(task.n_agents)
        self.agents[..., 1] = self.offset[..., 1] + COPY_SPACING / 4
        self.walls[..., :2] = self.offset - COPY_SPACING / 4
        self.parked = self.agents[..., :2].copy()
        self.renew()
        # Pymunk allocates its output memory at the first read. The number of bodies never changes, so the
        # views below stay valid.
        self.read()
        memory: Floats = np.frombuffer(self._state_out.float_buf(), count=self.agents.size)
        seen = memory.reshape(self.agents.shape)
        self.position, self.velocity = seen[..., :2], seen[..., 2:]

    def renew(self) -> None:
        """Replace the Space by a new one, without the old one's cached contacts and tree order."""
        task, n_slots = self._task, len(self.offset)
        self._space = space = pymunk.Space()
        space.collision_slop = COLLISION_SLOP
        space.collision_persistence = CONTACT_CHECKS  # moves; `contacts` relies on it
        self._discs = set()
        for _ in range(n_slots * task.n_agents):
            disc = pymunk.Body(1.0, float("inf"))
            self._discs.add(disc.id)
            space.add(disc, _frictionless(pymunk.Circle(disc, task.radius)))
        # Kinematic, not static: they move between episodes, and Chipmunk re-indexes kinematic shapes itself.
        for _ in range(n_slots * task.n_walls):
            wall = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
            space.add(wall, _immovable(pymunk.Poly.create_box(wall, task.wall_size)))
        if task.bound is not None:
            for x, y in self.offset[:, 0]:
                self._add_border(float(x), float(y), task.bound + task.radius)

    def _add_border(self, x: float, y: float, half_width: float) -> None:
        reach = half_width + BORDER_THICKNESS
        signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
        corners = [(x + sx * reach, y + sy * reach) for sx, sy in signs]
        for a, b in zip(corners, corners[1:] + corners[:1], strict=True):
            self._space.add(_immovable(pymunk.Segment(self._space.static_body, a, b, BORDER_THICKNESS)))

    def write(self) -> None:
        """Set all bodies to `agents` and `walls`."""
        set_space_bodies(self._space, STATE, self._state_in)

    def step(self, force: Floats) -> None:
        """Advance by TIME_STEP under forces (n_slots, N, 2) in newton."""
        self.advance(force)
        self.read()

    def advance(self, force: Floats, watch: bool = False) -> int:
        """As `step`, without reading `position` and `velocity`.

        Returns the most contacts that a disc had at once, if `watch`; several in a row count too.
        """
        most = 0
        # A move changes the position by the old velocity, then the velocity. Only the last move of a substep
        # applies drag and force, for the whole substep: contacts are found early, free flight is the same.
        np.multiply(force, PUSH, out=self._force)
        space = self._space
        for _ in range(SUBSTEPS):
            space.damping = 1.0
            for _ in range(CONTACT_CHECKS - 1):
                space.step(MOVE)
            space.damping = DAMPING
            set_space_bodies(space, FORCE, self._force_in)  # every Space.step clears it
            space.step(MOVE)
            if watch:
                most = max(most, self.contacts())
        return most

    def contacts(self) -> int:
        """The most contacts of a disc in the last CONTACT_CHECKS moves, which is what Chipmunk remembers."""
        self._bodies.clear()
        get_space_arbiters(self._space, BODIES, self._bodies)
        touching = self._bodies.int_buf()
        if not len(touching):
            return 0
        bodies: list[int] = np.frombuffer(touching, np.uintp).tolist()
        return max(bodies.count(body) for body in self._discs.intersection(bodies))

    def read(self) -> None:
        """Let `position` and `velocity` show the bodies as they are now."""
        self._state_out.clear()
        get_space_bodies(self._space, STATE, self._state_out)


def _immovable(shape: pymunk.Shape) -> pymunk.Shape:
    """Walls overlap borders: one group keeps Chipmunk from testing them against each other."""
    shape.filter = pymunk.ShapeFilter(group=1)
    return _frictionless(shape)


def _frictionless(shape: pymunk.Shape) -> pymunk.Shape:
    shape.friction = 0.0
    shape.elasticity = 0.0
    return shape
