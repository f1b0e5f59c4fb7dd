"""Interventions on a policy's messages: does each entry of a mask scale its own edge?

Every policy is tested when it is opened, on random observations and masks. Removing the message j -> i may
change agent i only, and agents without messages must act on their own observations only. S is the number of
timesteps, N agents, D observation entries.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from xmarl_bench.errors import InputError
from xmarl_bench.policy.interface import Policy

SAME = 1e-4  # largest difference, absolute and relative, that counts as rounding
TRIED_AT_ONCE = 2**18  # edges in one batch of teams
MAX_TRIED = 64  # messages removed from a team, one at a time
MAX_AGENTS_TRIED = 8  # agents tested for a reaction to others' observations
STEPS_REMEMBERED = 3  # steps before a policy with memory is tested


def random_teams(n_teams: int, n_agents: int, obs_dim: int) -> Tensor:
    """(n_teams, N, D) random observations, the same in every call."""
    return torch.randn(n_teams, n_agents, obs_dim, generator=torch.Generator().manual_seed(0))


def check_interventions(policy: Policy, observations: Tensor) -> None:
    """(S, N, D) of the task. Raise InputError if agents interact outside of messages, or if a mask scales the
    wrong edges.

    Tests memories together with actions: a message to i may change the memory of i only.
    """
    with torch.no_grad():
        observations = _remembered(policy, observations)
        check_blind(policy, observations)
        for x in observations:
            check_receivers(policy, x)


def _remembered(policy: Policy, observations: Tensor) -> Tensor:
    """(S, N, D) of the task -> with what agents remember after a few steps of seeing it."""
    n_steps, n_agents, _ = observations.shape
    states = torch.cat([observations, policy.initial_state(n_agents).expand(n_steps, -1, -1)], dim=-1)
    for _ in range(STEPS_REMEMBERED if policy.memory_dim else 0):
        memory = policy.step(states.to(_dtype(policy)))[1]
        states = torch.cat([observations, memory], dim=-1)
    return states


def check_blind(policy: Policy, observations: Tensor) -> None:
    """(S, N, D). Raise InputError if an agent without messages reacts to the observations of others.

    Tested with every message masked, and on a graph of loops only, if the network accepts one.
    """
    _check_alone(_masked, policy, observations, "with every message masked")
    try:
        _on_loops(policy, observations)
    except Exception:  # a network need not accept other edges than those of the policy's graph
        return
    _check_alone(_on_loops, policy, observations, "on a graph of loops alone")


def _check_alone(
    answer: Callable[[Policy, Tensor], Tensor], policy: Policy, observations: Tensor, where: str
) -> None:
    here = answer(policy, observations)
    for i in range(min(observations.shape[1], MAX_AGENTS_TRIED)):
        others = observations.flip(0) + 1.0
        others[:, i] = observations[:, i]
        if bool(_difference(here, answer(policy, others))[:, i].any()):
            raise InputError(
                f"agent {i} reacts to what others observe {where}: let agents interact in message-passing "
                f"layers only."
            )


def _masked(policy: Policy, observations: Tensor) -> Tensor:
    n_steps, n_agents, _ = observations.shape
    return _answer(policy, observations, torch.zeros(n_steps, n_agents, n_agents))


def _on_loops(policy: Policy, observations: Tensor) -> Tensor:
    rows = observations.flatten(0, 1).to(_dtype(policy))
    action: Tensor = policy(rows, torch.arange(len(rows)).repeat(2, 1))
    return action.view(*observations.shape[:2], -1)


def check_receivers(policy: Policy, x: Tensor) -> None:
    """(N, D). Raise InputError if removing the message j -> i changes an agent other than i.

    With one layer, the other messages are scaled at random. With several layers, what i receives reaches
    other agents through later messages, so all other receivers get none.
    """
    n_agents, generator = len(x), torch.Generator().manual_seed(1)
    edges = policy.edges(x)
    n_edges = edges.shape[1]
    n_tried = min(n_edges, MAX_TRIED, max(1, TRIED_AT_ONCE // n_agents**2))
    if n_tried == 0:
        return
    sender, receiver = edges[:, torch.randperm(n_edges, generator=generator)[:n_tried]]
    tried = torch.arange(n_tried)
    mask = torch.rand(n_tried, n_agents, n_agents, generator=generator)
    if not policy.row_wise:
        mask *= torch.nn.functional.one_hot(receiver, n_agents)[:, :, None]
    removed = mask.clone()
    removed[tried, receiver, sender] = 0.0
    repeated = x.expand(n_tried, *x.shape)
    changed = _difference(_answer(policy, repeated, mask), _answer(policy, repeated, removed))
    changed[tried, receiver] = False
    if bool(changed.any()):
        k, other = changed.nonzero()[0].tolist()
        raise InputError(
            f"masking the message {int(sender[k])} -> {int(receiver[k])} changes agent {other}: let layers "
            f"pass messages from sender to receiver, and agents interact in them only."
        )


def _answer(policy: Policy, observations: Tensor, mask: Tensor) -> Tensor:
    observations, mask = observations.to(_dtype(policy)), mask.to(_dtype(policy))
    distribution = policy.distribution(observations, mask)
    memory = [policy.step(observations, mask)[1]] if policy.memory_dim else []
    return torch.cat([distribution.loc, distribution.scale, *memory], dim=-1)


def _difference(one: Tensor, other: Tensor) -> Tensor:
    """(..., N, A), twice -> (..., N): whether an agent's outputs differ."""
    return ~torch.isclose(one, other, rtol=SAME, atol=SAME, equal_nan=True).all(dim=-1)


def _dtype(policy: Policy) -> torch.dtype:
    return next((p.dtype for p in policy.parameters()), torch.get_default_dtype())
