"""Which metrics of a request's cell are null, and the reason for each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import isnan

import torch

from xmarl_bench.explain.oracle import why_no_oracle
from xmarl_bench.metrics.table import METRICS, Need
from xmarl_bench.policy import GraphPolicy
from xmarl_bench.rollout.cell import Cell
from xmarl_bench.rollout.episodes import Episode
from xmarl_bench.scoring.behaviour import why_no_behaviour
from xmarl_bench.scoring.request import Request
from xmarl_bench.tasks.parallel_task import AGENT_COLLISION, OBJECT_COLLISION, SUCCESS_KEYS


def not_measured(request: Request, cell: Cell, episodes: Sequence[Episode]) -> dict[str, str]:
    """Metric -> reason, without a full stop. episodes: those that are scored."""
    missing = {need: why for need, why in _reasons(request, cell, episodes) if why is not None}
    return {
        metric.name: next(missing[need] for need in metric.needs if need in missing)
        for metric in METRICS
        if missing.keys() & set(metric.needs)
    }


def _reasons(request: Request, cell: Cell, episodes: Sequence[Episode]) -> Iterator[tuple[Need, str | None]]:
    """Each need with the reason why it is not met; None if it is met."""
    policy, n_agents = request.policy, cell.n_agents
    for need, least in ((Need.TWO_AGENTS, 2), (Need.THREE_AGENTS, 3)):
        few = n_agents < least
        yield need, f"needs {least} agents, so that there is something to rank" if few else None
    yield Need.ORACLE, why_no_oracle(policy, n_agents)
    known = isinstance(policy, GraphPolicy)
    reason = "needs a policy with one layer of one head, whose coefficients are known"
    yield Need.COEFFICIENTS, None if known else reason
    deterministic = request.card.architecture.distribution == "deterministic"
    reason = "the policy is deterministic: it has no distribution to compare"
    yield Need.DISTRIBUTION, reason if deterministic else None
    stochastic = request.explainer.stochastic
    yield Need.SEEDS, None if stochastic else "the explainer says that it is not stochastic"
    reason = (
        why_no_behaviour(request.explainer, n_agents)
        or "not asked for, since it asks the explainer at every step"
    )
    yield Need.PLAYED, None if request.behaviours(cell) else reason
    keys = f"{', '.join(SUCCESS_KEYS[:-1])} or {SUCCESS_KEYS[-1]}"
    yield Need.SUCCESS, _untold("success_rate", keys, episodes)
    yield Need.COLLISIONS, _untold("no_agent_collision", AGENT_COLLISION, episodes)
    nothing = None if cell.make().has_objects else "the task has no walls"
    yield Need.WALLS, nothing or _untold("no_object_collision", OBJECT_COLLISION, episodes)
    yield Need.ATTENTION, policy.why_no_attention(torch.tensor(episodes[0].observations[:1]))


def _untold(metric: str, keys: str, episodes: Sequence[Episode]) -> str | None:
    """The reason if the metric is not a number in any episode."""
    if any(not isnan(getattr(episode, metric)) for episode in episodes):
        return None
    return f"the infos of the task's agents hold no {keys}"
