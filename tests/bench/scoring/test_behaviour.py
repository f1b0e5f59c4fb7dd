"""Episodes played on an explanation and on its complement."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
import torch
from torch import Tensor
from xmarl_envs import make_task

from tests.helpers.dense_reference import Floats, reference_distribution, reference_messages
from tests.helpers.example_plugins import BAD
from tests.helpers.policies import ROUNDING, random_observations, small_policy
from xmarl_bench.entry.protocol import ABSENCE_EPISODES, DEFINITIONS
from xmarl_bench.errors import InputError
from xmarl_bench.explain.absence import stand_ins, step_under
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.metrics.table import OTHER_ABSENCES, Group, names_of
from xmarl_bench.policy import Policy
from xmarl_bench.rollout.cell import Cell
from xmarl_bench.rollout.episodes import roll_out
from xmarl_bench.scoring.behaviour import (
    BLOCK,
    BehaviourBlock,
    BlockAct,
    Played,
    kept_messages,
    top_messages,
)

TASK = "blind_navigation_v0"


def nearest(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    return torch.exp(-torch.cdist(observations[..., :2], observations[..., :2]))


def noisy(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    n_steps, n_agents, _ = observations.shape
    return torch.rand(n_steps, n_agents, n_agents, generator=generator)


NEAREST, NOISY = Explainer("nearest", nearest), Explainer("noisy", noisy, stochastic=True)


def play(
    explainer: Explainer | None,
    seeds: tuple[int, ...] = (1, 2, 3),
    n_agents: int = 4,
    max_cycles: int = 12,
    *,
    others: bool = False,
) -> Played:
    """others: under the absence models other than zero."""
    reference = random_observations(7, n_agents, 6, seed=3) if others else None
    played = BehaviourBlock(
        small_policy(6), explainer, Cell(TASK, n_agents), seeds, 0, max_cycles, reference
    ).run()
    assert isinstance(played, Played)
    return played


def test_top_messages_of_a_large_team() -> None:
    """Of more senders than an integer has bits."""
    order = np.random.default_rng(0).permuted(np.tile(np.arange(80.0), (1, 80, 1)), axis=-1)
    top = top_messages(order, np.zeros_like(order), 40).numpy()[0]
    np.fill_diagonal(order[0], -1.0)
    fortieth = np.sort(order[0], axis=-1)[:, [-40]]
    np.testing.assert_array_equal(top, order[0] >= fortieth)


def test_top_messages_by_hand() -> None:
    mask = np.array([[[0.9, 0.1, 0.2], [0.5, 0.0, 0.4], [0.3, 0.3, 1.0]]])
    tie = np.zeros((1, 3, 3))
    tie[0, 2] = [0.2, 0.1, 0.0]  # among equal values the smaller noise wins
    assert top_messages(mask, tie, 1).tolist() == [[[0, 0, 1], [1, 0, 0], [0, 1, 0]]]


@pytest.mark.parametrize(("n_agents", "k"), [(3, 1), (4, 1), (5, 2), (8, 3)])
def test_half_of_the_other_messages_are_kept(n_agents: int, k: int) -> None:
    assert kept_messages(n_agents) == k
    rng = np.random.default_rng(0)
    top = top_messages(rng.random((5, n_agents, n_agents)), rng.random((5, n_agents, n_agents)), k)
    assert bool((top.sum(dim=-1) == k).all())
    assert float(top.diagonal(dim1=1, dim2=2).max()) == 0.0


@pytest.mark.slow
def test_teams_hear_only_the_kept_messages() -> None:
    """A constant explanation is a constant mask, so the episode equals a rollout under that mask."""
    ranks = torch.tensor(
        [[0.0, 0.9, 0.1, 0.2], [0.9, 0.0, 0.1, 0.2], [0.1, 0.9, 0.0, 0.2], [0.1, 0.2, 0.9, 0.0]]
    )
    fixed = Explainer("fixed", lambda policy, observations, generator: ranks.expand(len(observations), 4, 4))
    top = (ranks == 0.9).float()
    own = torch.eye(4)
    seeds = (5, 6)
    for team, mask in zip(("on_explanation", "on_complement"), (top + own, 1.0 - top), strict=True):
        expected = roll_out(make_task(TASK, 4), small_policy(6), seeds, max_cycles=30, mask=mask)
        received = [getattr(row, f"reward_{team}") for row in play(fixed, seeds, max_cycles=30).rows]
        assert received == pytest.approx([episode.reward for episode in expected], abs=1e-5)
    assert play(fixed, seeds, max_cycles=30) != play(None, seeds, max_cycles=30)


def test_the_explainer_gets_the_states_of_its_own_team() -> None:
    seen: list[Tensor] = []

    def watch(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
        seen.append(observations.clone())
        return nearest(policy, observations, generator)

    play(Explainer("watch", watch), (1, 2), max_cycles=9)
    assert len(seen) == 9
    assert {tuple(each.shape) for each in seen} == {(2 * BLOCK, 4, 6)}  # for any number of live episodes
    first, last = seen[0], seen[-1]
    assert torch.equal(first[:2], first[BLOCK : BLOCK + 2])  # both teams start in the same state
    assert not torch.equal(last[:2], last[BLOCK : BLOCK + 2])  # and then differ
    assert torch.equal(last[2:BLOCK], last[:1].expand(BLOCK - 2, -1, -1))  # padding


@pytest.mark.slow
@pytest.mark.parametrize("others", [False, True])
@pytest.mark.parametrize("explainer", [NEAREST, NOISY, None])
def test_an_episode_does_not_depend_on_the_others_of_its_batch(
    explainer: Explainer | None, others: bool
) -> None:
    whole, part = (play(explainer, seeds, others=others) for seeds in ((1, 2, 3), (1, 2)))
    assert whole.rows[:2] == part.rows
    assert whole.rows == play(explainer, (1, 2, 3), others=others).rows


def test_the_fidelity_is_the_difference_of_successes() -> None:
    for others, prefixes in ((False, [""]), (True, [f"{name}_" for name in OTHER_ABSENCES])):
        for row, prefix in product(play(NEAREST, others=others).rows, prefixes):
            fidelity, kept, dropped = (
                getattr(row, f"{prefix}{name}")
                for name in ("behavioural_fidelity", "success_on_explanation", "success_on_complement")
            )
            assert kept is not None
            assert dropped is not None
            assert fidelity == kept - dropped


def test_a_block_has_the_metrics_of_its_absence_models_and_no_others() -> None:
    for others, group in ((False, Group.BEHAVIOUR), (True, Group.BEHAVIOUR_UNDER)):
        for row in play(NEAREST, others=others).rows:
            assert {name for name, value in row if value is not None} == set(names_of(group))
    assert f"of the first {ABSENCE_EPISODES} episodes" in DEFINITIONS["mean_behavioural_fidelity"]


@pytest.mark.parametrize("n_agents", [3, 4, 5])
@pytest.mark.parametrize("residual", [False, True], ids=["plain", "residual"])
def test_a_step_under_each_model_is_that_of_a_dense_computation(n_agents: int, residual: bool) -> None:
    """Message by message in float64. Resample is what one of the reference states gives, not always one."""
    policy = small_policy(6, residual=residual)
    observation, reference = (random_observations(n, n_agents, 6, seed=n) for n in (12, 5))
    ranks = torch.rand(n_agents, n_agents, generator=torch.Generator().manual_seed(0))
    fixed = Explainer("fixed", lambda policy, x, generator: ranks.expand(len(x), *ranks.shape))
    act = BlockAct(BehaviourBlock(policy, fixed, Cell(TASK, n_agents), (1, 2), 0, None, reference))
    found = act(observation.numpy(), range(12))[0].reshape(3, 2, 2, n_agents, 2)  # model, half, episode
    x = observation.double().numpy().reshape(3, 2, 2, n_agents, 6)
    no_ties = np.zeros((1, n_agents, n_agents))
    top = top_messages(ranks[None].numpy(), no_ties, kept_messages(n_agents))[0]
    masks = [torch.maximum(half, torch.eye(n_agents)).double().numpy() for half in (top, 1.0 - top)]
    heard = [reference_messages(policy, each) for each in reference.double().numpy()]

    def off(model: int, half: int, episode: int, stand_in: Floats | None) -> float:
        """How far the action is from the dense one."""
        where = model, half, episode
        loc, _ = reference_distribution(
            policy,
            x[where],
            masks[half],
            stand_in=stand_in,
            renormalised=OTHER_ABSENCES[model] is Absence.RENORMALISED,
        )
        return float(np.abs(found[where] - np.tanh(loc)).max())

    assert OTHER_ABSENCES == (Absence.MEAN, Absence.RESAMPLE, Absence.RENORMALISED)
    drawn = set()
    for half, episode in product(range(2), range(2)):
        assert off(0, half, episode, np.mean(heard, axis=0)) < ROUNDING
        assert off(2, half, episode, None) < ROUNDING
        apart = [off(1, half, episode, each) for each in heard]
        assert min(apart) < ROUNDING < 1e-3 < sorted(apart)[1]
        drawn.add(int(np.argmin(apart)))
    assert len(drawn) > 1


@pytest.mark.parametrize("absence", list(Absence))
def test_a_team_that_loses_no_message_is_the_full_team(absence: Absence) -> None:
    policy, observations = small_policy(6), random_observations(5, 4, 6)
    messages = policy.prepare(random_observations(7, 4, 6, seed=1)).message
    (stand_in,) = stand_ins(absence, messages, (1, 5), np.random.default_rng(0))
    with torch.no_grad():
        prepared = policy.prepare(observations)
        for mask, same in ((torch.ones(5, 4, 4), True), (torch.eye(4).expand(5, 4, 4), False)):
            action = step_under(policy, prepared, mask, absence, stand_in)[0].action
            assert torch.allclose(action, policy.decode(prepared).action, atol=ROUNDING) is same


@pytest.mark.parametrize("name", sorted(BAD))
def test_an_explainer_that_fails_is_named(name: str) -> None:
    result = BehaviourBlock(small_policy(6), BAD[name], Cell(TASK, 3), (1,), 0, 5).run()
    assert isinstance(result, InputError)
    assert repr(name) in str(result)


def test_a_team_with_zero_messages_does_equally_well_on_both_halves() -> None:
    policy = small_policy(6)
    with torch.no_grad():
        policy.gat.lin_l.weight.zero_()  # every message is zero
        policy.gat.lin_l.bias.zero_()
    result = BehaviourBlock(policy, NEAREST, Cell(TASK, 3), (1, 2), 0, 20).run()
    assert isinstance(result, Played)
    for row, metric in product(result.rows, ("success", "reward")):
        # Only the rounding depends on the place in the batch.
        kept, dropped = getattr(row, f"{metric}_on_explanation"), getattr(row, f"{metric}_on_complement")
        assert kept == pytest.approx(dropped, abs=1e-6)
