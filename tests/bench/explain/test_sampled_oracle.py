"""The sampled oracle against every choice there is, against the enumerated one, and at its limits."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch_geometric.nn import GATv2Conv

from tests.helpers.policies import ROUNDING, random_masks, random_observations, small_policy
from xmarl_bench.explain import oracle as enumeration
from xmarl_bench.explain.absence import DRAWS, Removal, message_table, stand_ins
from xmarl_bench.explain.oracle import change_table, oracle_kind, why_no_oracle
from xmarl_bench.explain.sampled_oracle import (
    ORDERS,
    Best,
    Edges,
    ascend,
    kept_by,
    random_orders,
    ranks,
    standard_error,
)
from xmarl_bench.metrics import fid_delta_table, oracle_at_k, others_table, random_at_k
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.policy import ModulePolicy, Policy, RadiusGraph
from xmarl_bench.scoring.sampled import Sample, Sampled, Stretch

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
MESSAGES = pytest.mark.parametrize("own_kept", [False, True], ids=["all edges", "messages"])


MOST_ERRORS = 5  # standard errors: stated of four pairs, they are Student's with few degrees of freedom


class TwoLayers(nn.Module):
    """forward(x (n, 6), edge_index) -> (n, 2) locations."""

    def __init__(self) -> None:
        super().__init__()
        self.first = GATv2Conv(6, 5, add_self_loops=False)
        self.second = GATv2Conv(5, 2, add_self_loops=False)

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        out: Tensor = self.second(torch.tanh(self.first(x, edge_index)), edge_index)
        return out


def two_layers(seed: int = 0) -> ModulePolicy:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = TwoLayers()
        with torch.no_grad():
            for parameter in network.parameters():
                parameter.copy_(torch.randn(parameter.shape) * 0.7)
    return ModulePolicy(network, 6, distribution="deterministic")


def dense_actions(policy: ModulePolicy, x: Tensor, there: Bools, mask: Floats) -> Floats:
    """(N, 6), (N, N), (N, N) -> (N, 2): two layers of GATv2 written out over all pairs, in float64."""
    assert isinstance(policy.network, TwoLayers)
    hidden = x.double().numpy()
    for layer, activation in ((policy.network.first, np.tanh), (policy.network.second, np.asarray)):
        weights = {name: tensor.double().numpy() for name, tensor in layer.state_dict().items()}
        message = hidden @ weights["lin_l.weight"].T + weights["lin_l.bias"]
        receiver = hidden @ weights["lin_r.weight"].T + weights["lin_r.bias"]
        pair = receiver[:, None] + message[None, :]
        score = np.exp(np.where(pair > 0, pair, 0.2 * pair) @ weights["att"].reshape(-1)) * there
        attention = score / score.sum(axis=-1, keepdims=True)
        hidden = np.asarray(activation((mask * attention) @ message + weights["bias"]))
    return np.asarray(np.tanh(hidden))


def joint_choices(senders: Bools, k: int) -> list[Bools]:
    """(N, N) -> every mask of min(k, P) of each row's own P senders."""
    rows = [list(combinations(np.flatnonzero(row).tolist(), min(k, int(row.sum())))) for row in senders]
    masks = []
    for choice in product(*rows):
        mask = np.zeros(senders.shape, dtype=bool)
        for i, chosen in enumerate(choice):
            mask[i, list(chosen)] = True
        masks.append(mask)
    return masks


def by_every_choice(
    policy: ModulePolicy, observations: Tensor, edges: Edges, there: Bools
) -> tuple[Floats, Floats]:
    """(K,), (K,): mean and maximum of the team's FidDelta over every mask of k edges from every row."""
    means, bests = [], []
    for k in range(1, edges.n_budgets + 1):
        values = []
        for s, x in enumerate(observations):
            full = dense_actions(policy, x, there[s], np.ones(there[s].shape))

            def change(mask: Bools, x: Tensor = x, s: int = s, full: Floats = full) -> float:
                kept = (mask | edges.always).astype(np.float64)
                return float(np.abs(full - dense_actions(policy, x, there[s], kept)).mean())

            values.append([change(~mask) - change(mask) for mask in joint_choices(edges.senders[s], k)])
        means.append(np.mean([np.mean(each) for each in values]))
        bests.append(np.mean([np.max(each) for each in values]))
    return np.array(means), np.array(bests)


def sampled(policy: Policy, observations: Tensor, there: Bools | None = None, seed: int = 0) -> Sampled:
    return Sampled.of(policy, observations, there, None, np.random.default_rng(seed), search=True)


