"""GraphMask: PyG's bugs reproduced to the bit of a mask, and what the corrected one is instead."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict

import pytest
import torch
from torch import Tensor
from torch_geometric.explain import GraphMaskExplainer
from xmarl_baselines.batching import timestep_seeds
from xmarl_baselines.explainers.graphmask_pyg import (
    GraphMaskPygSettings,
    batched,
    graphmask_pyg,
    pyg_algorithm,
)

from tests.baselines.reference import TRAINED, by_pyg, trained
from tests.policies import random_observations, small_policy
from xmarl_bench.explainer import run_explainer
from xmarl_bench.policy import GraphPolicy

DEFAULTS = GraphMaskPygSettings()
# With the defaults nearly every mask is empty; with these training matters and masks differ.
TELLING = GraphMaskPygSettings(epochs=10, penalty_scaling=1, allowance=0.0)


@contextmanager
def double_precision() -> Iterator[None]:
    """PyG makes its gates in the default type."""
    torch.set_default_dtype(torch.float64)
    try:
        yield
    finally:
        torch.set_default_dtype(torch.float32)


def assert_masks_are_pygs(
    policy: GraphPolicy, observations: Tensor, settings: GraphMaskPygSettings
) -> Tensor:
    with double_precision():
        policy, observations = policy.double(), observations.double()
        ours = batched(policy, observations, torch.Generator().manual_seed(4), settings)
        seeds = timestep_seeds(len(observations), torch.Generator().manual_seed(4))
        for mask, x, seed in zip(ours, observations, seeds, strict=True):
            assert torch.equal(mask, by_pyg(policy, pyg_algorithm(1, settings), x, seed).round())
    return ours


@pytest.mark.parametrize("name", TRAINED)
def test_masks_equal_pygs_in_double_precision_on_trained_policies(name: str) -> None:
    policy, observations = trained(name, 5)
    assert_masks_are_pygs(policy, observations[:2], DEFAULTS)
    masks = assert_masks_are_pygs(policy, observations, TELLING)
    assert 0 < float(masks.mean()) < 1


@pytest.mark.parametrize("encoder", [(), (8,)], ids=["6 -> 8, untrained", "8 -> 8, trained"])
def test_masks_of_larger_teams_equal_pygs_in_double_precision(encoder: tuple[int, ...]) -> None:
    policy, observations = small_policy(6, 4, encoder), random_observations(5, 5, 6) * 2
    assert_masks_are_pygs(policy, observations[:2], DEFAULTS)
    masks = assert_masks_are_pygs(policy, observations, TELLING)
    assert 0 < float(masks.mean()) < 1


def test_the_defaults_are_pygs() -> None:
    algorithm = GraphMaskExplainer(num_layers=1)
    for name, value in asdict(DEFAULTS).items():
        assert getattr(algorithm, name) == value


@pytest.mark.parametrize("encoder", [(), (8,)], ids=["6 -> 8", "8 -> 8"])
def test_graphmask_pyg_gives_binary_masks(encoder: tuple[int, ...]) -> None:
    mask = run_explainer(graphmask_pyg, small_policy(6, 4, encoder), random_observations(5, 3, 6), 0)
    assert set(mask.unique().tolist()) <= {0.0, 1.0}
