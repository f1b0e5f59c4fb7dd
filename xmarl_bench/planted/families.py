"""Planted truth: policies whose weights are set by hand, so that the relevant messages are known.

An observation holds content (the message), roles and codes. Each family is a rule for which senders a
receiver reads, built into one GATv2 layer and a small decoder. Nothing is trained. States are random. The
truth counts the receivers that the rule applies to.

    one-sender      reads the one agent whose code the receiver's observation names
    by-content      reads the agent that is the speaker at this timestep
    redundant-pair  two speakers send the same content, and either is enough
    exclusive-or    acts where two speakers disagree: one alone gives no information
    decoy           attends most to an agent without content, and reads another
    near-wall       reads the speaker only while the receiver itself is near a wall

S is the number of timesteps, N agents.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from xmarl_bench.errors import InputError, unknown
from xmarl_bench.policy import Architecture, GraphPolicy, build_policy

CODES: Final = 10  # the largest team
SIZES: Final = (4, 6, 8)  # teams by default
# Entries of an observation.
CONTENT, SPEAKER, DECOY, WALL, CODE, NAMED = 0, 1, 2, 3, 4, 4 + CODES
OBS_DIM: Final = NAMED + CODES
# Units of the layer: the content read, the roles speaker and decoy, the wall, and one for each code.
READ, IS_SPEAKER, IS_DECOY, NEAR, MATCH = 0, 1, 2, 3, 4
WIDTH: Final = MATCH + CODES
HIDDEN: Final = 4  # units of the decoder
LOGIT_GAP: Final = 20.0  # the other senders get e^-20 of the attention
MATCH_GAP: Final = 0.8  # summed over codes, GATv2's leaky ReLU gives so much more for a match than for none
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Planted:
    """A policy, states, and the messages that are relevant in them."""

    family: str
    policy: GraphPolicy
    observations: Tensor  # (S, N, D)
    reference: Tensor  # (Q, N, D), other states
    relevant: Bools  # (S, N, N): [s, i, j], message j -> i; False on the diagonal
    counted: Bools  # (S, N): receivers that the rule applies to, with relevant and irrelevant senders


@dataclass(frozen=True)
class Unit:
    """A hidden unit of the decoder: location += out * relu(read * the content read + near * wall + bias)."""

    out: float
    read: float
    near: float = 0.0
    bias: float = 0.0


@dataclass(frozen=True)
class Rule:
    """How a family's states are drawn, and how its decoder uses the content read."""

    speakers: int  # number of speakers, the only agents that are read; 0: codes name the sender
    decoder: tuple[Unit, ...]  # at most HIDDEN
    same: bool = False  # all speakers send the same content
    bits: bool = False  # content is -1 or 1
    decoy: bool = False
    wall: bool = False
    min_agents: int = 3  # smallest team with relevant and irrelevant senders


# loc = 2 read
PROPORTIONAL: Final = (Unit(2.0, 1.0), Unit(-2.0, -1.0))
# loc = 8 read: a quarter of the attention suffices.
AMPLIFIED: Final = (Unit(8.0, 1.0), Unit(-8.0, -1.0))
# loc = 2 clip(read / 0.4, -1, 1): half of the content has the same effect as all of it.
SATURATED: Final = (Unit(5.0, 1.0), Unit(-5.0, 1.0, bias=-0.4), Unit(-5.0, -1.0), Unit(5.0, -1.0, bias=-0.4))
# loc = 2 (1 - |read|), where read is -1 or 1 if both agree, and 0 if they do not.
DISAGREEMENT: Final = (Unit(2.0, 0.0, bias=1.0), Unit(-2.0, 1.0), Unit(-2.0, -1.0))
# loc = 2 read near a wall, where |read| <= 1, and 0 elsewhere. Without content both units are 0 there too.
GATED: Final = (Unit(2.0, 1.0, near=2.0, bias=-2.0), Unit(-2.0, -1.0, near=2.0, bias=-2.0))

FAMILIES: Final[dict[str, Rule]] = {
    "one-sender": Rule(0, PROPORTIONAL),
    "by-content": Rule(1, PROPORTIONAL),
    "redundant-pair": Rule(2, SATURATED, same=True, bits=True, min_agents=4),
    "exclusive-or": Rule(2, DISAGREEMENT, bits=True, min_agents=4),
    "decoy": Rule(1, AMPLIFIED, decoy=True),
    "near-wall": Rule(1, GATED, wall=True),
}


def teams(sizes: Sequence[int] = SIZES) -> list[tuple[str, int]]:
    """Each family with each of the team sizes that it takes."""
    return [(name, size) for name, rule in FAMILIES.items() for size in sizes if size >= rule.min_agents]


