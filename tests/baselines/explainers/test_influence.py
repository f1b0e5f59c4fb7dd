"""Influence, against a float64 computation state by state, integrals of the mixture, and known truth."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from torch import Tensor
from xmarl_baselines.explainers.influence import Influence, influence, influences, kl_to_mixture

from tests.helpers.deep_policies import one_layer, two_layers
from tests.helpers.dense_reference import reference_distribution
from tests.helpers.policies import random_observations, small_policy
from xmarl_bench.errors import InputError
from xmarl_bench.explain.explainer import fit_explainer, run_explainer
from xmarl_bench.planted.families import planted
from xmarl_bench.policy import ActionDistribution
from xmarl_bench.policy.network import Prepared

Floats = NDArray[np.float64]
ROUNDING = 1e-9  # nats, of distributions in float32
NUMBERS = st.floats(-2.0, 2.0)
SCALES = st.floats(0.3, 2.0)


def mixture(locs: list[float], scales: list[float]) -> ActionDistribution:
    """K components for one agent with one action entry."""
    return ActionDistribution(torch.tensor(locs)[:, None, None], torch.tensor(scales)[:, None, None])


def log_density(x: Floats, loc: float, scale: float) -> Floats:
    return np.asarray(-0.5 * ((x - loc) / scale) ** 2 - math.log(scale * math.sqrt(2 * math.pi)))


def kl(p: tuple[Floats, Floats], q: tuple[Floats, Floats]) -> float:
    """KL of diagonal Normals, written out."""
    total = 0.0
    for m, s, n, t in zip(*p, *q, strict=True):
        total += math.log(t / s) + (s**2 + (m - n) ** 2) / (2 * t**2) - 0.5
    return total


@given(NUMBERS, SCALES, st.lists(st.tuples(NUMBERS, SCALES), min_size=1, max_size=4))
def test_the_bound_lies_between_the_integral_and_the_mean(
    loc: float, scale: float, components: list[tuple[float, float]]
) -> None:
    others = mixture(*map(list, zip(*components, strict=True)))
    bound = float(kl_to_mixture(mixture([loc], [scale]), others))
    x = np.linspace(loc - 9 * scale, loc + 9 * scale, 20_001)
    log_p = log_density(x, loc, scale)
    log_q = np.logaddexp.reduce([log_density(x, *each) for each in components]) - math.log(len(components))
    integral = float((np.exp(log_p) * (log_p - log_q)).sum() * (x[1] - x[0]))
    each = [kl((np.array([loc]), np.array([scale])), (np.array([m]), np.array([s]))) for m, s in components]
    assert integral - 1e-5 <= bound <= float(np.mean(each)) + 1e-5
    if len(set(components)) == 1:
        assert bound == pytest.approx(integral, abs=1e-5)


def test_by_hand() -> None:
    one, far = mixture([0.0], [1.0]), 100.0
    assert float(kl_to_mixture(one, mixture([0.0, 0.0], [1.0, 1.0]))) == 0.0
    assert float(kl_to_mixture(one, mixture([2.0, 2.0], [1.0, 1.0]))) == pytest.approx(2.0)
    # Half of the counterfactuals agree: the mixture is half of the distribution.
    assert float(kl_to_mixture(one, mixture([0.0, far], [1.0, 1.0]))) == pytest.approx(math.log(2))
    # All far away, e^-5000 each, without under- or overflow.
    assert float(kl_to_mixture(one, mixture([far, far], [1.0, 1.0]))) == pytest.approx(5000.0)


@pytest.mark.parametrize("residual", [False, True])
def test_influence_equals_the_formula_message_by_message(residual: bool) -> None:
    policy, observations = small_policy(6, 1, residual=residual), random_observations(3, 4, 6)
    elsewhere = random_observations(15, 4, 6, 5)
    with torch.no_grad():
        said = policy.prepare(elsewhere).message.view(5, 3, 4, -1)
        ours = influences(policy, observations, said)
    everything, other = np.ones((4, 4)), elsewhere.view(5, 3, 4, 6).double().numpy()
    for s in range(3):
        x = observations[s].double().numpy()
        actual = reference_distribution(policy, x, everything)
        for j in range(4):
            likeness = np.zeros(4)
            for k in range(5):
                changed = x.copy()
                changed[j] = other[k, s, j]
                loc, scale = reference_distribution(policy, x, everything, changed)
                for i in range(4):
                    likeness[i] += math.exp(-kl((actual[0][i], actual[1][i]), (loc[i], scale[i]))) / 5
            for i in range(4):
                expected = 0.0 if i == j else -math.log(likeness[i])
                assert float(ours[s, i, j]) == pytest.approx(expected, rel=1e-3, abs=1e-4)
    assert float(ours.max()) > 0.1


@pytest.mark.parametrize("family", ["one-sender", "by-content"])
def test_only_the_sender_that_is_read_has_influence(family: str) -> None:
    truth = planted(family, 5, n_steps=40)
    explainer = fit_explainer(influence, truth.policy, truth.reference, 0)
    mask = run_explainer(explainer, truth.policy, truth.observations, 0)
    rows, relevant = mask[torch.from_numpy(truth.counted)], torch.from_numpy(truth.relevant[truth.counted])
    own = torch.eye(5, dtype=torch.bool).expand(40, 5, 5)[torch.from_numpy(truth.counted)]
    assert len(rows) > 100
    assert rows[relevant].eq(1).all()
    assert rows[own].eq(1).all()
    assert rows[~relevant & ~own].max() < 1e-6  # e^-20 of the attention


def test_a_sender_without_attention_has_no_influence(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    policy, observations = small_policy(6, 1), random_observations(4, 3, 6)
    said = torch.full((8, 4, 3, 8), 100.0)
    prepare = policy.prepare

    def deaf(x: Tensor) -> Prepared:
        """To agent 2."""
        prepared = prepare(x)
        return prepared._replace(attention=prepared.attention * torch.tensor([1.0, 1.0, 0.0]))

    monkeypatch.setattr(policy, "prepare", deaf)
    with torch.no_grad():
        found = influences(policy, observations, said)
    assert found[:, :, 2].max() < ROUNDING
    assert found[:, 2, :2].min() > 1e-3


def test_draws_are_messages_of_the_same_sender_and_own_edges_are_kept() -> None:
    policy, observations = small_policy(6, 1), random_observations(6, 3, 6)
    # One reference state, equal to timestep 0 except for agent 1: the others' messages are the same.
    reference = observations[:1].clone()
    reference[:, 1] += 1.0
    fitted = fit_explainer(influence, policy, reference, 0)
    mask = run_explainer(fitted, policy, observations, 0)
    assert mask.diagonal(dim1=1, dim2=2).eq(1).all()
    assert mask[0, [0, 2], 1].eq(1).all()
    assert mask[0, [0, 2], [2, 0]].max() < ROUNDING
    assert mask[1:].gt(ROUNDING).all()


def test_policies_whose_coefficients_are_not_known_are_refused() -> None:
    for policy in (one_layer(6), two_layers(6)):
        fitted = fit_explainer(influence, policy, random_observations(3, 3, 6), 0)
        with pytest.raises(InputError, match="one layer of one head"):
            run_explainer(fitted, policy, random_observations(2, 3, 6), 0)


def test_more_draws_give_more_stable_ranks() -> None:
    """Compared between seeds, because the mixture is estimated by draws."""
    policy, observations = small_policy(6, 1), random_observations(30, 4, 6)
    reference = random_observations(200, 4, 6, 3)

    def masks(draws: int) -> Tensor:
        explain = Influence(draws)
        explain.fit(reference)
        return torch.stack(
            [explain.explain(policy, observations, torch.Generator().manual_seed(k)) for k in range(2)]
        )

    few, many = masks(2), masks(64)
    assert (many[0] - many[1]).abs().mean() < 0.5 * (few[0] - few[1]).abs().mean()


def test_categoricals_are_mixed_exactly() -> None:
    def categorical(*probabilities: list[float]) -> ActionDistribution:
        loc = torch.tensor(probabilities)[:, None].log()
        return ActionDistribution(loc, torch.zeros_like(loc), "categorical")

    even = categorical([0.5, 0.5])._replace(loc=torch.tensor([[0.5, 0.5]]).log())
    # Each message leads to another action for sure; half of them to each, as it is without knowing.
    assert float(kl_to_mixture(even, categorical([1 - 1e-9, 1e-9], [1e-9, 1 - 1e-9]))) < 1e-6
    likely = even._replace(loc=torch.tensor([[0.9, 0.1]]).log())
    expected = 0.9 * math.log(0.9 / 0.5) + 0.1 * math.log(0.1 / 0.5)
    assert float(kl_to_mixture(likely, categorical([0.9, 0.1], [0.1, 0.9]))) == pytest.approx(expected)


def test_a_deterministic_policy_is_refused() -> None:
    one = ActionDistribution(torch.zeros(1, 1, 1), torch.zeros(1, 1, 1), "deterministic")
    with pytest.raises(InputError, match="the policy is deterministic"):
        kl_to_mixture(one, one)


@given(st.lists(st.lists(st.floats(-4, 4), min_size=5, max_size=5), min_size=2, max_size=5))
def test_for_discrete_actions_the_kl_to_the_mixture_is_exact(logits: list[list[float]]) -> None:
    probabilities = np.exp(np.array(logits)) / np.exp(np.array(logits)).sum(axis=-1, keepdims=True)
    p, q = probabilities[0], probabilities[1:].mean(axis=0)
    loc = torch.from_numpy(np.log(probabilities))[:, None]
    one, others = (
        ActionDistribution(part, torch.zeros_like(part), "categorical") for part in (loc[0], loc[1:])
    )
    assert float(kl_to_mixture(one, others)) == pytest.approx((p * np.log(p / q)).sum(), abs=1e-9)
