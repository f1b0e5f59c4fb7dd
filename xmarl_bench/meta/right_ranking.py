"""The right ranking of messages: the truth of planted policies, Shapley values of trained ones.

On a trained policy the relevant messages are unknown. The best substitute is each message's exact Shapley
value, from the table of the effects of all sets of kept messages: unlike occlusion, it detects redundancy.
But it needs an absence model, and a metric under the same model would be tested on its own definition (at N =
3 the two are identical). So a ranking under one absence model tests only metrics under the others.

S is the number of timesteps, N agents, M = N - 1 senders.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from xmarl_bench.explain.oracle import change_table
from xmarl_bench.meta.degradation import with_messages
from xmarl_bench.metrics import fid_delta_table, others_table
from xmarl_bench.planted.families import Planted
from xmarl_bench.policy import Policy

Floats = NDArray[np.float64]


def shapley_values(delta: Floats) -> Floats:
    """(2^M, S, N) FidDelta of every set of kept messages -> (S, N, M) Shapley value of each.

    It is twice the value in the game -d (how near the action is to that of all messages): FidDelta is
    that game plus its dual, up to a constant, and both have the same values.
    """
    n_rows = len(delta)
    n_senders = n_rows.bit_length() - 1
    rows = np.arange(n_rows)
    size = np.bitwise_count(rows)
    values = np.empty((*delta.shape[1:], n_senders))
    for j in range(n_senders):
        without = rows[(rows >> j & 1) == 0]
        weight = np.array([1.0 / (n_senders * math.comb(n_senders - 1, k)) for k in size[without]])
        values[..., j] = np.tensordot(weight, delta[without | 1 << j] - delta[without], axes=1)
    return values


def ranking_mask(values: Floats) -> Tensor:
    """(S, N, M) values of messages -> (S, N, N) mask: 1 the first of a row, 0 the last; own edges 1."""
    from scipy.stats import rankdata

    n_steps, n_agents, n_senders = values.shape
    place = (rankdata(values, axis=-1) - 1.0) / (n_senders - 1)
    return with_messages(torch.ones(n_steps, n_agents, n_agents), place)


def shapley_mask(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    """(S, N, D) -> (S, N, N): an explainer that ranks messages by their Shapley values under `zero`."""
    return ranking_mask(shapley_values(fid_delta_table(others_table(change_table(policy, observations)))))


def true_mask(truth: Planted) -> Tensor:
    """(S, N, N): 1 for relevant messages and own edges, 0 for others; 0.5 where the rule does not apply."""
    n_agents = truth.relevant.shape[-1]
    mask = np.where(truth.counted[..., None], truth.relevant, 0.5) + 0.0
    mask[:, np.arange(n_agents), np.arange(n_agents)] = 1.0
    return torch.from_numpy(mask).float()
