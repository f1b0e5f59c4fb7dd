"""Explains an episode in chunks of timesteps, with a random stream for each timestep.

The chunk bounds the memory. Chunks depend only on the episode's length and the team size, because the
rounding of matrix products depends on the batch size. Draws for a timestep do not depend on other timesteps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import torch
from torch import Tensor

AGENTS_AT_ONCE = 2048  # rows of the decoder: activations fit the processor's cache; 682 timesteps at N = 3
EDGES_AT_ONCE = 2**16  # entries of the mask, the limit of large teams: 16 timesteps at N = 64


def chunks(n_steps: int, n_agents: int, *, steps_at_once: int | None = None) -> Iterator[slice]:
    """Consecutive slices of timesteps, at most `steps_at_once` long if given."""
    width = min(AGENTS_AT_ONCE // n_agents, EDGES_AT_ONCE // n_agents**2, steps_at_once or n_steps)
    width = max(1, width)
    for first in range(0, n_steps, width):
        yield slice(first, min(first + width, n_steps))


def by_chunks(
    observations: Tensor, explain: Callable[[slice], Tensor], *, steps_at_once: int | None = None
) -> Tensor:
    """(S, N, D) -> (S, N, N): calls `explain` for the masks of one slice of timesteps after another."""
    n_steps, n_agents, _ = observations.shape
    return torch.cat([explain(steps) for steps in chunks(n_steps, n_agents, steps_at_once=steps_at_once)])
