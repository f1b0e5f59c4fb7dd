"""GraphMask: PyG's masks are reproduced exactly, bugs included; the corrected one follows its formula."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch_geometric.explain import GraphMaskExplainer
from xmarl_baselines.explainers.frozen_policy import frozen
from xmarl_baselines.explainers.graphmask import (
    BETA,
    GAMMA,
    ZETA,
    GraphMaskSettings,
    graphmask,
    optimise_gates,
    uniform_noise,
)
from xmarl_baselines.explainers.graphmask_pyg import (
    GraphMaskPygSettings,
    batched,
    graphmask_pyg,
    pyg_algorithm,
)

from tests.baselines.reference import TRAINED, by_pyg, trained
from tests.helpers.policies import random_observations, small_policy
from xmarl_bench.explain.explainer import run_explainer
from xmarl_bench.policy import GraphPolicy
from xmarl_bench.reproducible import timestep_seeds

DEFAULTS = GraphMaskPygSettings()
# With the defaults nearly every mask is empty; with these settings training matters and masks differ.
TELLING = GraphMaskPygSettings(epochs=10, penalty_scaling=1, allowance=0.0)


@contextmanager
def double_precision() -> Iterator[None]:
    """PyG creates its gates in the default dtype."""
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


@pytest.mark.slow
@pytest.mark.parametrize("name", TRAINED)
def test_masks_equal_pygs_in_double_precision_on_trained_policies(name: str) -> None:
    policy, observations = trained(name, 5)
    assert_masks_are_pygs(policy, observations[:2], DEFAULTS)
    masks = assert_masks_are_pygs(policy, observations, TELLING)
    assert 0 < float(masks.mean()) < 1


@pytest.mark.slow
@pytest.mark.parametrize("residual", [False, True])
@pytest.mark.parametrize("encoder", [(), (8,)], ids=["6 -> 8, untrained", "8 -> 8, trained"])
def test_masks_of_larger_teams_equal_pygs_in_double_precision(
    encoder: tuple[int, ...], residual: bool
) -> None:
    policy = small_policy(6, 4, encoder, residual=residual)
    observations = random_observations(5, 5, 6) * 2
    assert_masks_are_pygs(policy, observations[:2], DEFAULTS)
    masks = assert_masks_are_pygs(policy, observations, TELLING)
    assert 0 < float(masks.mean()) < 1


def test_the_defaults_are_pygs() -> None:
    algorithm = GraphMaskExplainer(num_layers=1)
    for name, value in asdict(DEFAULTS).items():
        assert getattr(algorithm, name) == value


@pytest.mark.slow
@pytest.mark.parametrize("encoder", [(), (8,)], ids=["6 -> 8", "8 -> 8"])
def test_graphmask_pyg_gives_binary_masks(encoder: tuple[int, ...]) -> None:
    mask = run_explainer(graphmask_pyg, small_policy(6, 4, encoder), random_observations(5, 3, 6), 0)
    assert set(mask.unique().tolist()) <= {0.0, 1.0}


def gated(policy: GraphPolicy, observations: Tensor, settings: GraphMaskSettings, seed: int = 0) -> Tensor:
    seeds = timestep_seeds(len(observations), torch.Generator().manual_seed(seed))
    noise = uniform_noise(settings.epochs, observations.shape[1], seeds)
    return optimise_gates(frozen(policy), observations, noise, settings)


def relative_error(policy: GraphPolicy, observations: Tensor, mask: Tensor) -> Tensor:
    """(S,): D(z), the constrained change."""
    with torch.no_grad():
        full, masked, silent = (
            policy.distribution(observations, each).action for each in (None, mask, torch.zeros_like(mask))
        )
    distance = [(full - other).square().sum(dim=(-2, -1)) for other in (masked, silent)]
    return distance[0] / distance[1]


@pytest.mark.slow
@pytest.mark.parametrize("name", TRAINED)
def test_graphmask_drops_messages_and_keeps_the_action_within_the_allowance(name: str) -> None:
    policy, observations = trained(name, 30)
    mask = run_explainer(graphmask, policy, observations, 0)
    assert set(mask.unique().tolist()) == {0.0, 1.0}
    assert float(mask.mean()) < 0.99
    error = relative_error(policy, observations, mask)
    assert error.max() <= 0.0101  # 0.01 and rounding
    shuffled = mask.flatten(1)[:, torch.randperm(9, generator=torch.Generator().manual_seed(0))].view_as(mask)
    assert relative_error(policy, observations, shuffled).mean() > 10 * error.mean()


def by_autograd(
    policy: GraphPolicy, observations: Tensor, noise: Tensor, settings: GraphMaskSettings
) -> Tensor:
    """The formula in graphmask's docstring, differentiated by torch."""
    with torch.no_grad():
        full, silent = (
            policy.distribution(observations, mask).action for mask in (None, torch.zeros_like(noise[0]))
        )
    largest = (full - silent).square().sum(dim=(1, 2))
    w = torch.zeros_like(noise[0], requires_grad=True)
    multiplier = torch.full_like(largest, settings.init_lambda, requires_grad=True)
    down = torch.optim.Adam([w], lr=settings.lr)
    up = torch.optim.RMSprop([multiplier], lr=settings.lambda_lr, centered=True, maximize=True)
    kept = torch.ones_like(noise[0])
    for step, u in enumerate(noise, start=1):
        a = w + settings.location
        soft = (torch.sigmoid((torch.logit(u) + a) / BETA) * (ZETA - GAMMA) + GAMMA).clamp(0, 1)
        z = soft + ((soft > 0.5).to(soft.dtype) - soft).detach()
        moved = (policy.distribution(observations, z).action - full).square().sum(dim=(1, 2)) / largest
        share = torch.sigmoid(a - BETA * math.log(-GAMMA / ZETA)).mean(dim=(1, 2))
        price = torch.nn.functional.softplus(multiplier)
        loss = settings.scaling * share + price * torch.relu(moved - settings.allowance)
        w.grad, multiplier.grad = torch.autograd.grad(loss.sum(), [w, multiplier])
        down.step()
        up.step()
        multiplier.data.clamp_(-2, 30)
        if step % settings.read_every == 0:
            quiet = torch.sigmoid(w + settings.location).detach() * (ZETA - GAMMA) + GAMMA
            mask = (quiet > 0.5).to(quiet.dtype)
            fits = relative_error(policy, observations, mask) <= settings.allowance
            better = fits & (mask.sum(dim=(1, 2)) < kept.sum(dim=(1, 2)))
            kept[better] = mask[better]
    return kept


