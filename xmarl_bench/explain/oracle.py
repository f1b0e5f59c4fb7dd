"""The oracle: with one attention layer, F_i depends on row i of the mask only, so all rows can be tried.

A binary row is a number r in [0, 2^N): bit j tells whether the message j -> i is kept. Row 0 keeps nothing,
row 2^N - 1 everything, and the complement of r is 2^N - 1 - r. Axis 0 of every table is r.

No binary mask has a larger FidDelta than `oracle_mask`. Soft masks can: those of `soft_oracle_mask` are
better by 0.2 to 2.9 % on the shipped policies. The table also gives exact Shapley values and FidDelta@k.

S is the number of timesteps, N agents, A action entries, R = 2^N rows.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from xmarl_bench.errors import InputError
from xmarl_bench.explain.effect import action_change
from xmarl_bench.metrics import prediction_change, rows_within
from xmarl_bench.metrics.budgeted_fidelity import OracleKind
from xmarl_bench.policy import ActionDistribution, Policy, existing_edges

MAX_AGENTS: Final = 10
# Larger teams take minutes for a timestep: docs/scaling.md has the figures.
MAX_SAMPLED: Final = 32
MAX_SAMPLED_TOGETHER: Final = 16  # if rows do not act alone
# Network rows decoded at once: the fastest of 250 to 64000 on one core, because larger batches do not fit the
# processor's cache. A chunk has at least one timestep: 10240 rows at N = 10.
DECODED_AT_ONCE = 8192
SOFT_STEPS = 6  # 30 steps gain a tenth more
SOFT_STEP, SOFT_DECAY = 0.4, 0.65  # length of the first step in mask units, and factor from step to step


def oracle_kind(policy: Policy, n_agents: int) -> OracleKind | None:
    """How the oracle of this policy and team size is found; None if they have none."""
    if why_not_enumerated(policy, n_agents) is None:
        return "enumerated"
    return "sampled" if why_no_oracle(policy, n_agents) is None else None


def why_no_oracle(policy: Policy, n_agents: int) -> str | None:
    """Why this policy and team size have no oracle, not even a sampled one; None if they have one."""
    most = MAX_SAMPLED if policy.row_wise else MAX_SAMPLED_TOGETHER
    if n_agents <= most:
        return None
    layers = "one layer" if policy.row_wise else "several layers"
    return f"an oracle is sampled for at most {most} agents with {layers}, got {n_agents}"


def why_not_enumerated(policy: Policy, n_agents: int) -> str | None:
    """Why the oracle cannot try all rows; None if it can."""
    if not policy.row_wise:
        return (
            "an oracle needs a single layer that passes messages, so that an action depends on its own row "
            "of the mask alone, and this policy has several"
        )
    if n_agents > MAX_AGENTS:
        return f"an oracle tries all 2^N rows of a mask, for at most {MAX_AGENTS} agents, got {n_agents}"
    return None


def check_oracle(policy: Policy, n_agents: int) -> None:
    """Raise InputError if the oracle cannot try all rows for this policy and team size."""
    reason = why_not_enumerated(policy, n_agents)
    if reason is not None:
        raise InputError(f"{reason}: leave the oracle out, or choose another policy or team.")


def binary_rows(n_agents: int) -> Tensor:
    """(R, N) float32: row r keeps sender j if bit j of r is set."""
    return ((torch.arange(2**n_agents)[:, None] >> torch.arange(n_agents)) & 1).float()


def chunks(n_steps: int, n_agents: int, rows_per_agent: int) -> Iterator[slice]:
    """Chunks of timesteps of about DECODED_AT_ONCE network rows, at least one timestep each.

    Chunks, and so the rounding of matrix products, depend on the shapes only.
    """
    width = max(1, DECODED_AT_ONCE // (n_agents * rows_per_agent))
    for first in range(0, n_steps, width):
        yield slice(first, min(first + width, n_steps))


def action_tables(policy: Policy, observations: Tensor) -> Iterator[tuple[slice, ActionDistribution]]:
    """(S, N, D) -> (timesteps, (R, s, N, A) of every binary row), one chunk at a time.

    Entry [r, s, i] is F_i at timestep s with row i of the mask set to r, for any other rows.

    Raises InputError as `check_oracle` does.
    """
    n_steps, n_agents, _ = observations.shape
    check_oracle(policy, n_agents)
    rows = binary_rows(n_agents)[:, None, None, :]
    for steps in chunks(n_steps, n_agents, len(rows)):
        prepared = policy.prepare(observations[steps])
        mask = rows.expand(-1, steps.stop - steps.start, n_agents, -1)
        yield steps, policy.decode(prepared, mask)


def change_table(policy: Policy, observations: Tensor) -> NDArray[np.float64]:
    """(S, N, D) -> (R, S, N): d_i of every binary row, see xmarl_bench.metrics.fidelity.

    Holds 8 R S N bytes: 0.5 MB for 400 timesteps at N = 5, 6.6 MB at N = 8, 33 MB at N = 10. Arguments and
    errors are those of `action_tables`.
    """
    n_steps, n_agents, _ = observations.shape
    change = np.empty((2**n_agents, n_steps, n_agents))
    with torch.no_grad():
        for steps, table in action_tables(policy, observations):
            change[:, steps] = change_from_last(table)
    return change


def change_from_last(table: ActionDistribution) -> NDArray[np.float64]:
    """(R, s, N, A), whose last row keeps everything -> (R, s, N): d_i of every row."""
    actions = table.action.numpy()
    return prediction_change(actions[-1:], actions, table.divisor)


def best_rows(change: NDArray[np.float64], edges: NDArray[np.bool_] | None = None) -> NDArray[np.int64]:
    """(R, S, N) changes -> (S, N): the row of largest FidDelta of each receiver, the first among equals.

    edges: (S, N, N), the edges of the graph, to exclude rows with absent senders; None: the complete graph.
    """
    delta = change[::-1] - change
    if edges is not None:
        delta = np.where(rows_within(len(delta), edges), delta, -np.inf)
    return np.asarray(delta.argmax(axis=0))


def oracle_mask(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    """(S, N, D) -> (S, N, N) of zeros and ones: the best binary mask for FidDelta."""
    best = best_rows(change_table(policy, observations), existing_edges(policy, observations))
    return mask_of(best, observations.shape[1])


def mask_of(rows: NDArray[np.int64], n_agents: int) -> Tensor:
    """(S, N) numbers of rows -> (S, N, N) mask of zeros and ones."""
    return binary_rows(n_agents)[torch.from_numpy(rows)]


def soft_oracle_mask(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    """(S, N, D) -> (S, N, N) in [0, 1]: the best mask that projected ascent finds from the oracle's.

    Maximises each receiver's FidDelta separately, and changes a row only if that improves it.
    """
    return ascend(policy, observations, oracle_mask(policy, observations, generator))


def ascend(policy: Policy, observations: Tensor, start: Tensor) -> Tensor:
    """(S, N, D), (S, N, N) oracle's mask -> (S, N, N), see `soft_oracle_mask`."""
    stretches = chunks(len(observations), observations.shape[1], 2)
    return torch.cat([_ascend(policy, observations[steps], start[steps]) for steps in stretches])


def _ascend(policy: Policy, observations: Tensor, start: Tensor) -> Tensor:
    with torch.no_grad():
        prepared = policy.prepare(observations)
        full = policy.decode(prepared)
    best, highest = start, torch.full(start.shape[:-1], -torch.inf)
    mask, step = start, SOFT_STEP
    for _ in range(SOFT_STEPS + 1):
        with torch.enable_grad():
            mask = mask.detach().requires_grad_()
            kept, dropped = (
                action_change(full, policy.decode(prepared, each)) for each in (mask, 1.0 - mask)
            )
            value = dropped - kept  # (S, N)
            if not policy.row_wise:  # a row changes what others get: masks are better or worse as a whole
                value = value.mean(dim=-1, keepdim=True).expand_as(value)
            (gradient,) = torch.autograd.grad(value.sum(), mask)
        better = value > highest
        best = torch.where(better[..., None], mask, best)
        highest = torch.where(better, value, highest)
        largest = gradient.abs().amax(dim=-1, keepdim=True).clamp_min(1e-12)
        mask = (mask + step * gradient / largest).clamp(0.0, 1.0)
        step *= SOFT_DECAY
    return best.detach()
