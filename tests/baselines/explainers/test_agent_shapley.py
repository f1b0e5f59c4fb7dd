"""Agent Shapley values: against all orders, against games played one by one, and by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import permutations
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor
from xmarl_baselines.explainers.agent_shapley import (
    agent_shapley,
    all_coalitions,
    payoffs,
    sampled_coalitions,
)
from xmarl_envs import VectorEnv, make_task

from tests.helpers.policies import small_policy
from tests.helpers.recurrent_policies import recurrent_policy, remembering
from xmarl_bench.errors import InputError
from xmarl_bench.explain.explainer import run_explainer
from xmarl_bench.explain.simulator import Simulator
from xmarl_bench.policy import ActionDistribution, Policy
from xmarl_bench.policy.architecture import DistributionKind
from xmarl_bench.rollout.episodes import chooser, initial_state

TASK = "blind_navigation_v0"


class Constant(Policy):
    """Every agent always does the same; nobody hears anybody."""

    row_wise = True

    def __init__(self, action: Tensor, *, discrete: bool = False) -> None:
        super().__init__()
        self.fixed, self.continuous_actions = action, not discrete

    def act(self, x: Tensor, edge_index: Tensor, weight: Tensor | None = None) -> Tensor:
        raise NotImplementedError

    def prepare(self, observation: Tensor) -> Any:
        return len(observation)

    def decode(self, prepared: Any, mask: Tensor | None = None) -> ActionDistribution:
        loc = self.fixed.expand(prepared, -1, -1)
        kind: DistributionKind = "deterministic" if self.continuous_actions else "categorical"
        return ActionDistribution(loc, torch.zeros_like(loc), kind)

    def attention(self, observation: Tensor) -> Tensor:
        raise NotImplementedError


def team(*places: tuple[float, float]) -> Tensor:
    """(1, N, 6) agents of a navigation team at rest."""
    x = torch.zeros(1, len(places), 6)
    x[0, :, :2] = torch.tensor(places)
    return x


@given(n_agents=st.integers(1, 5), seed=st.integers(0, 1000))
def test_the_weights_are_those_of_all_orders(n_agents: int, seed: int) -> None:
    members, weights = all_coalitions(n_agents)
    payoff = np.random.default_rng(seed).normal(size=2**n_agents)
    number = {frozenset(np.flatnonzero(row).tolist()): k for k, row in enumerate(members)}
    assert len(number) == 2**n_agents
    expected = np.zeros(n_agents)
    for order in permutations(range(n_agents)):
        for k, j in enumerate(order):
            gain = payoff[number[frozenset(order[: k + 1])]] - payoff[number[frozenset(order[:k])]]
            expected[j] += gain / math.factorial(n_agents)
    np.testing.assert_allclose(payoff @ weights, expected, atol=1e-12)


@given(n_agents=st.integers(1, 9), seed=st.integers(0, 1000))
def test_sampled_orders_share_out_what_everybody_gains(n_agents: int, seed: int) -> None:
    members, weights = sampled_coalitions(n_agents, 4, torch.Generator().manual_seed(seed))
    played = set(map(tuple, members.tolist()))
    assert len(played) == len(members)
    assert played == set(map(tuple, (~members).tolist()))  # every order is reversed, too
    shared = weights.sum(axis=1)  # of each coalition's payoff: efficiency
    everybody, nobody = members.all(axis=1), ~members.any(axis=1)
    np.testing.assert_allclose(shared[everybody & ~nobody], 1.0)
    np.testing.assert_allclose(shared[nobody & ~everybody], -1.0)
    np.testing.assert_allclose(shared[~everybody & ~nobody], 0.0, atol=1e-12)
    additive = members @ np.arange(1.0, n_agents + 1)
    np.testing.assert_allclose(additive @ weights, np.arange(1.0, n_agents + 1))


def test_sampled_values_approach_the_exact_ones() -> None:
    rng = np.random.default_rng(0)
    _, weights = all_coalitions(4)
    payoff = rng.normal(size=16)
    sampled, its_weights = sampled_coalitions(4, 2000, torch.Generator().manual_seed(0))
    its_payoff = payoff[sampled @ (1 << np.arange(4))]
    np.testing.assert_allclose(its_payoff @ its_weights, payoff @ weights, atol=0.05)


@pytest.mark.parametrize("task", [TASK, "blind_passage_v0", "blind_discovery_v0"])
def test_payoffs_are_returns_of_teams_played_one_by_one(task: str) -> None:
    """From the start of an episode, in an environment of each coalition's own."""
    rules, seed, steps = make_task(task, 3), 5, 8
    policy = small_policy(rules.obs_dim, 1)
    members, _ = all_coalitions(3)
    expected = []
    for coalition in members:
        env, total = VectorEnv(rules), 0.0
        observation = env.reset([seed])
        for _ in range(steps):
            with torch.no_grad():
                action = policy.distribution(torch.from_numpy(observation)).action.numpy()
            step = env.step(action * coalition[:, None])
            observation, total = step.observation, total + float(step.reward.mean())
            if step.terminated[0]:
                break
        expected.append(total)
    state = torch.from_numpy(VectorEnv(rules).reset([seed]))
    found = payoffs(policy, state.repeat(2, 1, 1), Simulator(task, 3, seed), members, steps)
    np.testing.assert_allclose(found, [expected, expected], atol=1e-4)
    assert np.ptp(expected) > 1e-3 or task == "blind_discovery_v0"


