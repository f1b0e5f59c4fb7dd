"""The sampled oracle: for teams with too many rows to try, and for networks whose rows are not independent.

With several layers, F_i depends on the whole mask, so k edges are chosen from all rows at once. With one
layer and too many agents, masks are made in the same way, and each row counts separately.

random@k: the senders of every row are put in ORDERS random orders; the first k of each row make a mask, and
random@k is the mean of its FidDelta over the orders. It is unbiased, because all choices of k edges from
every row are equally likely. Orders come in pairs, one the reverse of the other; pairs are independent, and
their spread gives the standard error.

oracle@k: the best mask of k edges from every row that a search finds, a lower estimate of the maximum. It is
the best of

- the masks of the random orders;
- the k edges with the highest attention, if the policy has attention;
- a greedy chain that begins with no edge and adds to each row the edge that raises FidDelta most, k times;
- a greedy chain that begins with all edges and drops from each row the edge whose loss raises FidDelta most.

With one layer, all rows of a mask are searched at once, and the best is taken for each row. With several
layers, the chains change one row at a time (FidDelta is the team's), the best is taken over whole masks, and
SWEEPS sweeps of coordinate ascent follow: row by row, the best swap of two senders.

Masks decoded per timestep and absence model, for M senders in a row: 16 M for the random orders; about 2 M^2
for the chains, N times as many with several layers, and then at most 2 / 3 N M^3 for the sweeps.

S is the number of timesteps, N agents, K budgets k = 1 .. M - 1 of M senders in a row: M = N, or N - 1 if own
edges are always kept. U is the number of units over which the best is taken: N rows, or 1 mask.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from xmarl_bench.explain.absence import Removal

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

ORDERS: Final = 8  # orders: four pairs
SWEEPS: Final = 2


def random_orders(n_steps: int, n_agents: int, rng: np.random.Generator) -> Floats:
    """(ORDERS, S, N, N) in [0, 1]: lower values come earlier in an order. Orders of a pair are adjacent."""
    drawn = rng.random((ORDERS // 2, n_steps, n_agents, n_agents))
    return np.stack([drawn, 1.0 - drawn], axis=1).reshape(ORDERS, n_steps, n_agents, n_agents)


def ranks(value: Floats, orders: Floats, senders: Bools) -> NDArray[np.int64]:
    """(S, N, N), (D, S, N, N) -> (D, S, N, N): the place of each edge in its row, 0 the highest value.

    Equal values are in the order of each draw, edges that are not among `senders` (S, N, N) at the end.
    """
    falling = np.broadcast_to(np.where(senders, -value, np.inf), orders.shape)
    by_place = np.lexsort((orders, falling), axis=-1)  # the last key is the primary one
    return np.argsort(by_place, axis=-1)


def standard_error(delta: Floats, *, row_wise: bool) -> Floats:
    """(ORDERS, K, S, N) FidDelta of the random masks -> (K,): the standard error of their mean.

    Pairs of orders are independent for each row if rows are independent, else for each timestep; so are those
    of different rows, or timesteps.
    """
    units = delta if row_wise else delta.mean(axis=-1, keepdims=True)
    pairs = units.reshape(len(units) // 2, 2, *units.shape[1:]).mean(axis=1)  # (P, K, S, U)
    variance = pairs.var(axis=0, ddof=1) / len(pairs)
    n_units = units.shape[2] * units.shape[3]
    return np.asarray(np.sqrt(variance.sum(axis=(1, 2))) / n_units)


@dataclass(frozen=True)
class Edges:
    """The edges ranked in a chunk of timesteps: the senders of each row, and the number of budgets."""

    senders: Bools  # (S, N, N)
    always: Bools  # (N, N): kept in both subgraph and complement
    n_budgets: int

    def at(self, steps: slice) -> Edges:
        return Edges(self.senders[steps], self.always, self.n_budgets)

    @classmethod
    def of(cls, existing: Bools, *, own_kept: bool) -> Edges:
        """existing: (S, N, N), the graph's edges."""
        n_agents = existing.shape[-1]
        always = np.eye(n_agents, dtype=bool) & own_kept
        return cls(existing & ~always, always, max(n_agents - 1 - own_kept, 0))

    def fid_delta(self, removal: Removal, kept: Bools) -> Floats:
        """(C, S, N, N) -> (C, S, N): d_i of the complement less d_i of the kept edges."""
        if not len(kept):
            return np.zeros(kept.shape[:-1])
        sides = np.stack([kept | self.always, ~kept | self.always])
        subgraph, complement = removal.change(torch.from_numpy(sides).float())
        return np.asarray(complement - subgraph)


def kept_by(places: NDArray[np.int64], edges: Edges) -> Bools:
    """(S, N, N) places -> (K, S, N, N): the first k of each row's senders."""
    k = np.arange(1, edges.n_budgets + 1)[:, None, None, None]
    return np.asarray((places < k) & edges.senders)


