"""Which metrics of a request's cell are null, and the reason for each."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite, isnan

import torch

from xmarl_bench.explain.oracle import why_no_oracle
from xmarl_bench.metrics.table import METRICS, Need
from xmarl_bench.policy import GraphPolicy
from xmarl_bench.rollout.cell import Cell
from xmarl_bench.rollout.episodes import Episode
from xmarl_bench.scoring.behaviour import why_no_behaviour
from xmarl_bench.scoring.measure import Shared
from xmarl_bench.scoring.request import Request
from xmarl_bench.tasks.parallel_task import AGENT_COLLISION, OBJECT_COLLISION, SUCCESS_KEYS


def not_measured(
    request: Request, cell: Cell, episodes: Sequence[Episode], shared: Sequence[Shared]
) -> dict[str, str]:
    """Metric -> reason, without a full stop. episodes: those that are scored. shared: measured in each."""
    policy, explainer, n_agents = request.policy, request.explainer, cell.n_agents
    unknown = "needs a policy with one layer of one head, whose coefficients are known"
    deterministic = request.card.architecture.distribution == "deterministic"
    no_distribution = "the policy is deterministic: it has no distribution to compare"
    few = "needs {} agents, so that there is something to rank"
    keys = f"{', '.join(SUCCESS_KEYS[:-1])} or {SUCCESS_KEYS[-1]}"
    not_played = (
        why_no_behaviour(explainer, n_agents) or "not asked for, since it asks the explainer at every step"
    )
    finite = any(isfinite(episode.reward) for episode in episodes)
    hits = _untold("no_object_collision", OBJECT_COLLISION, episodes)
    # The reason why a need is not met; None or empty if it is met.
    reasons: dict[Need, str | None] = {
        Need.TWO_AGENTS: few.format(2) if n_agents < 2 else None,
        Need.THREE_AGENTS: few.format(3) if n_agents < 3 else None,
        Need.ORACLE: why_no_oracle(policy, n_agents),
        Need.COEFFICIENTS: None if isinstance(policy, GraphPolicy) else unknown,
        Need.DISTRIBUTION: no_distribution if deterministic else None,
        Need.SEEDS: None if explainer.stochastic else "the explainer says that it is not stochastic",
        Need.PLAYED: None if request.behaviours(cell) else not_played,
        Need.REWARDS: None if finite else "every episode has a reward that is NaN or infinite",
        Need.SUCCESS: _untold("success_rate", keys, episodes),
        Need.COLLISIONS: _untold("no_agent_collision", AGENT_COLLISION, episodes),
        Need.WALLS: hits if cell.make().has_objects else "the task has no walls",
        Need.ATTENTION: policy.why_no_attention(torch.tensor(episodes[0].observations[:1])),
        Need.SHARES: _no_shares(shared),
    }
    first = {metric.name: next(filter(None, map(reasons.get, metric.needs)), None) for metric in METRICS}
    return {name: reason for name, reason in first.items() if reason is not None}


def _no_shares(shared: Sequence[Shared]) -> str | None:
    """The reason if attention sums to 1 in no episode."""
    if any(each.policy.attention_entropy is not None for each in shared):
        return None
    return "the coefficients of the policy's attention do not sum to 1"


def _untold(metric: str, keys: str, episodes: Sequence[Episode]) -> str | None:
    """The reason if the metric is not a number in any episode."""
    if any(not isnan(getattr(episode, metric)) for episode in episodes):
        return None
    return f"the infos of the task's agents hold no {keys}"
