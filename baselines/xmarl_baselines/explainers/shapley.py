"""Shapley values of messages: each message's share of the change that all messages cause in the action.

Paper: Shapley (1953); for explanations Lundberg and Lee, "A Unified Approach to Interpreting Model
Predictions" (NeurIPS 2017); sampling after Castro et al. (2009). The game of agent i has the senders j as
players and

    v_i(K) = d_i(nothing) - d_i(K kept),     a_ij = mean over orders of v_i(those before j, and j)
                                                    - v_i(those before j),

with d_i the change of the action, as in the fidelities. A row sums to d_i(nothing)
(efficiency). FidDelta, d_i(rest) - d_i(K), is a game with twice these values: this one plus its dual.

Exact where the oracle's table of all 2^N rows exists (one message-passing layer, N <= 10). Otherwise 32
random orders per timestep and receiver. Every second order is the reverse of the one before, which cancels
much of the noise; efficiency stays exact. In a policy of several layers all N^2 edges are the players of one
game, with the sum of v over agents; for a single layer that gives the same values, row by row.

Departures: the mask is 0.5 + a / (2 max |a|) over the row, which keeps order and sign.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from xmarl_baselines.explainers.batching import by_chunks
from xmarl_baselines.explainers.frozen_policy import frozen
from xmarl_bench.explain.effect import NORMALISER, action_change, signed_to_unit
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.explain.messages_only import messages_only
from xmarl_bench.explain.oracle import change_table, why_not_enumerated
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.policy import Policy
from xmarl_bench.reproducible import timestep_seeds

PAIRS = 16  # of an order and its reverse


def exact_values(change: NDArray[np.float64]) -> NDArray[np.float64]:
    """(2^N, S, N) changes d of every binary row (xmarl_bench.explain.oracle) -> (S, N, N)."""
    n_rows, n_steps, n_agents = change.shape
    row = np.arange(n_rows)
    size = np.bitwise_count(row)
    weight = np.array([1 / (n_agents * math.comb(n_agents - 1, k)) for k in range(n_agents)])
    values = np.empty((n_steps, n_agents, n_agents))
    for j in range(n_agents):
        without = row[(row >> j & 1) == 0]
        values[:, :, j] = np.tensordot(weight[size[without]], change[without] - change[without | 1 << j], 1)
    return values


def sampled_values(policy: Policy, observations: Tensor, seeds: list[int], pairs: int) -> Tensor:
    """One chunk: (S, N, D), a seed per timestep -> (S, N, N), the mean over 2 * pairs orders."""
    n_steps, n_agents, _ = observations.shape
    # One game per row of the mask, or one over the whole mask.
    games, players = (n_agents, n_agents) if policy.row_wise else (1, n_agents**2)
    prepared = policy.prepare(observations)
    full = policy.decode(prepared)

    def change(kept: Tensor) -> Tensor:
        heard = policy.decode(prepared, kept.view(n_steps, n_agents, n_agents))
        return action_change(full, heard).view(n_steps, games, -1).sum(dim=-1)  # (S, games)

    silent = change(full.loc.new_zeros(n_steps, games, players))
    values = full.loc.new_zeros(n_steps, games, players)
    for order in _orders(seeds, pairs, games, players):
        kept, before = torch.zeros_like(values), silent
        for j in order.split(1, dim=-1):
            kept = kept.scatter(-1, j, 1.0)
            after = change(kept)
            values.scatter_add_(-1, j, (before - after)[..., None])
            before = after
    return values.view(n_steps, n_agents, n_agents) / (2 * pairs)


def _orders(seeds: list[int], pairs: int, games: int, players: int) -> Tensor:
    """(2 * pairs, S, games, players), each order followed by its reverse."""
    noise = [
        torch.rand(pairs, games, players, generator=torch.Generator().manual_seed(seed)) for seed in seeds
    ]
    forward = torch.stack(noise, dim=1).argsort(dim=-1)
    return torch.stack([forward, forward.flip(-1)], dim=1).flatten(0, 1)


def shapley_mask(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    """(S, N, D) -> (S, N, N)."""
    n_steps, n_agents, _ = observations.shape
    policy, seeds = frozen(policy), timestep_seeds(n_steps, generator)
    exact = why_not_enumerated(policy, n_agents) is None

    def explain(steps: slice) -> Tensor:
        if exact:
            values = torch.from_numpy(exact_values(change_table(policy, observations[steps])))
        else:
            values = sampled_values(policy, observations[steps], seeds[steps], PAIRS)
        return signed_to_unit(values).float()

    with torch.no_grad():
        return by_chunks(observations, explain)


shapley = Explainer(
    "shapley",
    shapley_mask,
    "Shapley values of messages, exact up to 10 agents",
    stochastic=True,  # above 10 agents or in several layers
    hyperparameters={"exact_up_to": 10, "orders": 2 * PAIRS, "normaliser": NORMALISER},
    absence=Absence.ZERO,
)

shapley_messages = messages_only(shapley)
