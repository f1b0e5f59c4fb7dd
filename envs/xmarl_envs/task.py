"""The base class of tasks: rules over arrays of many episodes, without physics, APIs or drawing.

Every field states its shape: B episodes, N agents, T targets (goals or landmarks), W wall boxes.
Lengths are in metres, times in seconds, velocities in m/s. Discs do not rotate, so there are no angles.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from math import sqrt
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from xmarl_envs.vector_env import VectorEnv

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
# (5, 2): of discrete actions, in MPE2's order, see xmarl_envs.actions.
PUSHES: Floats = np.array([[0, 0], [-1, 0], [1, 0], [0, -1], [0, 1]], dtype=np.float64)
_TRIES = 10_000  # of `scatter`, for the last of its points


class Layout(NamedTuple):
    """Positions at the start of an episode."""

    agents: Floats  # (N, 2) m
    targets: Floats  # (T, 2) m
    walls: Floats  # (W, 2) m, centres of the wall boxes


class State(NamedTuple):
    """The state of B episodes at one moment."""

    position: Floats  # (B, N, 2) m
    velocity: Floats  # (B, N, 2) m/s
    targets: Floats  # (B, T, 2) m
    walls: Floats  # (B, W, 2) m


class Outcome(NamedTuple):
    """The result of one step of B episodes."""

    reward: Floats  # (B, N)
    done: Bools  # (B,) the team is done
    success: Bools  # (B, N) at its goal (discovery: the landmark is found)
    object_collision: Bools  # (B, N) touches a wall


class Step(NamedTuple):
    """The result of a step of B episodes. Success and collisions are 0 or 1, NaN where a task has none."""

    observation: NDArray[np.float32]  # (B, N, D)
    reward: Floats  # (B, N)
    terminated: Bools  # (B,) the team is done
    truncated: Bools  # (B,) max_cycles reached and the team not done
    success: NDArray[Any]  # (B, N)
    agent_collision: NDArray[Any]  # (B, N)
    object_collision: NDArray[Any]  # (B, N)


@dataclass(frozen=True)
class Task(ABC):
    """Rules of one task for a team of `n_agents`. Stateless: every method is a function of its arguments.

    continuous_actions: False gives each agent five actions to choose from, see xmarl_envs.actions.
    """

    n_agents: int = 3
    continuous_actions: bool = field(default=True, kw_only=True)

    name: ClassVar[str]
    observation_names: ClassVar[tuple[str, ...]]  # one name per entry of an observation
    default_max_cycles: ClassVar[int]
    radius: ClassVar[float]  # m
    u_mult: ClassVar[float]  # N per unit of action
    collision_gap: ClassVar[float]  # m; surfaces nearer than this collide
    success_key: ClassVar[str]  # the name of `success` in a step's info
    wall_size: ClassVar[tuple[float, float]] = (0.0, 0.0)  # m, of each wall box
    n_walls: ClassVar[int] = 0
    max_agents: ClassVar[int] = 64

    def __post_init__(self) -> None:
        if not 1 <= self.n_agents <= self.max_agents:
            raise ValueError(
                f"{self.name} takes 1 to {self.max_agents} agents, got n_agents={self.n_agents}: "
                f"choose a number in that range."
            )

    @property
    def obs_dim(self) -> int:
        return len(self.observation_names)

    @property
    def has_objects(self) -> bool:
        """Whether there are walls to collide with."""
        return self.n_walls > 0

    @property
    def action_width(self) -> int:
        """How many numbers a policy outputs for an action: entries of a push, or one per discrete action."""
        return 2 if self.continuous_actions else len(PUSHES)

    def with_actions(self, continuous: bool) -> Self:
        """The same task with continuous or with discrete actions."""
        return replace(self, continuous_actions=continuous)

    def vector_env(self, n_episodes: int = 1, max_cycles: int | None = None) -> VectorEnv:
        """Episodes of the task, stepped together, each with physics of its own."""
        from xmarl_envs.vector_env import VectorEnv  # which imports this module

        return VectorEnv(self, n_episodes, max_cycles)

    @property
    def spawn_half_width(self) -> float:
        """m. Above 8 agents the square grows so that the density stays that of 8."""
        return max(1.0, float(np.sqrt(self.n_agents / 8)))

    @property
    def bound(self) -> float | None:
        """m. Centres stay within [-bound, bound]^2; None where the plane is open."""
        return None

    @abstractmethod
    def spawn(self, rng: np.random.Generator) -> Layout:
        """Draw the start of an episode. Nothing else in an episode is random."""

    @abstractmethod
    def observe(self, state: State) -> Floats:
        """(B, N, obs_dim): what each agent observes. Must not depend on any other agent."""

    @abstractmethod
    def judge(self, before: Floats, state: State, contacts: Floats) -> Outcome:
        """Reward and ending of a step.

        before: (B, N, 2) positions before the step; contacts: (B, N) colliding partners of each agent.
        """


def distance(a: Floats, b: Floats) -> Floats:
    """(..., 2), (..., 2) -> (...) Euclidean distance. Written out: the bits do not depend on the batch."""
    apart = a - b
    apart *= apart
    length: Floats = np.sqrt(apart[..., 0] + apart[..., 1])
    return length


def scatter(rng: np.random.Generator, n_points: int, half_width: float, spacing: float) -> Floats:
    """(n_points, 2) uniform in the square, pairwise at least `spacing` apart (each drawn until it fits).

    Raises RuntimeError if the square is too crowded.
    """
    points: list[tuple[float, float]] = []
    for _ in range(_TRIES):
        # As many as still lack a place: never more than are needed, whatever fits.
        for x, y in rng.uniform(-half_width, half_width, (n_points - len(points), 2)).tolist():
            for a, b in points:
                if abs(x - a) < spacing and sqrt((x - a) * (x - a) + (y - b) * (y - b)) < spacing:
                    break
            else:
                points.append((x, y))
        if len(points) == n_points:
            return np.array(points).reshape(n_points, 2)
    raise RuntimeError(f"no room for {n_points} points {spacing} m apart within +-{half_width} m")
