"""Small policies with random weights: nothing here needs a trained checkpoint."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from xmarl_envs import TASKS

from xmarl_bench.policy import Architecture, GraphPolicy, save_policy

MakeBundle = Callable[..., Path]


def small_policy(obs_dim: int, seed: int = 0, encoder: tuple[int, ...] = (7,)) -> GraphPolicy:
    """A policy of few weights, large enough that messages matter."""
    architecture = Architecture(
        obs_dim=obs_dim,
        encoder=encoder,
        encoder_activation="relu",
        gat_width=8,
        gat_activation="tanh",
        decoder=(9,),
        decoder_activation="tanh",
    )
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        policy = GraphPolicy(architecture).eval()
        with torch.no_grad():
            for parameter in policy.parameters():
                parameter.copy_(torch.randn(parameter.shape) * 0.6)
    return policy


@pytest.fixture
def make_bundle(tmp_path: Path) -> MakeBundle:
    """make_bundle(task=..., n_agents=..., name=..., seed=...) -> the folder of a saved random policy."""

    def make(
        task: str = "blind_navigation_v0", n_agents: int = 3, name: str = "small", seed: int = 0
    ) -> Path:
        folder = tmp_path / "policies" / name
        policy = small_policy(len(TASKS[task].observation_names), seed)
        save_policy(
            folder, policy, name=name, task=task, n_agents=n_agents, attention_entropy=0.0, training_seed=seed
        )
        return folder

    return make