@MESSAGES
@pytest.mark.parametrize("n_agents", [3, 4])
@pytest.mark.slow
def test_several_layers_against_every_joint_choice(n_agents: int, own_kept: bool) -> None:
    policy, observations = two_layers(), random_observations(3, n_agents, 6, 3)
    there = np.ones((3, n_agents, n_agents), dtype=bool)
    found = sampled(policy, observations)
    sample = found.messages[Absence.ZERO] if own_kept else found.all_edges
    edges = Edges.of(there, own_kept=own_kept)
    mean, highest = by_every_choice(policy, observations, edges, there)
    assert sample.random is not None
    assert sample.random_error is not None
    assert sample.oracle is not None
    assert (np.abs(sample.random - mean) <= MOST_ERRORS * sample.random_error + ROUNDING).all()
    assert (sample.oracle <= highest + ROUNDING).all()  # an estimate from below
    assert ((sample.oracle - mean) / (highest - mean) > 0.95).all()
    assert (highest - mean > 0.01).all()


@pytest.mark.slow
def test_a_graph_that_is_not_complete_keeps_to_its_edges() -> None:
    policy, observations = two_layers(2), random_observations(5, 4, 6, 1)
    policy.graph = RadiusGraph(radius=2.0)
    there = policy.graph.adjacency(observations).numpy()
    degree = there.sum(axis=-1)
    assert degree.min() < 3 < degree.max()
    found = sampled(policy, observations, there)
    sample, edges = found.messages[Absence.ZERO], Edges.of(there, own_kept=True)
    mean, highest = by_every_choice(policy, observations, edges, there)
    assert sample.random is not None
    assert sample.random_error is not None
    assert sample.oracle is not None
    assert (np.abs(sample.random - mean) <= MOST_ERRORS * sample.random_error + ROUNDING).all()
    assert (sample.oracle <= highest + ROUNDING).all()
    assert ((sample.oracle - mean) / (highest - mean) > 0.95).all()
    assert found.best is not None
    assert not found.best.numpy()[~there].any()


def one_layer_sample(n_agents: int, absence: Absence, n_steps: int = 6) -> tuple[Sample, Floats]:
    """And FidDelta of every row over the others, of the same stand-ins."""
    policy = small_policy(5, 3, residual=True)
    observations = random_observations(n_steps, n_agents, 5, 1)
    reference = random_observations(11, n_agents, 5, 2)
    with torch.no_grad():
        messages = policy.prepare(reference).message
        replaced = tuple(stand_ins(absence, messages, (DRAWS, n_steps), np.random.default_rng(0)))
        removal = Removal(policy, observations, absence, replaced)
        edges = Edges.of(np.ones((n_steps, n_agents, n_agents), dtype=bool), own_kept=True)
        orders = random_orders(n_steps, n_agents, np.random.default_rng(1))
        places = ranks(np.zeros(orders.shape[1:]), orders, edges.senders)
        sample = Sample([Stretch(slice(0, n_steps), edges, removal)], places).searched(None, row_wise=True)
        if absence is Absence.ZERO:
            change = others_table(change_table(policy, observations))
        else:
            change = message_table(policy, observations, absence, reference, np.random.default_rng(0))
    return sample, fid_delta_table(change)


@pytest.mark.parametrize("absence", list(Absence))
@pytest.mark.parametrize("n_agents", [3, 4, 6, 7, 8])
@pytest.mark.slow
def test_sampled_against_enumerated(n_agents: int, absence: Absence) -> None:
    sample, delta = one_layer_sample(n_agents, absence)
    random, oracle = random_at_k(delta), oracle_at_k(delta)
    assert sample.random is not None
    assert sample.random_error is not None
    assert sample.oracle is not None
    assert (np.abs(sample.random - random) <= MOST_ERRORS * sample.random_error + ROUNDING).all()
    assert (sample.oracle <= oracle + ROUNDING).all()
    reached = (sample.oracle - random) / (oracle - random)
    assert reached.mean() > 0.98
    assert (reached > 0.95).all()


