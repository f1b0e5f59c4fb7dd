"""How explainers walk through an episode: timesteps in chunks, and a random stream for every timestep.

Memory is bounded by the chunk. Chunks are a function of the episode's length and team size alone, because
matrix products round by their batch size; what is drawn for a timestep depends on no other timestep.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import torch
from torch import Tensor

AGENTS_AT_ONCE = 2048  # rows of the decoder, whose activations stay in the cache: 682 timesteps at N = 3
EDGES_AT_ONCE = 2**16  # entries of the mask, what bounds large teams: 16 timesteps at N = 64


def chunks(n_steps: int, n_agents: int, *, steps_at_once: int | None = None) -> Iterator[slice]:
    """Stretches of timesteps, in order; at most `steps_at_once` long where that is given."""
    width = min(AGENTS_AT_ONCE // n_agents, EDGES_AT_ONCE // n_agents**2, steps_at_once or n_steps)
    width = max(1, width)
    for first in range(0, n_steps, width):
        yield slice(first, min(first + width, n_steps))


def by_chunks(
    observations: Tensor, explain: Callable[[slice], Tensor], *, steps_at_once: int | None = None
) -> Tensor:
    """(S, N, D) -> (S, N, N): `explain`, asked for the masks of one stretch of timesteps after another."""
    n_steps, n_agents, _ = observations.shape
    return torch.cat([explain(steps) for steps in chunks(n_steps, n_agents, steps_at_once=steps_at_once)])


def timestep_seeds(n_steps: int, generator: torch.Generator) -> list[int]:
    """One seed per timestep, those that `xmarl_bench.PygExplain` gives PyG from the same generator."""
    return [int(seed) for seed in torch.randint(2**62, (n_steps,), generator=generator)]
