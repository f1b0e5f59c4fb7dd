"""Occlusion: leave one message out and see how far the action moves.

Paper: Zeiler and Fergus, "Visualizing and Understanding Convolutional Networks" (ECCV 2014), for image
patches. Formula: a_ij = d_i(1 without j -> i), the d_i of the fidelities where m keeps everything but that
message. In a policy of several layers, the sum of d over all agents.

Departures: messages instead of patches; the mask is a / max a over the row. Redundant messages all get 0,
because leaving out one of them changes nothing.
"""

from __future__ import annotations

import torch
from torch import Tensor

from xmarl_baselines.explainers.batching import by_chunks
from xmarl_baselines.explainers.frozen_policy import frozen
from xmarl_bench.explain.effect import action_change, share_of_largest
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.explain.messages_only import messages_only
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.policy import ActionDistribution, Policy


def changes_without(policy: Policy, observations: Tensor) -> Tensor:
    """One chunk: (S, N, D) -> (S, N, N), the change of the action without the message on each edge."""
    n_steps, n_agents, _ = observations.shape
    prepared = policy.prepare(observations)
    full = policy.decode(prepared)
    change = observations.new_empty(n_steps, n_agents, n_agents)
    for j in range(n_agents):
        if policy.row_wise:  # all receivers at once: none depends on another's row
            change[:, :, j] = _change(policy, prepared, full, (slice(None), j))
        else:
            for i in range(n_agents):
                change[:, i, j] = _change(policy, prepared, full, (i, j)).sum(dim=-1)
    return change


def _change(
    policy: Policy, prepared: object, full: ActionDistribution, edges: tuple[int | slice, int]
) -> Tensor:
    n_steps, n_agents, _ = full.loc.shape
    mask = full.loc.new_ones(n_steps, n_agents, n_agents)
    mask[(slice(None), *edges)] = 0.0
    return action_change(full, policy.decode(prepared, mask))


def occlusion_mask(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    """(S, N, D) -> (S, N, N)."""
    policy = frozen(policy)
    with torch.no_grad():
        return by_chunks(
            observations, lambda steps: share_of_largest(changes_without(policy, observations[steps]))
        )


occlusion = Explainer(
    "occlusion",
    occlusion_mask,
    "how far the action moves without each message",
    hyperparameters={"normaliser": "a / max a over the row"},
    absence=Absence.ZERO,
)

occlusion_messages = messages_only(occlusion)
