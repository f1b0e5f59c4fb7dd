"""Checks of a policy: all agents share one function and interact through messages only.

Masks can explain such policies only. S is the number of timesteps, N agents, D observation entries.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from xmarl_bench.checks.findings import Failed, Finding, NotApplicable, run_checks
from xmarl_bench.counted import counted
from xmarl_bench.errors import InputError
from xmarl_bench.explain.effect import action_change
from xmarl_bench.metrics.attention_entropy import TOLERANCE
from xmarl_bench.metrics.statistics import over_units
from xmarl_bench.policy import ActionDistribution, Policy
from xmarl_bench.policy.interventions import check_blind, check_receivers
from xmarl_bench.reproducible import one_thread
from xmarl_bench.rollout.cell import Cell, spaced_timesteps
from xmarl_bench.rollout.episodes import Floats, play, roll_out
from xmarl_bench.rollout.reference_states import FIRST_FIT_SEED, fit_states
from xmarl_bench.tasks.interface import random_actions

SEED: Final = 1
ROUNDING: Final = 1e-4  # action units: rounding depends on the order of a sum and the size of a batch
LISTENS: Final = 0.02  # mean change without messages, in action units, under which there is little to explain
LEAST_EPISODES: Final = 6  # fewer that all succeed have no interval


@dataclass(frozen=True)
class PolicySubject:
    """A policy in a cell, on states that no score uses."""

    policy: Policy
    cell: Cell
    observations: Tensor  # (S, N, D), of the policy's own episodes
    episodes: int  # for the checks that play episodes

    @cached_property
    def full(self) -> ActionDistribution:
        return self.policy.distribution(self.observations)


def check_policy(policy: Policy, cell: Cell, *, timesteps: int = 20, episodes: int = 20) -> Iterator[Finding]:
    """Run every check, on `timesteps` states of the policy's own episodes and on `episodes` new ones.

    Raises InputError for fewer than LEAST_EPISODES.
    """
    if episodes < LEAST_EPISODES:
        raise InputError(
            f"{counted(episodes, 'episode')} cannot tell a policy from random actions: give at least "
            f"{LEAST_EPISODES}."
        )
    with one_thread(), torch.no_grad():
        states = fit_states(policy, cell)
        states = states[torch.from_numpy(spaced_timesteps(len(states), timesteps))]
        yield from run_checks(CHECKS, PolicySubject(policy, cell, states, episodes))


def weights(subject: PolicySubject) -> str:
    bad = [name for name, each in subject.policy.named_parameters() if not bool(torch.isfinite(each).all())]
    if bad:
        raise Failed(
            f"NaN or infinity in {counted(len(bad), 'tensor')}, the first is {bad[0]!r}: train or save the "
            f"policy again."
        )
    return f"{sum(each.numel() for each in subject.policy.parameters())} parameters, all finite"


def ranges(subject: PolicySubject) -> str:
    loc, scale, action = subject.full.loc, subject.full.scale, subject.full.action
    if not bool(torch.isfinite(loc).all() & torch.isfinite(scale).all()):
        raise Failed("an action is NaN or infinite: look for a division by zero or an overflow.")
    low, high, widest = float(action.min()), float(action.max()), float(scale.max())
    if subject.full.kind == "categorical":
        return f"probabilities of actions {low:.2f} to {high:.2f}"
    if float(action.abs().max()) > 1.0:
        raise Failed(f"an action is {float(action.abs().max()):.3g}: keep actions in [-1, 1].")
    if subject.full.kind != "deterministic" and not bool((scale > 0).all()):
        raise Failed("a scale is not positive: give every Normal a positive scale.")
    return f"actions {low:.2f} to {high:.2f}, scales up to {widest:.2f}"


def repeats(subject: PolicySubject) -> str:
    again = subject.policy.distribution(subject.observations)
    if not torch.equal(again.loc, subject.full.loc):
        raise Failed("the same observations gave another action: remove dropout and random numbers.")
    return "bit for bit"


def batch(subject: PolicySubject) -> str:
    alone = torch.cat([subject.policy.distribution(x[None]).action for x in subject.observations])
    return _close(alone, subject.full.action, "teams of a batch change one another's actions")


def mask_of_ones(subject: PolicySubject) -> str:
    n_steps, n_agents, _ = subject.observations.shape
    masked = subject.policy.distribution(subject.observations, torch.ones(n_steps, n_agents, n_agents))
    return _close(masked.action, subject.full.action, "a mask of ones changes actions")


def equivariance(subject: PolicySubject) -> str:
    """Actions depend on observations and edges, not on the agents' numbers.

    Edges come in the order of these numbers, so this finds dependence on the order of edges too.
    """
    order = torch.arange(subject.observations.shape[1]).roll(1)  # each agent moves by one place
    place = torch.empty_like(order)
    place[order] = torch.arange(len(order))
    here = torch.stack([subject.policy.act(x, subject.policy.edges(x))[order] for x in subject.observations])
    there = torch.stack(
        [subject.policy.act(x[order], place[subject.policy.edges(x)]) for x in subject.observations]
    )
    return _close(there, here, "actions change with the order of agents")


def blindness(subject: PolicySubject) -> str:
    """Without messages from others, an agent's action depends on its own observation alone.

    Without messages: a graph of loops only, and a mask of zeros. (Not the mask of own edges: the attention to
    an agent's own edge depends on the others through the softmax.)
    """
    if subject.observations.shape[1] < 2:
        raise NotApplicable("needs two agents.")
    check_blind(subject.policy, subject.observations)
    return ""


def receivers(subject: PolicySubject) -> str:
    for x in subject.observations:
        check_receivers(subject.policy, x)
    return f"{counted(len(subject.observations), 'state')}, on random masks"


def attends(subject: PolicySubject) -> str:
    try:
        alpha = subject.policy.attention(subject.observations)
    except InputError as error:
        raise NotApplicable(str(error)) from None
    adjacency = subject.policy.adjacency(subject.observations)
    total = alpha.sum(dim=-1)
    heard = total if adjacency is None else total[adjacency.any(dim=-1)]
    off = float((heard - 1.0).abs().max()) if heard.numel() else 0.0
    if off > TOLERANCE or float(alpha.min()) < 0:
        raise Failed(
            f"rows of the attention sum to 1 +- {off:.2g}: return a distribution over senders, as explainers "
            f"expect."
        )
    return f"an agent's own edge has {float(alpha.diagonal(dim1=-2, dim2=-1).mean()):.2f} of it"


def listens(subject: PolicySubject) -> str:
    n_steps, n_agents, _ = subject.observations.shape
    alone = subject.policy.distribution(subject.observations, torch.eye(n_agents).repeat(n_steps, 1, 1))
    change = float(action_change(subject.full, alone).mean())
    if change < LISTENS:
        raise Failed(
            f"removing all messages changes actions by {change:.2g}, less than {LISTENS}: all explanations "
            f"of a policy that ignores its team are trivially faithful. Train it to use messages."
        )
    return f"removing all messages changes actions by {change:.3f}"


def success(subject: PolicySubject) -> str:
    """Against actions drawn at random, in the same episodes; reward where the task tells no success."""
    task = subject.cell.make().with_actions(subject.policy.continuous_actions)
    seeds = range(FIRST_FIT_SEED, FIRST_FIT_SEED + subject.episodes)
    trained = roll_out(task, subject.policy, seeds)
    rng = np.random.default_rng(SEED)

    def at_random(observation: Floats, slots: Sequence[int]) -> tuple[NDArray[Any], Floats]:
        return random_actions(task, len(observation), rng), observation[..., :0]

    chance = play(task, at_random, seeds)
    told = not math.isnan(trained[0].success_rate)
    ours, theirs = ([each.success_rate if told else each.reward for each in of] for of in (trained, chance))
    difference = over_units([ours], [theirs])
    measured = (
        f"{'success' if told else 'reward'} {np.mean(ours):.2f}, random actions {np.mean(theirs):.2f}, "
        f"{counted(len(ours), 'episode')}"
    )
    if difference.interval is None or difference.interval[0] <= 0:
        raise Failed(f"{measured}: not more than chance, train it further.")
    return measured


def _close(one: Tensor, other: Tensor, fault: str) -> str:
    largest = float((one - other).abs().max())
    if not largest <= ROUNDING:
        raise Failed(
            f"{fault}, by up to {largest:.2g}: let agents interact in message-passing layers only, the same "
            f"for all."
        )
    return f"to {largest:.1g}"


CHECKS: Final[dict[str, Callable[[PolicySubject], str]]] = {
    "finite weights": weights,
    "output ranges": ranges,
    "repeats": repeats,
    "independent of the batch": batch,
    "mask of ones is neutral": mask_of_ones,
    "permutation equivariance": equivariance,
    "blind without messages": blindness,
    "masks reach their edges": receivers,
    "attention": attends,
    "uses messages": listens,
    "success above random": success,
}
