"""Which metrics of a request's cell are null, and the reason for each."""

from __future__ import annotations

from collections.abc import Iterator

from torch import Tensor
from xmarl_envs import TASKS

from xmarl_bench.errors import InputError
from xmarl_bench.explain.oracle import why_no_oracle
from xmarl_bench.metrics.table import METRICS, Need
from xmarl_bench.policy import GraphPolicy
from xmarl_bench.rollout.cell import Cell
from xmarl_bench.scoring.behaviour import why_no_behaviour
from xmarl_bench.scoring.request import Request


def not_measured(request: Request, cell: Cell, observations: Tensor) -> dict[str, str]:
    """Metric -> reason, without a full stop. observations: (S, N, D), any of the cell, to test attention."""
    missing = {need: why for need, why in _reasons(request, cell, observations) if why is not None}
    return {
        metric.name: next(missing[need] for need in metric.needs if need in missing)
        for metric in METRICS
        if missing.keys() & set(metric.needs)
    }


def _reasons(request: Request, cell: Cell, observations: Tensor) -> Iterator[tuple[Need, str | None]]:
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
    yield Need.WALLS, None if TASKS[cell.task].n_walls else "the task has no walls"
    try:
        policy.attention(observations)
    except InputError as error:
        yield Need.ATTENTION, str(error)
