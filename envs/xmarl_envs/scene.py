"""What a picture shows: one moment of an episode, and the steps before it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from xmarl_envs.task import Bools, Floats, State, Step

Picture = NDArray[np.uint8]


class Drawable(Protocol):
    """What a picture needs to know of a task. `Task` meets it."""

    @property
    def name(self) -> str: ...
    @property
    def n_agents(self) -> int: ...
    @property
    def radius(self) -> float: ...  # m, of an agent
    @property
    def bound(self) -> float | None: ...  # m, see `Task.bound`
    @property
    def spawn_half_width(self) -> float: ...  # m
    @property
    def wall_size(self) -> tuple[float, float]: ...  # m


@dataclass(frozen=True)
class Scene:
    """One moment of one episode of N agents. Holds copies, so the episode may go on."""

    track: Floats  # (L, N, 2) m, positions from the start (or a while ago) to now; L >= 1
    targets: Floats  # (T, 2) m
    walls: Floats  # (W, 2) m, centres
    cycle: int  # steps taken
    reward: float  # of the last step, mean over agents
    total: float  # of all steps so far
    collided: Bools  # (N,) touched another agent or a wall in the last step
    ended: str = ""  # why the episode is over, in a word or two; empty while it goes on
    backdrop: Picture | None = None  # (H, W, 3), drawn in the middle behind the agents


class Track:
    """Follows one episode of a batch from its start, for pictures."""

    def __init__(self, state: State, episode: int = 0, backdrop: Picture | None = None) -> None:
        self._episode = episode
        self._targets, self._walls = state.targets[episode].copy(), state.walls[episode].copy()
        self._positions = [state.position[episode].copy()]
        self._rewards, self._totals = [0.0], [0.0]
        self._collided: list[Bools] = [np.zeros(state.position.shape[1], dtype=np.bool_)]
        self._backdrops = [backdrop]
        self._ended = ""

    @property
    def cycles(self) -> int:
        """Steps so far."""
        return len(self._positions) - 1

    def add(self, state: State, step: Step, backdrop: Picture | None = None) -> None:
        """Record the step just taken and the state after it. NaN counts as no collision."""
        k = self._episode
        self._positions.append(state.position[k].copy())
        self._rewards.append(float(step.reward[k].mean()))
        self._totals.append(self._totals[-1] + self._rewards[-1])
        self._collided.append((step.agent_collision[k] == 1) | (step.object_collision[k] == 1))
        self._backdrops.append(backdrop)
        self._ended = "done" if step.terminated[k] else "time is over" if step.truncated[k] else ""

    def scene(self, cycle: int | None = None) -> Scene:
        """The scene after `cycle` steps; by default after the last one."""
        cycle = self.cycles if cycle is None else cycle
        return Scene(
            track=np.stack(self._positions[: cycle + 1]),
            targets=self._targets,
            walls=self._walls,
            cycle=cycle,
            reward=self._rewards[cycle],
            total=self._totals[cycle],
            collided=self._collided[cycle],
            ended=self._ended if cycle == self.cycles else "",
            backdrop=self._backdrops[cycle],
        )
