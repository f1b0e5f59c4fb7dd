"""Agent Shapley values: each agent's share of what the team gains in the next second by acting.

Paper: Heuillet, Couthouis and Diaz-Rodriguez, "Collective eXplainable AI: Explaining Cooperative Strategies
and Agent Contribution in Multiagent Reinforcement Learning With Shapley Values" (IEEE Computational
Intelligence Magazine, 2022), with its no-op for agents outside of the coalition. Formula: agents are the
players, and from the state that is explained

    v(C) = mean over agents of the return over H steps in which C acts by the policy and no other acts,
    phi_j = mean over orders of  v(those before j, and j) - v(those before j).

Not to act is no force, so an absent agent coasts. Its body stays in the way, and it still sends messages.
The values add up to v(everybody) - v(nobody). All 2^N coalitions are played up to N = 6; above, those of 16
random orders, the same for all timesteps, every second the reverse of the one before.

Departures: the paper plays whole episodes from their start, and says that its values explain no single
moment; short rollouts from a recorded state are about that moment. A rollout ends when the task is done, and
not at the episode's last cycle. An edge has the value of its sender, so all receivers have the same row, and
the harness makes a mask of it by its normaliser for signed values. What is explained is what agents do, not
what they say: one to whom nobody listens may be worth most.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from xmarl_baselines.explainers.batching import by_chunks
from xmarl_bench.explain.adapters import as_explainer
from xmarl_bench.explain.simulator import Simulator
from xmarl_bench.policy import Policy
from xmarl_bench.rollout.episodes import chooser

STEPS = 10  # H, of 0.1 s
EXACT_UP_TO = 6  # agents
PAIRS = 8  # of a random order and its reverse
COPIES_AT_ONCE = 1024  # of the world: bounds memory

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


def all_coalitions(n_agents: int) -> tuple[Bools, Floats]:
    """The coalitions (K, N) that are played, and weights (K, N): phi_j = sum_k weights[k, j] v(k)."""
    members = (np.arange(2**n_agents)[:, None] >> np.arange(n_agents) & 1).astype(bool)
    size = members.sum(axis=1)
    orders = np.array([math.factorial(k) * math.factorial(n_agents - 1 - k) for k in range(n_agents)])
    share = orders / math.factorial(n_agents)  # of the orders in which these k agents come before j
    joined, without = share[np.maximum(size - 1, 0)], share[np.minimum(size, n_agents - 1)]
    return members, np.where(members, joined[:, None], -without[:, None])


def sampled_coalitions(n_agents: int, pairs: int, generator: torch.Generator) -> tuple[Bools, Floats]:
    """As `all_coalitions`, the mean over 2 * pairs orders: those before each agent, each coalition once."""
    weights: dict[tuple[int, ...], Floats] = {}
    for _ in range(pairs):
        order = torch.randperm(n_agents, generator=generator).tolist()
        for each in (order, order[::-1]):
            stages = [tuple(sorted(each[:k])) for k in range(n_agents + 1)]
            for j, (before, after) in zip(each, pairwise(stages), strict=True):
                weights.setdefault(before, np.zeros(n_agents))[j] -= 1 / (2 * pairs)
                weights.setdefault(after, np.zeros(n_agents))[j] += 1 / (2 * pairs)
    members = np.zeros((len(weights), n_agents), dtype=bool)
    for row, coalition in zip(members, weights, strict=True):
        row[list(coalition)] = True
    return members, np.stack(list(weights.values()))


def payoffs(
    policy: Policy, observations: Tensor, simulator: Simulator, members: Bools, n_steps: int
) -> Floats:
    """(S, N, D) states, (K, N) coalitions -> (S, K): the team's return over the next steps."""
    acting = np.tile(members, (len(observations), 1))  # (S K, N)
    states = observations.repeat_interleave(len(members), dim=0)
    env, choose = simulator.restart(policy, states), chooser(policy)
    memory = states[..., env.task.obs_dim :].numpy()
    total, playing = np.zeros(len(acting)), np.ones(len(acting), dtype=np.bool_)
    for _ in range(n_steps):
        chosen, memory = choose(np.concatenate([env.observe(), memory], axis=-1))
        # The no-op is 0, of continuous and of discrete actions.
        step = env.step(np.where(acting if chosen.ndim == 2 else acting[..., None], chosen, 0), playing)
        total += step.reward.mean(axis=1) * playing
        playing &= ~step.terminated
    return total.reshape(len(observations), len(members))


def agent_shapley_values(
    policy: Policy, observations: Tensor, generator: torch.Generator, simulator: Simulator
) -> Tensor:
    """(S, N, D) -> (S, N, N), of either sign: [s, i, j] is phi_j."""
    n_agents = observations.shape[1]
    exact = n_agents <= EXACT_UP_TO
    members, weights = all_coalitions(n_agents) if exact else sampled_coalitions(n_agents, PAIRS, generator)

    def explain(steps: slice) -> Tensor:
        values = payoffs(policy, observations[steps], simulator, members, STEPS) @ weights
        return torch.from_numpy(values).float()[:, None].expand(-1, n_agents, -1)

    return by_chunks(observations, explain, steps_at_once=max(1, COPIES_AT_ONCE // len(members)))


agent_shapley = as_explainer(
    agent_shapley_values,
    name="agent-shapley",
    summary="Shapley values of agents for the team's return, absent agents do nothing",
    stochastic=True,  # above 6 agents
    slow=True,
    signed=True,
    hyperparameters={"steps": STEPS, "exact_up_to": EXACT_UP_TO, "orders": 2 * PAIRS},
)
