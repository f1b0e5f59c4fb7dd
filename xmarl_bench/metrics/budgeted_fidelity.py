"""Budgeted fidelity: does a mask rank the edges well, whatever values it gives them?

FidDelta@k is FidDelta of the binary mask that keeps the k highest edges of each row (averaged over the
choices among equal ones). It is scaled so that 0 is a random ranking and 1 the best one, and averaged over
k = 1 .. M - 1 for M senders:

    mean over k of (FidDelta@k - random@k) / (oracle@k - random@k)

random@k is the exact mean over all k-subsets, oracle@k the maximum over them, for each receiver separately.
All three are averaged over agents and timesteps before dividing (a ratio of means). A k whose denominator is
below 1e-3 action units has nothing to rank and is skipped; if all are skipped, the metric is NaN.

FidDelta of a row follows from a table of changes (R, S, N), R = 2^M: entry [r, s, i] is how much agent i's
action at timestep s changes when the senders in the bits of r are kept and no others (explain/oracle.py).

If the policy's graph lacks edges (`edges`, (S, N, M), False), absent senders are never among the k: a
receiver with P < k senders keeps all P, and subsets are those of its own senders.

Communication-only: subgraph and complement both keep the agent's own edge, so the senders are the M = N - 1
others, and k = 1 .. N - 2. It is the same computation on `others_table` and `other_senders`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Edges = NDArray[np.bool_]  # (S, N, M); None: the complete graph
Item = TypeVar("Item", bound=np.generic)
OracleKind = Literal["enumerated", "sampled"]  # how oracle@k and random@k were found
SMALLEST = 1e-3  # action units; a smaller denominator is noise


def fid_delta_table(change: Floats) -> Floats:
    """(R, ...) changes d(r) -> (R, ...) FidDelta of each row: d(complement of r) - d(r)."""
    return np.asarray(change[::-1] - change)


def choices(mask: NDArray[np.floating], edges: Edges | None = None) -> Floats:
    """(S, N, M) -> (R, S, N): the share of each row among the rows of k senders that the mask can keep.

    1 for the row of the k highest senders, 0 for other rows of k senders. If senders are equal, each way to
    choose among them has the same share. Rows with absent senders have share 0.
    """
    value = mask.astype(np.float64)
    allowed = _least_kept(value) >= _most_dropped(value if edges is None else np.where(edges, value, -np.inf))
    if edges is not None:
        allowed &= rows_within(len(allowed), edges)
    share = np.zeros(allowed.shape)
    for subsets in _subsets(len(allowed)):
        ways = allowed[subsets]
        share[subsets] = ways / np.maximum(ways.sum(axis=0), 1)
    return share


def fid_delta_at_k(delta: Floats, share: Floats, edges: Edges | None = None) -> Floats:
    """(R, S, N) FidDelta of all rows, their `choices` -> (M - 1,): mean over timesteps and agents."""
    chosen = delta * share
    if edges is None:
        return np.array([chosen[subsets].sum(axis=0).mean() for subsets in _subsets(len(delta))])
    return np.array([chosen.sum(axis=0, where=subsets).mean() for subsets in _own_subsets(len(delta), edges)])


def random_at_k(delta: Floats, edges: Edges | None = None) -> Floats:
    """(R, S, N) -> (M - 1,): the mean over all k-subsets, the expectation for a random ranking.

    A mask whose edges are all equal gets the same value, bit for bit.
    """
    n_senders = len(delta).bit_length() - 1
    return fid_delta_at_k(delta, choices(np.zeros((*delta.shape[1:], n_senders)), edges), edges)


def oracle_at_k(delta: Floats, edges: Edges | None = None) -> Floats:
    """(R, S, N) -> (M - 1,): the best k-subset of every receiver at every timestep."""
    if edges is None:
        return np.array([delta[subsets].max(axis=0).mean() for subsets in _subsets(len(delta))])
    return np.array(
        [
            delta.max(axis=0, where=subsets, initial=-np.inf).mean()
            for subsets in _own_subsets(len(delta), edges)
        ]
    )


def budgeted_fidelity(explained: Floats, random: Floats, oracle: Floats) -> float:
    """Three arrays (K,) -> one number: 0 for a random ranking, 1 for the best; NaN if every k is skipped."""
    room = oracle - random
    if np.isnan(explained).any() or np.isnan(room).any() or not (room >= SMALLEST).any():
        return float("nan")
    counted = room >= SMALLEST
    return float(((explained - random)[counted] / room[counted]).mean())


def over_absences(values: Sequence[float | None]) -> tuple[float, float]:
    """Budgeted fidelity under each absence model -> (mean, smallest) of those that are numbers, or NaN."""
    measured = [value for value in values if value is not None and not math.isnan(value)]
    return (float(np.mean(measured)), min(measured)) if measured else (math.nan, math.nan)


def others_table(change: Floats) -> Floats:
    """(2^N, S, N) -> (2^(N-1), S, N): rows over the other senders, the own edge kept; ascending order."""
    n_rows, _, n_agents = change.shape
    reduced = np.empty((n_rows // 2, *change.shape[1:]))
    r = np.arange(n_rows // 2)
    for i in range(n_agents):
        low, high = r & ((1 << i) - 1), r >> i
        reduced[:, :, i] = change[high << (i + 1) | 1 << i | low, :, i]
    return reduced


def other_senders(mask: NDArray[Item]) -> NDArray[Item]:
    """(S, N, N) -> (S, N, N - 1): the mask without its diagonal, in ascending order of senders."""
    n_agents = mask.shape[-1]
    off_diagonal = ~np.eye(n_agents, dtype=bool)
    return mask[:, off_diagonal].reshape(len(mask), n_agents, n_agents - 1)


def rows_within(n_rows: int, edges: Edges) -> NDArray[np.bool_]:
    """(S, N, M) -> (R, S, N): whether a row keeps existing senders only."""
    return np.asarray((np.arange(n_rows)[:, None, None] & ~_bits(edges)) == 0)


def _own_subsets(n_rows: int, edges: Edges) -> Iterator[NDArray[np.bool_]]:
    """For k = 1 .. M - 1, (R, S, N): whether a row keeps min(k, P) of a receiver's P senders."""
    within, size = rows_within(n_rows, edges), np.bitwise_count(np.arange(n_rows))[:, None, None]
    for k in range(1, edges.shape[-1]):
        yield within & (size == np.minimum(k, edges.sum(axis=-1)))


def _least_kept(value: Floats) -> Floats:
    """(S, N, M) -> (R, S, N): the smallest value that a row keeps; infinite if it keeps none."""
    least = np.full((1, *value.shape[:-1]), np.inf)
    for each in np.moveaxis(value, -1, 0):
        least = np.concatenate([least, np.minimum(least, each)])
    return least


def _most_dropped(value: Floats) -> Floats:
    """(S, N, M) -> (R, S, N): the largest value that a row drops; -infinite if it drops none."""
    most = np.full((1, *value.shape[:-1]), -np.inf)
    for each in np.moveaxis(value, -1, 0):
        most = np.concatenate([np.maximum(most, each), most])
    return most


def _bits(edges: Edges) -> NDArray[np.int64]:
    """(S, N, M) -> (S, N): the row of all existing senders."""
    return np.asarray((edges.astype(np.int64) << np.arange(edges.shape[-1])).sum(axis=-1))


def _subsets(n_rows: int) -> list[NDArray[np.bool_]]:
    """Which of the rows keep k senders, for k = 1 .. M - 1."""
    size = np.bitwise_count(np.arange(n_rows))
    return [size == k for k in range(1, int(n_rows).bit_length() - 1)]
