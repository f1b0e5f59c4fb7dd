"""Which metrics of a request's cell are null, and why: an absent number says its reason."""

from __future__ import annotations

from torch import Tensor
from xmarl_envs import TASKS

from xmarl_bench.entry.aggregation import BEHAVIOUR
from xmarl_bench.errors import InputError
from xmarl_bench.explain.oracle import why_no_oracle
from xmarl_bench.policy import GraphPolicy
from xmarl_bench.rollout.cell import Cell
from xmarl_bench.scoring.behaviour import why_no_behaviour
from xmarl_bench.scoring.request import Request


def not_measured(request: Request, cell: Cell, observations: Tensor) -> dict[str, str]:
    """Metric -> why, without a full stop. observations: (S, N, D), any of the cell's, to see what attends."""
    reasons: dict[str, str] = {}
    no_oracle = why_no_oracle(request.policy, cell.n_agents)
    if no_oracle is not None:
        reasons |= dict.fromkeys(("budgeted_fidelity", "comm_budgeted_fidelity"), no_oracle)
    if no_oracle is not None or not isinstance(request.policy, GraphPolicy):
        reason = no_oracle or "needs a policy with one layer of one head, whose coefficients are known"
        reasons |= dict.fromkeys(("renorm_topk_fid_delta", "renorm_budgeted_fidelity"), reason)
    if request.card.architecture.distribution == "deterministic":
        reasons |= dict.fromkeys(
            ("gef", "median_kl", "comm_gef"), "the policy is deterministic: it has no distribution to compare"
        )
    for prefix, least in (("", 2), ("comm_", 3), ("renorm_", 2)):
        if cell.n_agents < least:
            names = (f"{prefix}topk_fid_delta", f"{prefix}budgeted_fidelity")
            reasons |= dict.fromkeys(names, f"needs {least} agents, so that there is something to rank")
    if not request.explainer.explainer.stochastic:
        reasons["seed_stability"] = "the explainer says that it is not stochastic"
    if not request.behaviours(cell):
        reason = why_no_behaviour(cell.n_agents) or "not asked for, since it asks the explainer at every step"
        reasons |= dict.fromkeys(BEHAVIOUR, reason)
    if not TASKS[cell.task].n_walls:
        reasons["no_object_collision"] = "the task has no walls"
    try:
        request.policy.attention(observations)
    except InputError as error:
        reasons |= dict.fromkeys(("attention_entropy", "attention_distance"), str(error))
    return reasons