@pytest.mark.slow
def test_the_stated_error_is_the_spread_over_seeds() -> None:
    policy, observations = small_policy(5, 3), random_observations(4, 6, 5, 1)
    edges = Edges.of(np.ones((4, 6, 6), dtype=bool), own_kept=True)
    removal = Removal(policy, observations, Absence.ZERO, (None,))
    for row_wise in (True, False):
        estimates, errors = [], []
        for seed in range(60):
            orders = random_orders(4, 6, np.random.default_rng(seed))
            places = ranks(np.zeros((4, 6, 6)), orders, edges.senders)
            delta = np.stack([edges.fid_delta(removal, kept_by(each, edges)) for each in places])
            estimates.append(delta.mean(axis=(0, 2, 3)))
            errors.append(standard_error(delta, row_wise=row_wise))
        # At k = 2 of 5; 60 estimates give a spread to 10 %.
        assert np.std(estimates, axis=0)[1] == pytest.approx(
            np.sqrt(np.mean(np.square(errors), axis=0))[1], rel=0.3
        )
        assert np.std(estimates, axis=0)[1] > 1e-3


def test_the_error_by_hand() -> None:
    # Two pairs; one budget, one timestep, two rows. Pairs: 1 and 3 of the first row, 2 and 2 of the second.
    delta = np.array([[0.0, 1.0], [2.0, 3.0], [2.0, 2.0], [4.0, 2.0]]).reshape(4, 1, 1, 2)
    assert standard_error(delta, row_wise=True)[0] == pytest.approx(np.sqrt(2.0 / 2) / 2)
    # Rows together: pairs 1.5 and 2.5.
    assert standard_error(delta, row_wise=False)[0] == pytest.approx(np.sqrt(0.5 / 2))


def test_orders_come_with_their_reverse_and_decide_between_equals_only() -> None:
    orders = random_orders(2, 4, np.random.default_rng(0))
    assert orders.shape == (ORDERS, 2, 4, 4)
    np.testing.assert_array_equal(orders[1], 1.0 - orders[0])
    senders = np.ones((2, 4, 4), dtype=bool)
    nothing = ranks(np.zeros((2, 4, 4)), orders, senders)
    np.testing.assert_array_equal(nothing[0] + nothing[1], np.full((2, 4, 4), 3))
    value = np.broadcast_to(np.array([0.5, 0.9, 0.5, 0.1]), (2, 4, 4))
    places = ranks(value, orders, senders)
    assert (places[..., 1] == 0).all()
    assert (places[..., 3] == 3).all()
    assert {1, 2} == set(places[..., 0].ravel())
    others = ~np.broadcast_to(np.eye(4, dtype=bool), (2, 4, 4))
    assert (np.diagonal(ranks(value, orders, others), axis1=-2, axis2=-1) == 3).all()


