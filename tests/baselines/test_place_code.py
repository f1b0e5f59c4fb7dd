"""The code of places: an agent's own place, and where its partner is, stand in the mixture it receives."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor
from xmarl_baselines.place_code import LINEAR, code_places
from xmarl_baselines.place_units import REACH, SPACING, passage_units
from xmarl_baselines.recipes import PAPER_NAVIGATION, RECIPES
from xmarl_envs import BlindPassage, State
from xmarl_envs.heuristics.ladder import precedence
from xmarl_envs.task import Floats

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


def passage(n_agents: int, place: Floats, seed: int = 3) -> tuple[GraphPolicy, State, Tensor]:
    """The policy of passage, a state with the agents' centres at `place` (N, 2), and what they observe."""
    torch.manual_seed(0)
    policy = GraphPolicy(
        Architecture.model_validate({**RECIPES["blind_passage_v0"].architecture, "obs_dim": 8})
    )
    code_places(policy, 1.5)
    task = BlindPassage(n_agents)
    layout = task.spawn(np.random.default_rng(seed))
    state = State(place[None], np.zeros((1, n_agents, 2)), layout.targets[None], layout.walls[None])
    return policy.eval(), state, torch.from_numpy(task.observe(state).astype(np.float32))


@torch.no_grad()
def test_passage_an_agent_reads_its_place_beside_the_gap_and_in_the_order() -> None:
    units = passage_units()
    assert units.order is not None
    rng = np.random.default_rng(0)
    place = np.column_stack([rng.uniform(-0.9, 0.9, 5), rng.uniform(-0.9, -0.2, 5)])
    _, state, x = passage(5, place)
    shown = torch.tanh(x @ units.units[:, :-1].T + units.units[:, -1])[0].double().numpy()
    gap = BlindPassage(5).gap(state)
    where, order = shown @ units.place.numpy().T, shown @ units.order.numpy()
    exact = np.column_stack([place[:, 0] - gap[0, 0, 0], place[:, 1]])
    first = precedence(state.targets, gap)[0]
    # Up to a constant. Far from the gap the steps beside it are coarse.
    np.testing.assert_allclose(where[1:, 0] - where[0, 0], exact[1:, 0] - exact[0, 0], atol=0.07)
    np.testing.assert_allclose(where[1:, 1] - where[0, 1], exact[1:, 1] - exact[0, 1], atol=0.005)
    np.testing.assert_allclose(order[1:] - order[0], first[1:] - first[0], atol=0.015)
    assert (np.argsort(order) == np.argsort(first)).all()


@torch.no_grad()
def test_passage_agents_attend_to_themselves_then_to_those_before_them() -> None:
    policy, state, x = passage(5, np.column_stack([np.full(5, 0.1), np.linspace(-0.4, -0.5, 5)]))
    attention = policy.prepare(x).attention[0].numpy()
    first = precedence(state.targets, BlindPassage(5).gap(state))[0]
    for agent in range(5):
        before, behind = first > first[agent], first < first[agent]
        assert (attention[agent, agent] > 1.8 * attention[agent, before]).all()
        if before.any() and behind.any():
            assert attention[agent, before].min() > 1.2 * attention[agent, behind].max()
    assert (np.diag(attention) > 0.5).all()  # the own sign wins


@torch.no_grad()
def test_passage_who_is_far_away_does_not_count() -> None:
    place = np.array([[0.1, -0.4], [0.1, -0.5], [0.1, 0.5]])
    policy, _, x = passage(3, place)
    attention = policy.prepare(x).attention[0].numpy()
    assert attention[:2, 2].max() < 0.01 < attention[0, 1]
