"""Computations that the metrics of all explainers on the same states share: F(1), the oracle's tables.

S is the number of timesteps explained, N agents, D observation entries.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from xmarl_bench.entry.schema import BudgetRow, ExplanationRow, PolicyRow
from xmarl_bench.errors import InputError
from xmarl_bench.explain.absence import message_table
from xmarl_bench.explain.effect import action_divergence
from xmarl_bench.explain.oracle import best_rows, change_table, mask_of, why_no_oracle
from xmarl_bench.metrics import (
    Fidelity,
    attention_distance,
    attention_entropy,
    budgeted_fidelity,
    choices,
    fid_delta_at_k,
    fid_delta_table,
    fidelity,
    graph_explanation_unfaithfulness,
    mask_mass,
    mask_of_senders,
    oracle_at_k,
    other_senders,
    others_table,
    over_absences,
    prediction_change,
    random_at_k,
    top_k_rows,
)
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.policy import ActionDistribution, GraphPolicy, Policy, existing_edges

Floats = NDArray[np.float64]
Edges = NDArray[np.bool_]


@dataclass(frozen=True)
class Ranking:
    """Scores rankings of M senders between random and best: see xmarl_bench.metrics.budgeted_fidelity."""

    delta: Floats  # (2^M, S, N) FidDelta of every row
    random: Floats  # (M - 1,)
    oracle: Floats  # (M - 1,)
    edges: Edges | None  # (S, N, M), the senders that exist; None: all

    @classmethod
    def of(cls, change: Floats, edges: Edges | None) -> Ranking:
        delta = fid_delta_table(change)
        return cls(delta, random_at_k(delta, edges), oracle_at_k(delta, edges), edges)

    def score(self, share: Floats) -> Ranked:
        """The `choices` of a mask -> the score of its ranking."""
        explained = fid_delta_at_k(self.delta, share, self.edges)
        budgeted = budgeted_fidelity(explained, self.random, self.oracle)
        return Ranked(explained, self.random, self.oracle, budgeted)


@dataclass(frozen=True)
class Ranked:
    """FidDelta@k, k = 1 .. M - 1, of a mask, of a random ranking and of the best; None without a table."""

    explained: Floats
    random: Floats | None
    oracle: Floats | None
    budgeted: float

    @property
    def mean(self) -> float:
        return float(self.explained.mean()) if self.explained.size else math.nan

    def record(self) -> BudgetRow:
        random, oracle = (None if curve is None else _numbers(curve) for curve in (self.random, self.oracle))
        return BudgetRow(explained=_numbers(self.explained), random=random, oracle=oracle)


@dataclass(frozen=True)
class Rankings:
    """Scores of a mask's rankings: of all edges, and of messages under each absence model measured."""

    all_edges: Ranked
    messages: dict[Absence, Ranked]  # zero first

    def records(self) -> dict[str, BudgetRow]:
        """The budgets in the row of an episode."""
        under = {f"{absence.prefix}_budget": each.record() for absence, each in self.messages.items()}
        return {"budget": self.all_edges.record(), **under}


