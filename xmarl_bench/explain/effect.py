"""The effect of messages: a scalar per agent that gradients, Shapley values and Captum attribute to messages.

    e_i(m) = sum over action entries of sign(F_i(1) - F_i(0)) * (F_i(m) - F_i(0)) / A

is how far the action under m has moved in the direction in which all messages together move it. e_i(0) = 0,
and e_i(1) is d_i(0), the mean absolute change from removing all messages. While no entry overshoots F_i(1),
e_i(m) = d_i(0) - d_i(m), with the d_i of the fidelities. For discrete actions, F_i are the probabilities and
2 replaces A: d_i is the total variation distance, and the same holds.

S is the number of timesteps, N agents, A action entries.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from xmarl_bench.metrics import categorical_kl, kl_divergence
from xmarl_bench.policy import ActionDistribution, Policy

NORMALISER = "0.5 + a / (2 max |a|) over the row"  # the formula of `signed_to_unit`, as entries record it


def action_change(full: ActionDistribution, other: ActionDistribution) -> Tensor:
    """(..., N): d_i, as `prediction_change` of the fidelities, but differentiable."""
    return (full.action - other.action).abs().sum(dim=-1) / full.divisor


def action_divergence(full: ActionDistribution, other: ActionDistribution) -> NDArray[np.float64]:
    """(..., N): KL(full || other) in nats, of the Normals under the tanh or of the categoricals.

    NaN for a deterministic policy, which has no distribution to compare.
    """
    if full.kind == "deterministic":
        return np.full(torch.broadcast_shapes(full.loc.shape, other.loc.shape)[:-1], math.nan)
    if full.kind == "categorical":
        return categorical_kl(full.loc.numpy(), other.loc.numpy())
    return kl_divergence(*(part.numpy() for part in (full.loc, full.scale, other.loc, other.scale)))


def effect_direction(policy: Policy, prepared: Any) -> Tensor:
    """(S, N, A): sign(F_i(1) - F_i(0)) / A, so that e_i is its product with F_i, up to a constant."""
    with torch.no_grad():
        full = policy.decode(prepared)
        n_steps, n_agents, _ = full.loc.shape
        silent = policy.decode(prepared, full.loc.new_zeros(n_steps, n_agents, n_agents))
    return torch.sign(full.action - silent.action) / full.divisor


def signed_to_unit(attribution: Tensor) -> Tensor:
    """(..., N, N) -> [0, 1]: 0.5 + a / (2 max |a|) over each row.

    Keeps order and sign: a message above 0.5 moves the action in the direction of all messages together, one
    below 0.5 against it. A row of zeros becomes 0.5.
    """
    largest = attribution.abs().amax(dim=-1, keepdim=True)
    return 0.5 + attribution / (2 * torch.where(largest > 0, largest, 1.0))


def share_of_largest(attribution: Tensor) -> Tensor:
    """(..., N, N), not negative -> [0, 1]: a / max a over each row. A row of zeros is unchanged."""
    largest = attribution.amax(dim=-1, keepdim=True)
    return attribution / torch.where(largest > 0, largest, 1.0)