@pytest.mark.parametrize("policy", [small_policy(6, 1), recurrent_policy(remembering("gru", 1))])
def test_everybody_together_goes_on_as_the_episode_did(policy: Policy) -> None:
    """Also where agents remember: what they did at a timestep goes on from there."""
    env, choose, seed = VectorEnv(make_task(TASK, 1)), chooser(policy), 5
    observation, memory = env.reset([seed]), initial_state(policy, 1)[None]
    states, rewards = [], []
    for _ in range(20):
        states.append(np.concatenate([observation, memory], axis=-1))
        action, memory = choose(states[-1])
        step = env.step(action)
        observation = step.observation
        rewards.append(float(step.reward.mean()))
    everybody = np.ones((1, 1), dtype=bool)
    x = torch.from_numpy(np.concatenate(states)[:12])
    found = payoffs(policy, x, Simulator(TASK, 1, seed), everybody, 8)[:, 0]
    np.testing.assert_allclose(found, [sum(rewards[t : t + 8]) for t in range(12)], atol=1e-5)
    assert np.ptp(found) > 0.01


def test_who_alone_acts_alone_has_a_value() -> None:
    """Nobody else moves, so 1 gets what is gained: the way by the closed form of free flight."""
    push = torch.zeros(3, 2)
    push[1, 0] = 5.0  # tanh(5) = 0.9999
    x, simulator = team((-3.0, 9.0), (0.0, 9.0), (3.0, 9.0)), Simulator(TASK, 3, 0)
    mask = run_explainer(replace(agent_shapley, simulator=simulator), Constant(push), x, 0)
    assert torch.equal(mask[0], torch.tensor([0.5, mask[0, 0, 1], 0.5]).expand(3, 3))
    assert mask[0, 0, 1] in (0.0, 1.0)  # towards its goal or away
    members, weights = all_coalitions(3)
    value = payoffs(Constant(push), x, simulator, members, 10) @ weights
    goal = make_task(TASK, 3).spawn(np.random.default_rng(0)).targets[1]
    kept, way, velocity = 0.75**0.5, 0.0, 0.0
    for _ in range(20):  # substeps of 0.05 s
        way, velocity = way + velocity * 0.05, velocity * kept + math.tanh(5.0) * 0.05
    gained = math.dist((0.0, 9.0), goal) - math.dist((way, 9.0), goal)
    np.testing.assert_allclose(value, [[0.0, gained, 0.0]], atol=1e-5)


def test_a_rollout_ends_with_the_task() -> None:
    goals = make_task(TASK, 2).spawn(np.random.default_rng(0)).targets
    x = team(*map(tuple, goals.tolist()))
    away, members = Constant(torch.full((2, 2), 5.0)), np.ones((1, 2), dtype=bool)
    one, ten = (payoffs(away, x, Simulator(TASK, 2, 0), members, n) for n in (1, 10))
    assert np.array_equal(one, ten)
    assert one > 0.0  # paid for being there


def test_discrete_actions() -> None:
    """Action 2 is a push to the right, 0 none: who is absent takes 0."""
    logits = torch.full((2, 5), -9.0)
    logits[:, 2] = 0.0
    x, simulator, (members, _) = team((0.0, 9.0), (3.0, 9.0)), Simulator(TASK, 2, 0), all_coalitions(2)
    discrete = payoffs(Constant(logits, discrete=True), x, simulator, members, 10)
    right = torch.tensor([[20.0, 0.0], [20.0, 0.0]])
    np.testing.assert_allclose(discrete, payoffs(Constant(right), x, simulator, members, 10), atol=1e-6)
    assert len(np.unique(discrete)) == 4


@pytest.mark.slow
def test_large_teams_are_sampled_and_others_are_not() -> None:
    def mask(n_agents: int, seed: int) -> Tensor:
        x = team(*((3.0 * k, 9.0) for k in range(n_agents)))
        x[..., 2:4] = 0.3
        explainer = replace(agent_shapley, simulator=Simulator(TASK, n_agents, 0))
        return run_explainer(explainer, small_policy(6, 1), x, seed)

    assert torch.equal(mask(3, 0), mask(3, 1))
    one, two = mask(7, 0), mask(7, 1)
    assert not torch.equal(one, two)
    assert (one - two).abs().max() < 0.2


def test_states_of_no_episode_are_refused() -> None:
    with pytest.raises(InputError, match="explainer 'agent-shapley' plays on in the world of an episode"):
        run_explainer(agent_shapley, small_policy(6), team((0.0, 0.0), (1.0, 1.0)), 0)
    elsewhere = replace(agent_shapley, simulator=Simulator(TASK, 3, 0))
    with pytest.raises(InputError, match="a world of 3 agents cannot be restarted"):
        run_explainer(elsewhere, small_policy(6), team((0.0, 0.0), (1.0, 1.0)), 0)