@dataclass(frozen=True)
class States:
    """The explained states of one episode, with everything that does not depend on the mask."""

    policy: Policy
    observations: Tensor  # (S, N, D)
    edges: Edges | None  # (S, N, N), edges of the policy's graph; None: the complete graph
    prepared: Any
    full: ActionDistribution  # F(1)
    noise: Floats  # (S, N, N): breaks ties of masks if there is no table, in the same way for all masks
    all_edges: Ranking | None  # None if the policy or the team has no oracle
    messages: dict[Absence, Ranking]  # for each absence model that can be measured
    oracle_mask: Tensor | None  # (S, N, N)

    @classmethod
    @torch.no_grad()
    def of(
        cls, policy: Policy, observations: Tensor, rng: np.random.Generator, reference: Tensor | None = None
    ) -> States:
        """reference: (Q, N, D), states whose messages replace removed ones; None: measure zero only."""
        n_steps, n_agents, _ = observations.shape
        edges = existing_edges(policy, observations)
        others = None if edges is None else other_senders(edges)
        noise = rng.random((n_steps, n_agents, n_agents))
        all_edges = oracle = None
        messages: dict[Absence, Ranking] = {}
        if why_no_oracle(policy, n_agents) is None:
            change = change_table(policy, observations)
            all_edges = Ranking.of(change, edges)
            oracle = mask_of(best_rows(change, edges), n_agents)
            messages[Absence.ZERO] = Ranking.of(others_table(change), others)
            if isinstance(policy, GraphPolicy) and reference is not None:
                for absence in Absence:
                    if absence is not Absence.ZERO:
                        table = message_table(policy, observations, absence, reference, rng)
                        messages[absence] = Ranking.of(table, others)
        prepared = policy.prepare(observations)
        return cls(
            policy=policy,
            observations=observations,
            edges=edges,
            prepared=prepared,
            full=policy.decode(prepared),
            noise=noise,
            all_edges=all_edges,
            messages=messages,
            oracle_mask=oracle,
        )

    @torch.no_grad()
    def mask_metrics(self, mask: Tensor) -> ExplanationRow:
        """Metrics of a mask (S, N, N) over the S timesteps; None for a metric that is not a number."""
        return self._values(mask, self._rankings(mask), *self._sides(mask))

    @torch.no_grad()
    def with_inverse(self, mask: Tensor) -> tuple[ExplanationRow, dict[str, BudgetRow], ExplanationRow]:
        """Metrics of a mask, its FidDelta at every budget, and metrics of 1 - mask.

        The inverse needs no forward pass of its own, because one mask drops what the other keeps.
        """
        kept, dropped, heard, unheard = self._sides(mask)
        rankings, inverse = self._rankings(mask), 1.0 - mask
        return (
            self._values(mask, rankings, kept, dropped, heard, unheard),
            rankings.records(),
            self._values(inverse, self._rankings(inverse), dropped, kept, unheard, heard),
        )

    def _rankings(self, mask: Tensor) -> Rankings:
        senders = mask.numpy()
        others = other_senders(senders)
        if self.all_edges is None:  # no tables
            own = torch.eye(mask.shape[-1])
            return Rankings(
                self._by_forwards(senders, self.noise, torch.zeros_like(own)),
                {Absence.ZERO: self._by_forwards(others, other_senders(self.noise), own)},
            )
        share = choices(others, self.messages[Absence.ZERO].edges)
        return Rankings(
            self.all_edges.score(choices(senders, self.edges)),
            {absence: ranking.score(share) for absence, ranking in self.messages.items()},
        )

    def _sides(self, mask: Tensor) -> Iterator[ActionDistribution]:
        """F of the mask and of its complement, then of both with every agent's own edge kept."""
        own = torch.eye(mask.shape[-1]).expand_as(mask)
        masks = (mask, 1.0 - mask, torch.maximum(mask, own), torch.maximum(1.0 - mask, own))
        return map(self._decode, masks)

    def _values(
        self,
        mask: Tensor,
        rankings: Rankings,
        kept: ActionDistribution,
        dropped: ActionDistribution,
        heard: ActionDistribution,
        unheard: ActionDistribution,
    ) -> ExplanationRow:
        fid, comm = self._fidelity(kept, dropped), self._fidelity(heard, unheard)
        kl, comm_kl = action_divergence(self.full, kept), action_divergence(self.full, heard)
        all_edges, messages = rankings.all_edges, rankings.messages
        budgeted = {absence: each.budgeted for absence, each in messages.items()}
        mean, smallest = over_absences(list(budgeted.values()))
        values = {
            "fid_plus": fid.plus.mean(),
            "fid_minus": fid.minus.mean(),
            "fid_delta": fid.delta.mean(),
            "gef": graph_explanation_unfaithfulness(kl).mean(),
            "median_kl": np.median(kl),
            "mask_mass": self._mass(mask.numpy()),
            "topk_fid_delta": all_edges.mean,
            "budgeted_fidelity": all_edges.budgeted,
            "comm_fid_plus": comm.plus.mean(),
            "comm_fid_minus": comm.minus.mean(),
            "comm_fid_delta": comm.delta.mean(),
            "comm_gef": graph_explanation_unfaithfulness(comm_kl).mean(),
            "comm_topk_fid_delta": messages[Absence.ZERO].mean,
            **{f"{each.prefix}_budgeted_fidelity": budgeted.get(each, math.nan) for each in Absence},
            "message_fidelity": mean,
            "smallest_message_fidelity": smallest,
        }
        return ExplanationRow.model_validate({name: number(value) for name, value in values.items()})

    def _mass(self, senders: NDArray[np.floating]) -> float:
        """Mask mass over the timesteps at which the graph has an edge."""
        mass = mask_mass(senders, self.edges)
        return math.nan if np.isnan(mass).all() else float(np.nanmean(mass))

    @torch.no_grad()
    def policy_metrics(self) -> PolicyRow:
        """Metrics that depend on the policy only. Those of attention are None if the policy has none."""
        n_agents = self.observations.shape[1]
        alone = self._decode(torch.eye(n_agents).repeat(len(self.observations), 1, 1))
        change = prediction_change(_action(self.full), _action(alone), self.full.divisor)
        values = {"communication_dependence": change.mean()}
        try:
            attention = self.policy.attention(self.observations).numpy()
            values["attention_entropy"] = attention_entropy(attention).mean()
            values["attention_distance"] = attention_distance(attention, self.edges).mean()
        except InputError:
            values["attention_entropy"] = values["attention_distance"] = math.nan
        return PolicyRow.model_validate({name: number(value) for name, value in values.items()})

    def _decode(self, mask: Tensor) -> ActionDistribution:
        """Decode one mask at a time: F(1) has other bits in a batch of another size."""
        return self.policy.decode(self.prepared, mask)

    def _fidelity(self, kept: ActionDistribution, dropped: ActionDistribution) -> Fidelity:
        return fidelity(_action(self.full), _action(kept), _action(dropped), self.full.divisor)

    def _by_forwards(self, senders: NDArray[np.floating], noise: Floats, always: Tensor) -> Ranked:
        """FidDelta@k by decoding each mask, without budgeted fidelity.

        always: (N, N), edges kept in both subgraph and complement.
        """
        ranked = ~always.bool().numpy()
        edges = None if self.edges is None else self.edges[:, ranked].reshape(senders.shape)
        explained = []
        for rows in top_k_rows(senders, noise, edges):
            top = torch.from_numpy(mask_of_senders(rows, ranked))
            mask = torch.maximum(top, always)
            other = torch.maximum(1.0 - mask, always)
            explained.append(self._fidelity(self._decode(mask), self._decode(other)).delta.mean())
        return Ranked(np.array(explained), None, None, math.nan)


def number(value: float) -> float | None:
    """The value; None if it is not finite, because JSON has no NaN. Means count these as `n_nan`."""
    return float(value) if math.isfinite(value) else None


def _numbers(curve: Floats) -> tuple[float | None, ...]:
    return tuple(number(value) for value in curve)


def _action(distribution: ActionDistribution) -> NDArray[np.float32]:
    return np.asarray(distribution.action.numpy())
