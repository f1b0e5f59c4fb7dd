"""Small policies with random weights, for tests without trained checkpoints."""

from __future__ import annotations

import torch

from xmarl_bench.policy import Architecture, GraphPolicy

# float32 rounds differently on every processor: 32 units in the last place of 1.
ROUNDING = 2**-18


def small_policy(
    obs_dim: int,
    seed: int = 0,
    encoder: tuple[int, ...] = (7,),
    *,
    residual: bool = False,
    categorical: bool = False,
) -> GraphPolicy:
    """A policy of few weights, large enough that messages matter. categorical: over the five actions."""
    architecture = Architecture(
        obs_dim=obs_dim,
        action_dim=5 if categorical else 2,
        encoder=encoder,
        encoder_activation="relu",
        gat_width=8,
        gat_activation="tanh",
        residual=residual,
        decoder=(9,),
        decoder_activation="tanh",
        distribution="categorical" if categorical else "tanh_normal",
    )
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        policy = GraphPolicy(architecture).eval()
        with torch.no_grad():
            for parameter in policy.parameters():
                parameter.copy_(torch.randn(parameter.shape) * 0.6)
    return policy


def random_observations(n_steps: int, n_agents: int, obs_dim: int, seed: int = 0) -> torch.Tensor:
    """(S, N, D)"""
    return torch.randn(n_steps, n_agents, obs_dim, generator=torch.Generator().manual_seed(seed))


def random_masks(n_steps: int, n_agents: int, seed: int = 0) -> torch.Tensor:
    """(S, N, N) in [0, 1)"""
    return torch.rand(n_steps, n_agents, n_agents, generator=torch.Generator().manual_seed(seed))
