"""What to score: which policy and explainer, on which states. Checked before anything runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from xmarl_bench.entry.protocol import ABSENCE_EPISODES
from xmarl_bench.errors import whole_number
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.policy import GraphPolicy, Policy, PolicyCard
from xmarl_bench.policy.tensors import check_tensors
from xmarl_bench.rollout.cell import Cell, Sampling
from xmarl_bench.scoring.arguments import ALL, check_among, check_behaviour_episodes, check_fit
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
        if self.behaviour_episodes is not None:
            whole = whole_number("behaviour_episodes", self.behaviour_episodes)
            object.__setattr__(self, "behaviour_episodes", whole)
        check_behaviour_episodes(self.behaviour_episodes)

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


def plan(
    policies: Sequence[tuple[Policy, PolicyCard, tuple[Cell, ...]]],
    explainers: Sequence[Explainer],
    sampling: Sampling,
    slow: Sampling | None = None,
    *,
    behaviour_episodes: int | None = None,
    no_behaviour: Sequence[str] = (),
) -> list[Request]:
    """One request per policy and explainer.

    slow: the sampling of explainers that declare themselves slow. If the run has one, the others are scored
    on it as well as on `sampling`, because entries are compared on the same states only.
    behaviour_episodes: see `Request.behaviour_episodes`. no_behaviour: names of explainers with none of
    these, or ALL. Raises InputError if such a name is not an explainer of the run.
    """
    check_among(no_behaviour, [explainer.name for explainer in explainers])
    if slow is None or not any(explainer.slow for explainer in explainers):
        slow = sampling
    unplayed = {explainer.name for explainer in explainers if {ALL, explainer.name} & set(no_behaviour)}
    return [
        Request(policy, card, each, cells, chosen, 0 if each.name in unplayed else behaviour_episodes)
        for policy, card, cells in policies
        for each in explainers
        for chosen in dict.fromkeys((slow,) if each.slow else (sampling, slow))
    ]