def planted(family: str, n_agents: int, *, n_steps: int = 100, seed: int = 0) -> Planted:
    """A family's policy and random states. Raises InputError for an unknown family or team size."""
    if family not in FAMILIES:
        raise unknown("family", family, FAMILIES)
    rule = FAMILIES[family]
    if not rule.min_agents <= n_agents <= CODES:
        raise InputError(
            f"{family} takes {rule.min_agents} to {CODES} agents, got {n_agents}: choose a number in that "
            f"range."
        )
    rng = np.random.default_rng([seed, n_agents, list(FAMILIES).index(family)])
    observations, relevant, counted = _states(rule, n_agents, n_steps, rng)
    reference, _, _ = _states(rule, n_agents, 200, rng)
    return Planted(family, _policy(rule), observations, reference, relevant, counted)


def _states(rule: Rule, n_agents: int, n_steps: int, rng: np.random.Generator) -> tuple[Tensor, Bools, Bools]:
    x = np.zeros((n_steps, n_agents, OBS_DIM), dtype=np.float32)
    relevant = np.zeros((n_steps, n_agents, n_agents), dtype=bool)
    counted = np.ones((n_steps, n_agents), dtype=bool)
    content = rng.uniform(0.25, 1.0, (n_steps, n_agents)) * rng.choice([-1.0, 1.0], (n_steps, n_agents))
    x[..., CONTENT] = np.sign(content) if rule.bits else content
    for s in range(n_steps):
        order = rng.permutation(n_agents)
        chosen, decoy = order[: rule.speakers], order[rule.speakers]
        x[s, chosen, SPEAKER] = 1.0
        if rule.same:
            x[s, chosen, CONTENT] = x[s, chosen[0], CONTENT]
        if rule.decoy:
            x[s, decoy, DECOY], x[s, decoy, CONTENT] = 1.0, 0.0
            counted[s, decoy] = False
        relevant[s][:, chosen] = True
        counted[s, chosen] = False  # a speaker reads itself
        if not rule.speakers:
            named = (np.arange(n_agents) + rng.integers(1, n_agents, n_agents)) % n_agents  # another agent
            codes = rng.permutation(CODES)[:n_agents]
            x[s, np.arange(n_agents), CODE + codes] = 1.0
            x[s, np.arange(n_agents), NAMED + codes[named]] = 1.0
            relevant[s, np.arange(n_agents), named] = True
        if rule.wall:
            x[s, :, WALL] = rng.integers(0, 2, n_agents)
            counted[s] &= x[s, :, WALL] == 1.0
            relevant[s] &= x[s, :, WALL, None] == 1.0
        np.fill_diagonal(relevant[s], False)
    return torch.from_numpy(x), relevant, counted


def _policy(rule: Rule) -> GraphPolicy:
    architecture = Architecture(
        obs_dim=OBS_DIM, encoder=(), encoder_activation="identity", gat_width=WIDTH,
        gat_activation="identity", residual=True, decoder=(HIDDEN,), decoder_activation="relu",
    )  # fmt: skip
    policy = build_policy(architecture)
    assert isinstance(policy, GraphPolicy)
    gat, first, last = policy.gat, policy.decoder[0], policy.decoder[-1]
    assert isinstance(first, nn.Linear)
    assert isinstance(last, nn.Linear)
    with torch.no_grad():
        for parameter in policy.parameters():
            parameter.zero_()
        sender, receiver, logit = gat.lin_l.weight, gat.lin_r.weight, gat.att.view(-1)
        sender[READ, CONTENT] = 1.0
        sender[IS_SPEAKER, SPEAKER] = sender[IS_DECOY, DECOY] = 1.0
        logit[IS_SPEAKER], logit[IS_DECOY] = LOGIT_GAP, LOGIT_GAP + 1.0
        for k in range(CODES):  # 1 if the sender's code and the named code are k, 0 if one of them is
            sender[MATCH + k, CODE + k] = receiver[MATCH + k, NAMED + k] = 1.0
            if not rule.speakers:
                gat.lin_r.bias[MATCH + k] = -1.0
                logit[MATCH + k] = LOGIT_GAP / MATCH_GAP
        gat.res.weight[NEAR, WALL] = 1.0
        for k, unit in enumerate(rule.decoder):
            first.weight[k, READ], first.weight[k, NEAR], first.bias[k] = unit.read, unit.near, unit.bias
            last.weight[:2, k] = unit.out  # of two locations and two scales
    return policy
