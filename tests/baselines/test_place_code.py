"""The code of places: an agent's own place, and where its partner is, stand in the mixture it receives."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor
from xmarl_baselines.place_code import LINEAR, code_places
from xmarl_baselines.place_units import HEADINGS, REACH, SPACING, passage_units
from xmarl_baselines.recipes import PAPER_NAVIGATION, RECIPES

from xmarl_bench.errors import InputError
from xmarl_bench.policy import Architecture, GraphPolicy

STEPS = len(torch.arange(-REACH, REACH + 1e-6, SPACING))
RIPPLE = SPACING / 6  # m, at most, by which a thermometer of finite steps misses the place of an agent alone
FIRST = 8  # channels before it hold the position along 4 directions, forwards and backwards


def coded(sharpness: float = 3.5) -> GraphPolicy:
    torch.manual_seed(0)
    record = {**RECIPES["blind_navigation_v0"].architecture, "obs_dim": 6}
    policy = GraphPolicy(Architecture.model_validate(record))
    code_places(policy, sharpness)
    return policy.eval()


@torch.no_grad()
def received(policy: GraphPolicy, *positions: tuple[float, float]) -> tuple[Tensor, Tensor, Tensor]:
    """Attention (N, N); own places as the thermometers show them, (N, 2); mixtures of places, (N, 2)."""
    x = torch.zeros(1, len(positions), 6)
    x[0, :, :2] = torch.tensor(positions)
    prepared = policy.prepare(x)
    mixed = prepared.attention @ prepared.message + policy.gat.bias
    steps = torch.tanh(mixed[0, :, FIRST : FIRST + 2 * STEPS]).view(-1, 2, STEPS)
    return prepared.attention[0], steps.sum(dim=-1) * SPACING / 2, mixed[0, :, [0, 2]] / LINEAR


def test_an_agent_alone_reads_its_own_place() -> None:
    policy = coded()
    for x in np.linspace(-1.0, 1.0, 21):
        _, own, mixture = received(policy, (float(x), 0.2))
        torch.testing.assert_close(own[0], torch.tensor([float(x), 0.2]), atol=RIPPLE, rtol=0)
        torch.testing.assert_close(mixture[0], own[0], atol=RIPPLE, rtol=0)


@pytest.mark.parametrize("towards", [(0.3, 0.0), (-0.3, 0.0), (0.0, 0.25), (-0.2, -0.2)])
def test_what_the_mixture_differs_by_points_at_the_partner(towards: tuple[float, float]) -> None:
    me = (0.31, -0.17)
    attention, own, mixture = received(coded(), me, (me[0] + towards[0], me[1] + towards[1]))
    torch.testing.assert_close(own[0], torch.tensor(me), atol=0.03, rtol=0)
    exact = torch.tensor(me) + attention[0, 1] * torch.tensor(towards)
    torch.testing.assert_close(mixture[0], exact, atol=0.01, rtol=0)
    difference = mixture[0] - own[0]
    cosine = torch.cosine_similarity(difference, torch.tensor(towards), dim=0)
    assert float(cosine) > 0.95 and float(difference.norm()) > RIPPLE


def test_attention_falls_with_distance() -> None:
    attention, _, _ = received(coded(2.0), (0.0, 0.0), (0.3, 0.0), (0.6, 0.0))
    ratio = float(attention[0, 1] / attention[0, 0])
    assert ratio == pytest.approx(np.exp(-2.0 * 0.8 * 0.3 * (1 + np.sqrt(2))), rel=0.3)
    assert attention[0, 0] > attention[0, 1] > attention[0, 2]


@pytest.mark.parametrize(
    "changes",
    [{"encoder": ()}, {"encoder": (64,)}, {"encoder_activation": "relu"}, {"gat_width": 64}, {"decoder": ()}],
)
def test_an_architecture_that_does_not_take_it_is_refused(changes: dict[str, object]) -> None:
    record = {**RECIPES["blind_navigation_v0"].architecture, "obs_dim": 6, **changes}
    with pytest.raises(InputError, match="a code of places needs"):
        code_places(GraphPolicy(Architecture.model_validate(record)), 3.5)


def test_the_papers_architecture_is_kept_beside_it() -> None:
    assert PAPER_NAVIGATION.architecture["encoder"] == ()
    assert PAPER_NAVIGATION.place_code == 0.0 and PAPER_NAVIGATION.variant == "paper"
