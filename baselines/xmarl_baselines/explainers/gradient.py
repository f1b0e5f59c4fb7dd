"""Gradient: how fast the action moves when one message is scaled down.

Paper: Simonyan et al., "Deep Inside Convolutional Networks" (ICLR workshop 2014), for inputs. Here it is
taken with respect to the factor on each message, as in PyG's and Captum's edge masks. Formula:

    a_ij = d e_i(m) / d m_ij  at m = 1,

with the effect e_i of xmarl_bench.explain.effect: how far agent i's action has moved in the direction in
which all messages together move it. In a policy of several layers the sum of e over all agents is
differentiated.

Departures: signed, where saliency takes absolute values. The mask is 0.5 + a / (2 max |a|) over the row,
which keeps order and sign. Since the factor is 1, this is also gradient times input.
"""

from __future__ import annotations

import torch
from torch import Tensor

from xmarl_baselines.explainers.batching import by_chunks
from xmarl_baselines.explainers.frozen_policy import frozen
from xmarl_bench.explain.effect import NORMALISER, effect_direction, signed_to_unit
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.explain.messages_only import messages_only
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.policy import Policy


def gradient_at(policy: Policy, observations: Tensor, levels: list[float]) -> Tensor:
    """One chunk: (S, N, D) -> (S, N, N), the mean over `levels` of the gradient at m = level everywhere."""
    n_steps, n_agents, _ = observations.shape
    with torch.no_grad():
        prepared = policy.prepare(observations)
    direction = effect_direction(policy, prepared)
    total = observations.new_zeros(n_steps, n_agents, n_agents)
    for level in levels:
        with torch.enable_grad():
            mask = torch.full_like(total, level, requires_grad=True)
            effect = (policy.decode(prepared, mask).action * direction).sum()
            total += torch.autograd.grad(effect, mask)[0]
    return total / len(levels)


def gradient_mask(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    """(S, N, D) -> (S, N, N)."""
    policy = frozen(policy)
    return by_chunks(
        observations, lambda steps: signed_to_unit(gradient_at(policy, observations[steps], [1.0]))
    )


gradient = Explainer(
    "gradient",
    gradient_mask,
    "gradient of each agent's action along what messages do to it",
    hyperparameters={"normaliser": NORMALISER},
    absence=Absence.ZERO,
)

gradient_messages = messages_only(gradient)
