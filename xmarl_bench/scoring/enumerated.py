"""Scores rankings between a random one and the best of all rows.

S is the number of timesteps, N agents, D observation entries.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from xmarl_bench.explain.absence import message_table
from xmarl_bench.explain.oracle import best_rows, change_table, mask_of
from xmarl_bench.metrics import (
    budgeted_fidelity,
    choices,
    fid_delta_at_k,
    fid_delta_table,
    oracle_at_k,
    other_senders,
    others_table,
    random_at_k,
)
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.policy import GraphPolicy, Policy
from xmarl_bench.scoring.rankings import Floats, Ranked, Rankings

Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Table:
    """Scores rankings of M senders between random and best: see xmarl_bench.metrics.budgeted_fidelity."""

    delta: Floats  # (2^M, S, N)
    random: Floats  # (M - 1,)
    oracle: Floats  # (M - 1,)
    edges: Bools | None  # (S, N, M), the senders that exist; None: all

    @classmethod
    def of(cls, change: Floats, edges: Bools | None) -> Table:
        delta = fid_delta_table(change)
        return cls(delta, random_at_k(delta, edges), oracle_at_k(delta, edges), edges)

    def score(self, share: Floats) -> Ranked:
        """The `choices` of a mask -> the score of its ranking."""
        explained = fid_delta_at_k(self.delta, share, self.edges)
        budgeted = budgeted_fidelity(explained, self.random, self.oracle)
        return Ranked(explained, self.random, self.oracle, budgeted)


@dataclass(frozen=True)
class Enumerated:
    """Scores masks from tables of all rows."""

    all_edges: Table
    messages: dict[Absence, Table]
    best: Tensor | None  # (S, N, N): the best binary mask for FidDelta

    @classmethod
    def of(
        cls,
        policy: Policy,
        observations: Tensor,
        edges: Bools | None,
        reference: Tensor | None,
        rng: np.random.Generator,
    ) -> Enumerated:
        """edges: (S, N, N); None: all. reference: (Q, N, D); None: measure zero only."""
        n_agents = observations.shape[1]
        others = None if edges is None else other_senders(edges)
        change = change_table(policy, observations)
        messages = {Absence.ZERO: Table.of(others_table(change), others)}
        if isinstance(policy, GraphPolicy) and reference is not None:
            for absence in Absence:
                if absence is not Absence.ZERO:
                    table = message_table(policy, observations, absence, reference, rng)
                    messages[absence] = Table.of(table, others)
        best = mask_of(best_rows(change, edges), n_agents)
        return cls(Table.of(change, edges), messages, best)

    def score(self, mask: Tensor) -> Rankings:
        """(S, N, N)."""
        senders = mask.numpy()
        share = choices(other_senders(senders), self.messages[Absence.ZERO].edges)
        return Rankings(
            self.all_edges.score(choices(senders, self.all_edges.edges)),
            {absence: table.score(share) for absence, table in self.messages.items()},
        )