@pytest.mark.slow
@pytest.mark.parametrize("make", [two_layers, lambda: small_policy(6)], ids=["two layers", "one layer"])
def test_masks_that_rank_nothing_score_exactly_zero(make: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(enumeration, "MAX_AGENTS", 2)
    policy = make()  # type: ignore[operator]
    found = sampled(policy, random_observations(3, 4, 6))
    for mask in (torch.ones(3, 4, 4), torch.zeros(3, 4, 4), torch.eye(4).repeat(3, 1, 1)):
        assert found.score(mask).messages[Absence.ZERO].budgeted == 0.0
    assert found.score(torch.full((3, 4, 4), 0.3)).all_edges.budgeted == 0.0
    ranking = torch.round(random_masks(3, 4) * 256) / 256
    scores = [found.score(mask).messages[Absence.ZERO] for mask in (ranking, 0.9 + ranking / 10)]
    assert scores[0].budgeted == scores[1].budgeted != 0.0


@pytest.mark.slow
def test_fid_delta_at_k_is_that_of_the_mask_run_through_the_policy() -> None:
    policy, observations, mask = two_layers(), random_observations(5, 4, 6), random_masks(5, 4)
    ranked = sampled(policy, observations).score(mask).all_edges
    with torch.no_grad():
        full = policy.distribution(observations).action
        for k in range(1, 4):
            top = (mask >= mask.sort(dim=-1).values[..., [-k]]).float()
            kept, dropped = (policy.distribution(observations, m).action for m in (top, 1 - top))
            expected = (full - dropped).abs().mean() - (full - kept).abs().mean()
            assert ranked.explained[k - 1] == pytest.approx(float(expected), abs=1e-6)


@pytest.mark.slow
def test_a_mask_that_beats_the_search_scores_one() -> None:
    found = sampled(two_layers(), random_observations(3, 4, 6))
    sample = found.messages[Absence.ZERO]
    assert sample.random is not None
    weak = Sample(sample.stretches, sample.drawn, sample.random, sample.random_error, sample.random + 1e-4)
    best = found.best
    assert best is not None
    scored = weak.score(
        ranks(random_masks(3, 4).numpy().astype(float), found.orders[:1], sample.stretches[0].edges.senders)
    )
    assert scored.oracle is not None
    assert (scored.oracle >= scored.explained).all()
    assert not scored.budgeted > 1.0


@pytest.mark.slow
def test_the_best_mask_beats_all_ones_and_what_was_drawn() -> None:
    policy, observations = two_layers(1), random_observations(4, 4, 6)
    found = sampled(policy, observations)
    assert found.best is not None

    def worth(mask: Tensor) -> Floats:
        with torch.no_grad():
            full, kept, dropped = (
                policy.distribution(observations, m).action for m in (None, mask, 1 - mask)
            )
        return ((full - dropped).abs() - (full - kept).abs()).mean(dim=(1, 2)).numpy()

    assert (worth(found.best) >= worth(torch.ones(4, 4, 4)) - 1e-6).all()
    for places in found.all_edges.drawn:
        for kept in kept_by(places, found.all_edges.stretches[0].edges):
            assert (worth(found.best) >= worth(torch.from_numpy(kept).float()) - 1e-6).all()


def test_sweeps_climb_from_any_mask_to_one_that_no_swap_of_a_row_improves() -> None:
    policy, observations = two_layers(3), random_observations(5, 4, 6, 2)
    edges = Edges.of(np.ones((5, 4, 4), dtype=bool), own_kept=True)
    removal = Removal(policy, observations, Absence.ZERO, (None,))
    best = Best.none(edges, row_wise=False)
    orders = random_orders(5, 4, np.random.default_rng(0))
    kept = kept_by(ranks(np.zeros((5, 4, 4)), orders, edges.senders)[0], edges)
    best.take(kept, edges.fid_delta(removal, kept))
    before = best.value.copy()
    for _ in range(3):  # far more sweeps than the search takes
        ascend(removal, edges, best)
    assert (best.value >= before).all()
    assert (best.value > before + 0.01).any()
    np.testing.assert_array_equal(best.kept.sum(axis=-1)[:, 0, 0], [1, 2])
    np.testing.assert_allclose(best.value, best.per_unit(edges.fid_delta(removal, best.kept)), atol=ROUNDING)
    again = best.value.copy()
    ascend(removal, edges, best)
    np.testing.assert_array_equal(best.value, again)


@pytest.mark.slow
def test_stretches_change_rounding_only(monkeypatch: pytest.MonkeyPatch) -> None:
    policy, observations, mask = two_layers(), random_observations(6, 4, 6), random_masks(6, 4)
    whole = sampled(policy, observations)
    monkeypatch.setattr(enumeration, "DECODED_AT_ONCE", 4 * 6 * 2)
    parts = sampled(policy, observations)
    assert len(parts.all_edges.stretches) > len(whole.all_edges.stretches) == 1
    for one, other in zip(
        whole.score(mask).messages.values(), parts.score(mask).messages.values(), strict=True
    ):
        np.testing.assert_allclose(one.explained, other.explained, atol=ROUNDING)
        np.testing.assert_allclose(one.random, other.random, atol=ROUNDING)  # type: ignore[arg-type]
        np.testing.assert_allclose(one.oracle, other.oracle, atol=1e-3)  # type: ignore[arg-type]


def test_which_oracle_a_team_has() -> None:
    one, two = small_policy(6), two_layers()
    kinds = [oracle_kind(one, n) for n in (1, 10, 11, 32, 33)]
    assert kinds == ["enumerated", "enumerated", "sampled", "sampled", None]
    assert [oracle_kind(two, n) for n in (3, 16, 17)] == ["sampled", "sampled", None]
    assert "at most 32 agents with one layer, got 33" in (why_no_oracle(one, 33) or "")
    assert "at most 16 agents with several layers, got 17" in (why_no_oracle(two, 17) or "")


@pytest.mark.parametrize("n_agents", [1, 2])
def test_small_teams_have_little_to_rank(n_agents: int) -> None:
    found = sampled(two_layers(), random_observations(3, n_agents, 6)).score(random_masks(3, n_agents))
    assert np.isnan(found.messages[Absence.ZERO].budgeted)
    assert len(found.all_edges.explained) == n_agents - 1


def test_a_number_does_not_replace_nan() -> None:
    edges = Edges.of(np.ones((1, 3, 3), dtype=bool), own_kept=True)
    best = Best.none(edges, row_wise=True)
    for value in (1.0, np.nan, 2.0):
        best.take(best.kept, np.full(best.value.shape, value))
    assert np.isnan(best.value).all()
