"""What to score: which policy and explainer, on which states. Checked before anything runs."""

from __future__ import annotations

from dataclasses import dataclass

from xmarl_bench.entry.protocol import ABSENCE_EPISODES
from xmarl_bench.errors import InputError
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.policy import GraphPolicy, Policy, PolicyCard
from xmarl_bench.policy.tensors import check_tensors
from xmarl_bench.rollout.cell import Cell, Sampling
from xmarl_bench.scoring.behaviour import why_no_behaviour


@dataclass(frozen=True)
class Request:
    """One entry to make. Raises InputError if the policy does not fit a cell, or is not float32."""

    policy: Policy
    card: PolicyCard
    explainer: Explainer
    cells: tuple[Cell, ...]
    sampling: Sampling
    # Episodes that the team also plays on the explanation. The explainer is called at every step, which costs
    # an optimising explainer far more than all its other metrics. None: all, or 0 for slow explainers.
    behaviour_episodes: int | None = None

    def __post_init__(self) -> None:
        check_tensors(self.policy, self.card.name)
        for cell in self.cells:
            check_fit(self.card, cell)
        if self.behaviour_episodes is not None and self.behaviour_episodes < 0:
            raise InputError(
                f"behaviour_episodes must be at least 0, got {self.behaviour_episodes}: give 0 to play none."
            )

    def behaviours(self, cell: Cell) -> int:
        """The number of episodes of the cell that are played on the explanation."""
        if why_no_behaviour(self.explainer, cell.n_agents) is not None:
            return 0
        if self.behaviour_episodes is None:
            return 0 if self.explainer.slow else self.sampling.episodes
        return min(self.behaviour_episodes, self.sampling.episodes)

    def absence_behaviours(self, cell: Cell) -> int:
        """How many of these also under absence models other than zero, which need known coefficients."""
        return min(self.behaviours(cell), ABSENCE_EPISODES) if isinstance(self.policy, GraphPolicy) else 0


def check_fit(card: PolicyCard, cell: Cell) -> None:
    """Raise InputError if the policy cannot act in the cell."""
    continuous = card.architecture.distribution != "categorical"
    task = cell.make().with_actions(continuous)
    if card.architecture.obs_dim != task.obs_dim:
        raise InputError(
            f"policy {card.name!r} takes observations of {card.architecture.obs_dim} entries, {cell.task} "
            f"gives {task.obs_dim}: choose a policy trained for {cell.task}."
        )
    if card.architecture.action_dim != task.action_width:
        entries = "action entries" if continuous else "actions to choose from"
        raise InputError(
            f"policy {card.name!r} has {card.architecture.action_dim} {entries}, {cell.task} takes "
            f"{task.action_width}: choose a policy trained for {cell.task}."
        )
    card.architecture.graph.check(cell.n_agents, task.obs_dim)
    if card.task != cell.task:
        raise InputError(
            f"policy {card.name!r} was trained for {card.task}, not for {cell.task}: "
            f"choose a policy trained for that task."
        )
