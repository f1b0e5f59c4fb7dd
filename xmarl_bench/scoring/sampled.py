"""Scores rankings between estimates of a random one and of the best: see explain/sampled_oracle.py.

S is the number of timesteps, N agents, D observation entries, K budgets: k = 1 .. M - 1 of M senders.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from xmarl_bench.explain.absence import DRAWS, Removal, stand_ins
from xmarl_bench.explain.oracle import chunks
from xmarl_bench.explain.sampled_oracle import (
    Best,
    Edges,
    ascend,
    greedy,
    kept_by,
    random_orders,
    ranks,
    standard_error,
)
from xmarl_bench.metrics import budgeted_fidelity
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.policy import GraphPolicy, Policy
from xmarl_bench.policy.interface import NoAttentionError
from xmarl_bench.scoring.rankings import Floats, Ranked, Rankings

Bools = NDArray[np.bool_]


class Stretch(NamedTuple):
    """Timesteps decoded at once."""

    steps: slice
    edges: Edges
    removal: Removal


@dataclass(frozen=True)
class Sample:
    """Random masks and the best masks found by a search, under one absence model."""

    stretches: Sequence[Stretch]
    drawn: NDArray[np.int64]  # (ORDERS, S, N, N): places of the senders in the random orders
    random: Floats | None = None  # (K,); None without a search
    random_error: Floats | None = None
    oracle: Floats | None = None
    best: Tensor | None = None  # (S, N, N): the best binary mask found

    def searched(self, attention: NDArray[np.int64] | None, *, row_wise: bool) -> Sample:
        """With random@k and oracle@k. attention: (1, S, N, N), places by it; None if the policy has none."""
        parts = [self._search(each, attention, row_wise=row_wise) for each in self.stretches]
        delta = np.concatenate([drawn for drawn, _, _ in parts], axis=2)
        oracle = np.concatenate([best.value for _, best, _ in parts], axis=1).mean(axis=(1, 2))
        return Sample(
            self.stretches,
            self.drawn,
            delta.mean(axis=(0, 2, 3)),
            standard_error(delta, row_wise=row_wise),
            oracle,
            torch.from_numpy(np.concatenate([mask for _, _, mask in parts])).float(),
        )

    def score(self, places: NDArray[np.int64]) -> Ranked:
        """(D, S, N, N): places of the senders in each order that the mask allows."""
        if self.random is not None and np.array_equal(places, self.drawn):  # the mask ranks nothing
            explained = self.random
        else:
            parts = [_fid_delta(each, places) for each in self.stretches]
            explained = np.concatenate(parts, axis=2).mean(axis=(0, 2, 3))
        if self.random is None or self.oracle is None:
            return Ranked(explained, None, None, math.nan)
        oracle = np.maximum(self.oracle, explained)  # the best known, including this mask
        budgeted = budgeted_fidelity(explained, self.random, oracle)
        return Ranked(explained, self.random, oracle, budgeted, self.random_error)

    def _search(
        self, stretch: Stretch, attention: NDArray[np.int64] | None, *, row_wise: bool
    ) -> tuple[Floats, Best, Bools]:
        """FidDelta of the random masks (D, K, s, N), the best of each budget, the best of all (s, N, N)."""
        steps, edges, removal = stretch
        best, drawn = Best.none(edges, row_wise=row_wise), _fid_delta(stretch, self.drawn)
        for places, delta in zip(self.drawn[:, steps], drawn, strict=True):
            best.take(kept_by(places, edges), delta)
        if attention is not None:
            best.take(kept_by(attention[0, steps], edges), _fid_delta(stretch, attention)[0])
        for rising in (True, False):
            greedy(removal, edges, best, rising=rising)
        if not row_wise:
            ascend(removal, edges, best)
        return drawn, best, best.of_all(removal, edges)


def _fid_delta(stretch: Stretch, places: NDArray[np.int64]) -> Floats:
    """(D, S, N, N) -> (D, K, s, N): FidDelta of the first k of every row, for this stretch."""
    steps, edges, removal = stretch
    return np.stack([edges.fid_delta(removal, kept_by(each, edges)) for each in places[:, steps]])


@dataclass(frozen=True)
class Sampled:
    """Scores masks if rows are too many to try, or not independent. Without a search: FidDelta@k only."""

    orders: Floats  # (ORDERS, S, N, N)
    all_edges: Sample
    messages: dict[Absence, Sample]

    @classmethod
    @torch.no_grad()
    def of(
        cls,
        policy: Policy,
        observations: Tensor,
        edges: Bools | None,
        reference: Tensor | None,
        rng: np.random.Generator,
        *,
        search: bool,
    ) -> Sampled:
        """edges: (S, N, N); None: all. reference: (Q, N, D); None: measure zero only."""
        n_steps, n_agents, _ = observations.shape
        existing = np.ones((n_steps, n_agents, n_agents), dtype=bool) if edges is None else edges
        orders = random_orders(n_steps, n_agents, rng)
        attention = _attention(policy, observations) if search else None

        messages = torch.empty(0)
        models = [Absence.ZERO]
        if isinstance(policy, GraphPolicy) and reference is not None and search:
            messages, models = policy.prepare(reference).message, list(Absence)

        def sample(absence: Absence, *, own_kept: bool) -> Sample:
            whole = Edges.of(existing, own_kept=own_kept)
            replaced = list(stand_ins(absence, messages, (DRAWS, n_steps), rng))
            stretches = [
                Stretch(
                    steps,
                    whole.at(steps),
                    Removal(
                        policy,
                        observations[steps],
                        absence,
                        tuple(None if each is None else each[steps] for each in replaced),
                    ),
                )
                for steps in chunks(n_steps, n_agents, 2 * max(whole.n_budgets, 1))
            ]
            nothing = np.zeros(existing.shape)
            found = Sample(stretches, ranks(nothing, orders, whole.senders))
            if not search:
                return found
            by_attention = None if attention is None else ranks(attention, orders[:1], whole.senders)
            return found.searched(by_attention, row_wise=policy.row_wise)

        return cls(
            orders,
            sample(Absence.ZERO, own_kept=False),
            {absence: sample(absence, own_kept=True) for absence in models},
        )

    @property
    def best(self) -> Tensor | None:
        return self.all_edges.best

    def score(self, mask: Tensor) -> Rankings:
        """(S, N, N)."""
        value = mask.numpy().astype(np.float64)
        others = self._places(value, self.messages[Absence.ZERO])
        return Rankings(
            self.all_edges.score(self._places(value, self.all_edges)),
            {absence: sample.score(others) for absence, sample in self.messages.items()},
        )

    def _places(self, value: Floats, sample: Sample) -> NDArray[np.int64]:
        """Places in every order that the mask allows; one order if no two senders of a row are equal."""
        senders = np.concatenate([each.edges.senders for each in sample.stretches])
        places = ranks(value, self.orders, senders)
        alike = (np.where(senders, places, 0) == np.where(senders, places[:1], 0)).all()
        return places[:1] if alike else places


def _attention(policy: Policy, observations: Tensor) -> Floats | None:
    try:
        return np.asarray(policy.attention(observations).numpy().astype(np.float64))
    except NoAttentionError:
        return None
