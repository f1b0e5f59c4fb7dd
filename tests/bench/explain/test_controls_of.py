"""Controls that use the agents' positions or the network before training."""

from __future__ import annotations

import math

import torch

from tests.helpers.policies import random_observations, small_policy
from xmarl_bench.explain.control_names import INITIAL_ATTENTION, NEAREST
from xmarl_bench.explain.controls import CONTROLS, controls_of
from xmarl_bench.explain.explainer import run_explainer
from xmarl_bench.policy import PolicyCard
from xmarl_bench.policy.build import untrained_policy

TASK = "blind_navigation_v0"


def card(initial_seed: int | None) -> PolicyCard:
    architecture = small_policy(6).architecture
    return PolicyCard(
        name="one",
        task=TASK,
        n_agents=3,
        attention_entropy=0.0,
        training_seed=0,
        initial_seed=initial_seed,
        architecture=architecture,
        weights_sha256="0" * 64,
    )


def test_initial_attention_is_a_control_if_the_card_has_the_seed() -> None:
    assert [each.name for each in controls_of(TASK, card(None))] == [*CONTROLS, NEAREST]
    assert [each.name for each in controls_of(TASK, card(4))] == [*CONTROLS, NEAREST, INITIAL_ATTENTION]
    assert all(each.control for each in controls_of(TASK, card(4)))


def test_nearest_by_hand() -> None:
    nearest = next(each for each in controls_of(TASK, card(None)) if each.name == NEAREST)
    observations = random_observations(1, 3, 6)
    observations[0, :, :2] = torch.tensor([[0.0, 0.0], [3.0, 4.0], [0.0, 1.0]])
    mask = run_explainer(nearest, small_policy(6), observations, 0)[0]
    far = math.exp(-math.sqrt(9 + 9))
    expected = [[1.0, math.exp(-5), math.exp(-1)], [math.exp(-5), 1.0, far], [math.exp(-1), far, 1.0]]
    torch.testing.assert_close(mask, torch.tensor(expected))


def test_initial_attention_is_that_of_the_untrained_network() -> None:
    initial = next(each for each in controls_of(TASK, card(4)) if each.name == INITIAL_ATTENTION)
    observations = random_observations(5, 3, 6)
    with torch.no_grad():
        untrained = untrained_policy(small_policy(6).architecture, 4).attention(observations)
        trained = small_policy(6, 1).attention(observations)
    mask = run_explainer(initial, small_policy(6, 1), observations, 0)
    assert torch.equal(mask, untrained)
    assert not torch.allclose(mask, trained)