def as_policy_and_states(name: str) -> tuple[GraphPolicy, Tensor]:
    if name == "residual":
        return small_policy(6, 5, residual=True), random_observations(30, 3, 6)
    return trained(name, 30)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*TRAINED, "residual"])
def test_graphmask_follows_the_gradient_of_its_formula(name: str) -> None:
    policy, observations = as_policy_and_states(name)
    settings = GraphMaskSettings()
    noise = uniform_noise(settings.epochs, 3, list(range(30)))
    fast = optimise_gates(frozen(policy), observations, noise, settings)
    exact = policy.double().requires_grad_(False), observations.double(), noise.double(), settings
    expected = by_autograd(*exact)
    assert torch.equal(optimise_gates(*exact), expected)
    # In float32 a gate near the threshold may fall to the other side.
    assert (fast == expected).flatten(1).all(dim=1).float().mean() >= 0.9


@pytest.mark.slow
@settings(max_examples=10)
@given(
    seed=st.integers(0, 1000),
    n_agents=st.integers(1, 5),
    allowance=st.sampled_from([0.0, 0.01, 0.3]),
    residual=st.booleans(),
)
def test_the_constraint_holds_at_every_timestep(
    seed: int, n_agents: int, allowance: float, residual: bool
) -> None:
    policy = small_policy(6, seed, residual=residual)
    observations = random_observations(4, n_agents, 6, seed)
    mask = gated(policy, observations, GraphMaskSettings(allowance=allowance, epochs=30))
    assert relative_error(policy, observations, mask).max() <= allowance + 1e-4


def test_without_a_constraint_every_gate_closes() -> None:
    policy, observations = small_policy(6, 3), random_observations(20, 4, 6)
    assert bool((gated(policy, observations, GraphMaskSettings(allowance=1e9)) == 0).all())


@pytest.mark.slow
def test_a_larger_allowance_keeps_fewer_messages() -> None:
    policy, observations = trained(TRAINED[0], 40)
    few, many = (gated(policy, observations, GraphMaskSettings(allowance=a)).mean() for a in (0.5, 0.01))
    assert few < many


def test_graphmask_keeps_the_senders_that_matter() -> None:
    """Agents 1 and 2 are silent everywhere: the senders that matter are 0 and 3."""
    policy, observations = small_policy(6, 1, encoder=()), random_observations(20, 4, 6)
    with torch.no_grad():
        policy.gat.lin_l.bias.zero_()
    observations[:, 1:3] = 0.0
    mask = run_explainer(graphmask, policy, observations, 0)
    assert mask[:, :, 1:3].mean() < 0.1
    assert mask[:, :, [0, 3]].mean() > 0.4


def test_a_timestep_s_mask_does_not_depend_on_other_timesteps() -> None:
    policy, observations = small_policy(6, 3), random_observations(6, 3, 6)
    together = run_explainer(graphmask, policy, observations, 1)
    changed = observations.clone()
    changed[0] += 1.0
    assert torch.equal(together[1:], run_explainer(graphmask, policy, changed, 1)[1:])


def test_a_policy_that_ignores_its_team_is_explained_by_nothing() -> None:
    policy = small_policy(6, 1)
    with torch.no_grad():
        next(policy.decoder.parameters()).zero_()
    mask = run_explainer(graphmask, policy, random_observations(4, 3, 6), 1)
    assert bool((mask == 0).all())
