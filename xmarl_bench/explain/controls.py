"""Controls: masks to compare every explainer with, scored on the same policy and states. Always available.

Lower controls explain nothing or ignore the policy; the oracle is the best binary mask. The mask of ones
keeps everything, so Fid- and GEF are 0, and FidDelta is the effect of removing all messages: an explainer
that only keeps more is not better. The inverse of the explainer's own mask is a control too; it depends on
the explainer, so xmarl_bench.scoring.measure makes it.

S is the number of timesteps, N agents, D observation entries.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import torch
from torch import Tensor

from xmarl_bench.explain.control_names import (
    BY_ZERO,
    INITIAL_ATTENTION,
    NEAREST,
    ORACLE,
    RANDOM,
    SOFT_ORACLE,
    STOCHASTIC,
    SUMMARIES,
)
from xmarl_bench.explain.explainer import Explain, Explainer
from xmarl_bench.explain.oracle import oracle_mask, soft_oracle_mask
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.policy import Policy, PolicyCard
from xmarl_bench.policy.build import initial_policy
from xmarl_bench.tasks.sources import known_task


def ones_mask(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    """(S, N, D) -> (S, N, N): every edge kept."""
    return torch.ones(_shape(observations))


def zeros_mask(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    """(S, N, D) -> (S, N, N): no edge kept."""
    return torch.zeros(_shape(observations))


def random_mask(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    """(S, N, D) -> (S, N, N): every entry uniform in [0, 1), independent."""
    return torch.rand(_shape(observations), generator=generator)


def bernoulli_mask(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    """(S, N, D) -> (S, N, N): every edge kept with probability 1/2, independent."""
    return (torch.rand(_shape(observations), generator=generator) < 0.5).float()


def self_mask(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    """(S, N, D) -> (S, N, N): every agent's own edge, and no message between agents."""
    n_steps, n_agents, _ = observations.shape
    return torch.eye(n_agents).repeat(n_steps, 1, 1)


def nearest_mask(
    policy: Policy, observations: Tensor, generator: torch.Generator, *, position: Sequence[int]
) -> Tensor:
    """(S, N, D) -> (S, N, N): exp(-distance in m), independent of the policy.

    position: the two entries of an observation that hold the agent's position.
    """
    place = observations[..., list(position)]
    return torch.exp(-torch.linalg.vector_norm(place[:, :, None] - place[:, None, :], dim=-1))


def initial_attention_mask(
    policy: Policy, observations: Tensor, generator: torch.Generator, *, initial: Policy
) -> Tensor:
    """(S, N, D) -> (S, N, N): the attention of the network as it was before training."""
    with torch.no_grad():
        return initial.attention(observations).clone()


def _shape(observations: Tensor) -> tuple[int, int, int]:
    n_steps, n_agents, _ = observations.shape
    return n_steps, n_agents, n_agents


_MASKS: dict[str, Explain] = {
    "all-ones": ones_mask,
    "zeros": zeros_mask,
    RANDOM: random_mask,
    "bernoulli": bernoulli_mask,
    "self": self_mask,
    ORACLE: oracle_mask,
    SOFT_ORACLE: soft_oracle_mask,
}
CONTROLS: dict[str, Explainer] = {
    name: Explainer(
        name,
        _MASKS[name],
        summary,
        stochastic=name in STOCHASTIC,
        control=True,
        absence=Absence.ZERO if name in BY_ZERO else None,
    )
    for name, summary in SUMMARIES.items()
}


def controls_of(task: str, card: PolicyCard) -> tuple[Explainer, ...]:
    """CONTROLS, and the controls by distance and by attention before training.

    Distance needs observations that hold a position, attention a card with the seed of the initial weights.
    """
    made = list(CONTROLS.values())
    names = known_task(task).observation_names
    if {"position_x", "position_y"} <= set(names):
        position = names.index("position_x"), names.index("position_y")
        made.append(
            Explainer(
                NEAREST,
                partial(nearest_mask, position=position),
                "the nearer the sender, the higher; ignores the policy",
                control=True,
            )
        )
    if card.initial_seed is not None:
        made.append(
            Explainer(
                INITIAL_ATTENTION,
                partial(initial_attention_mask, initial=initial_policy(card)),
                "attention of the network before training: not learned",
                control=True,
            )
        )
    return tuple(made)