@dataclass
class Best:
    """The best masks found so far for each budget, and their FidDelta."""

    row_wise: bool
    value: Floats  # (K, S, U)
    kept: Bools  # (K, S, N, N)

    @classmethod
    def none(cls, edges: Edges, *, row_wise: bool) -> Best:
        n_steps, n_agents, _ = edges.senders.shape
        return cls(
            row_wise,
            np.full((edges.n_budgets, n_steps, n_agents if row_wise else 1), -np.inf),
            np.zeros((edges.n_budgets, *edges.senders.shape), dtype=bool),
        )

    def per_unit(self, delta: Floats) -> Floats:
        """(..., S, N) FidDelta of receivers -> (..., S, U)."""
        return delta if self.row_wise else delta.mean(axis=-1, keepdims=True)

    def take(self, kept: Bools, delta: Floats) -> None:
        """Take over (K, S, N, N) masks with (K, S, N) FidDelta where they are better."""
        value = self.per_unit(delta)
        better = ~(value <= self.value) & ~np.isnan(self.value)  # NaN counts as best: it stays visible
        self.value = np.where(better, value, self.value)
        self.kept = np.where(better[..., None], kept, self.kept)

    def of_all(self, removal: Removal, edges: Edges) -> Bools:
        """(S, N, N): the best mask of any budget, including the one that keeps everything."""
        everything = edges.senders[None]
        value = np.concatenate([self.value, self.per_unit(edges.fid_delta(removal, everything))])
        kept = np.concatenate([self.kept, everything])
        best = value.argmax(axis=0)  # (S, U)
        return np.asarray(np.take_along_axis(kept, best[None, ..., None], axis=0)[0])


def greedy(removal: Removal, edges: Edges, best: Best, *, rising: bool) -> None:
    """Add the masks of a greedy chain to `best`, see above. rising: begin with no edge, else with all."""
    senders = edges.senders
    n_steps, n_agents, _ = senders.shape
    degree = senders.sum(axis=-1)
    kept = np.zeros_like(senders) if rising else senders.copy()
    found = np.empty((edges.n_budgets, *kept.shape), dtype=bool)
    step = np.arange(n_steps)[:, None]
    groups = [np.arange(n_agents)] if best.row_wise else list(np.arange(n_agents)[:, None])
    for k in range(1, edges.n_budgets + 1) if rising else range(edges.n_budgets, 0, -1):
        for rows in groups:
            free = senders & ~kept if rising else kept
            moving = (kept.sum(axis=-1) != np.minimum(k, degree))[:, rows]  # (S, rows)
            free = free[:, rows] & moving[..., None]
            count = int(free.sum(axis=-1).max())
            if count == 0:
                continue
            choice = np.argsort(~free, axis=-1, kind="stable")[..., :count]  # (S, rows, C) senders
            tried = np.repeat(kept[None], count, axis=0)
            for c in range(count):
                valid = np.take_along_axis(free, choice[..., c, None], axis=-1)[..., 0]
                tried[c, step, rows, choice[..., c]] ^= valid
            value = best.per_unit(edges.fid_delta(removal, tried))  # (C, S, U)
            if best.row_wise:
                value = value[..., rows]
            there = np.moveaxis(np.take_along_axis(free, choice, axis=-1), -1, 0)  # (C, S, rows)
            chosen = np.where(there, value, -np.inf).argmax(axis=0)  # (S, rows)
            moved = np.take_along_axis(choice, chosen[..., None], axis=-1)[..., 0]
            kept[step, rows, moved] ^= moving
        found[k - 1] = kept
    best.take(found, edges.fid_delta(removal, found))


def ascend(removal: Removal, edges: Edges, best: Best) -> None:
    """Coordinate ascent over the rows of the best masks, if the best is taken over whole masks.

    Each row in turn swaps the kept and the dropped edge that raise FidDelta most, in SWEEPS sweeps.
    """
    n_steps, n_agents, _ = edges.senders.shape
    step = np.arange(n_steps)
    for k, kept in enumerate(best.kept):
        kept, value = kept.copy(), best.value[k, :, 0]
        for i in np.tile(np.arange(n_agents), SWEEPS):
            inside, outside = kept[:, i], (edges.senders & ~kept)[:, i]  # (S, N)
            swaps = inside[:, :, None] & outside[:, None, :]
            pairs = np.argwhere(swaps.any(axis=0))  # (C, 2): of any timestep
            if not len(pairs):
                continue
            tried = np.repeat(kept[None], len(pairs), axis=0)
            for c, pair in enumerate(pairs):
                there = swaps[:, pair[0], pair[1]]
                tried[c, :, i, pair] ^= there
            found = best.per_unit(edges.fid_delta(removal, tried))[..., 0]  # (C, S)
            chosen = found.argmax(axis=0)
            better = ~(found[chosen, step] <= value) & ~np.isnan(value)
            value = np.where(better, found[chosen, step], value)
            kept = np.where(better[:, None, None], tried[chosen, step], kept)
        best.kept[k], best.value[k, :, 0] = kept, value
