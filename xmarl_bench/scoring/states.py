"""Computations that the metrics of all explainers on the same states share: F(1) and the oracle.

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

from xmarl_bench.entry.metric_records import BudgetRow, ExplanationRow, PolicyRow
from xmarl_bench.explain.effect import action_divergence
from xmarl_bench.explain.oracle import oracle_kind
from xmarl_bench.metrics import (
    Fidelity,
    attention_distance,
    attention_entropy,
    fidelity,
    graph_explanation_unfaithfulness,
    mask_mass,
    over_absences,
    prediction_change,
)
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.policy import ActionDistribution, Policy, existing_edges
from xmarl_bench.policy.interface import NoAttentionError
from xmarl_bench.scoring.enumerated import Enumerated, Table
from xmarl_bench.scoring.rankings import Rankings, number
from xmarl_bench.scoring.sampled import Sampled

Edges = NDArray[np.bool_]


@dataclass(frozen=True)
class States:
    """The explained states of one episode, with everything that does not depend on the mask."""

    policy: Policy
    observations: Tensor  # (S, N, D)
    edges: Edges | None  # (S, N, N), edges of the policy's graph; None: the complete graph
    prepared: Any
    full: ActionDistribution  # F(1)
    oracle: Enumerated | Sampled

    @classmethod
    @torch.no_grad()
    def of(
        cls, policy: Policy, observations: Tensor, rng: np.random.Generator, reference: Tensor | None = None
    ) -> States:
        """reference: (Q, N, D), states whose messages replace removed ones; None: measure zero only."""
        kind = oracle_kind(policy, observations.shape[1])
        edges = existing_edges(policy, observations)
        subject = policy, observations, edges, reference, rng
        oracle: Enumerated | Sampled = (
            Enumerated.of(*subject)
            if kind == "enumerated"
            else Sampled.of(*subject, search=kind == "sampled")
        )
        prepared = policy.prepare(observations)
        return cls(
            policy=policy,
            observations=observations,
            edges=edges,
            prepared=prepared,
            full=policy.decode(prepared),
            oracle=oracle,
        )

    @property
    def tables(self) -> dict[Absence, Table]:
        """FidDelta of every row of messages by absence model; empty if the oracle is not enumerated."""
        return self.oracle.messages if isinstance(self.oracle, Enumerated) else {}

    @property
    def oracle_mask(self) -> Tensor | None:
        """(S, N, N): the best binary mask known; None without an oracle."""
        return self.oracle.best

    @torch.no_grad()
    def mask_metrics(self, mask: Tensor) -> ExplanationRow:
        """Metrics of a mask (S, N, N) over the S timesteps; None for a metric that is not a number."""
        return self._values(mask, self.oracle.score(mask), *self._sides(mask))

    @torch.no_grad()
    def with_inverse(self, mask: Tensor) -> tuple[ExplanationRow, dict[str, BudgetRow], ExplanationRow]:
        """Metrics of a mask, its FidDelta at every budget, and metrics of 1 - mask.

        The inverse needs no forward pass of its own, because one mask drops what the other keeps.
        """
        kept, dropped, heard, unheard = self._sides(mask)
        rankings, inverse = self.oracle.score(mask), 1.0 - mask
        return (
            self._values(mask, rankings, kept, dropped, heard, unheard),
            rankings.records(),
            self._values(inverse, self.oracle.score(inverse), dropped, kept, unheard, heard),
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
        except NoAttentionError:
            values["attention_entropy"] = values["attention_distance"] = math.nan
        return PolicyRow.model_validate({name: number(value) for name, value in values.items()})

    def _decode(self, mask: Tensor) -> ActionDistribution:
        """Decode one mask at a time: F(1) has other bits in a batch of another size."""
        return self.policy.decode(self.prepared, mask)

    def _fidelity(self, kept: ActionDistribution, dropped: ActionDistribution) -> Fidelity:
        return fidelity(_action(self.full), _action(kept), _action(dropped), self.full.divisor)


def _action(distribution: ActionDistribution) -> NDArray[np.float32]:
    return np.asarray(distribution.action.numpy())
