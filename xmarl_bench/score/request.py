"""What to score, checked before anything runs: which policy and explainer, on which states."""

from __future__ import annotations

from dataclasses import dataclass

from xmarl_envs import TASKS, Task, make_task

from xmarl_bench.errors import InputError
from xmarl_bench.plugins.registry import FoundExplainer, check_task
from xmarl_bench.policy import Policy, PolicyCard
from xmarl_bench.reproducible import episode_seeds
from xmarl_bench.score.behaviour import why_no_behaviour


@dataclass(frozen=True)
class Cell:
    """A task with a team size. Raises InputError for an unknown task or a team it does not take."""

    task: str
    n_agents: int

    def __post_init__(self) -> None:
        check_task(self.task)
        most = TASKS[self.task].max_agents
        if not 1 <= self.n_agents <= most:
            raise InputError(
                f"{self.task} takes 1 to {most} agents, got {self.n_agents}: choose a number in that range."
            )

    def make(self) -> Task:
        return make_task(self.task, self.n_agents)


@dataclass(frozen=True)
class Sampling:
    """Which states are scored. Entries of different sampling do not share a table."""

    episodes: int = 50
    timesteps: int | None = None  # at most so many of each episode, evenly spaced; None is all
    max_cycles: int | None = None  # steps per episode; None is the task's own number
    seed: int = 0  # of the episodes, and of the explainers' randomness

    def __post_init__(self) -> None:
        episode_seeds(self.seed, self.episodes)
        for name in ("timesteps", "max_cycles"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise InputError(
                    f"{name} must be at least 1, got {value}: choose a larger one, or leave it out."
                )

    @property
    def seeds(self) -> list[int]:
        return episode_seeds(self.seed, self.episodes)


@dataclass(frozen=True)
class Request:
    """One entry to be made. Raises InputError where the policy does not fit a cell."""

    policy: Policy
    card: PolicyCard
    explainer: FoundExplainer
    cells: tuple[Cell, ...]
    sampling: Sampling
    # Episodes that the team also plays on the explanation: it is asked for at every step, which costs an
    # optimising explainer far more than all of its other metrics. None is all, but none for slow explainers.
    behaviour_episodes: int | None = None

    def __post_init__(self) -> None:
        for cell in self.cells:
            check_fit(self.card, cell)
        if self.behaviour_episodes is not None and self.behaviour_episodes < 0:
            raise InputError(
                f"behaviour_episodes must be at least 0, got {self.behaviour_episodes}: 0 leaves them out."
            )

    def behaviours(self, cell: Cell) -> int:
        """How many episodes of the cell are played on the explanation."""
        if why_no_behaviour(cell.n_agents) is not None:
            return 0
        if self.behaviour_episodes is None:
            return 0 if self.explainer.explainer.slow else self.sampling.episodes
        return min(self.behaviour_episodes, self.sampling.episodes)


def check_fit(card: PolicyCard, cell: Cell) -> None:
    """Raises InputError where the policy cannot act in the cell."""
    task = cell.make()
    if card.architecture.obs_dim != task.obs_dim:
        raise InputError(
            f"policy {card.name!r} takes observations of {card.architecture.obs_dim} entries, {cell.task} "
            f"gives {task.obs_dim}: choose a policy trained for {cell.task}."
        )
    if card.architecture.action_dim != 2:
        raise InputError(
            f"policy {card.name!r} has {card.architecture.action_dim} action entries, {cell.task} takes 2: "
            f"choose a policy trained for {cell.task}."
        )
    card.architecture.graph.check(cell.n_agents, task.obs_dim)
    if card.task != cell.task:
        raise InputError(
            f"policy {card.name!r} was trained for {card.task}, not for {cell.task}: "
            f"choose a policy trained for that task."
        )
