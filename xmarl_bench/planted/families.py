"""Planted truth: policies of the closed list with weights set so that it is known which messages matter.

Agents see content (what they say), roles (whom to listen to) and codes. Every family is a rule of which
senders a receiver reads, built into one GATv2 layer and a small decoder; nothing is trained. States are drawn
at random; rows of the truth are counted for receivers that the rule speaks of.

    one-sender      reads the one agent whose code the receiver's own code names
    by-content      reads whoever is the speaker at the moment
    redundant-pair  two speakers say the same, and either is enough
    exclusive-or    acts where two speakers disagree: neither says anything alone
    decoy           attends most to an agent that says nothing, and reads another
    near-wall       reads the speaker only while the receiver itself is near a wall

S is the number of timesteps, N agents.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from xmarl_bench.errors import InputError, unknown
from xmarl_bench.policy import Architecture, GraphPolicy, build_policy

CODES: Final = 10  # the largest team
# Entries of an observation.
CONTENT, SPEAKER, DECOY, WALL, CODE, NAMED = 0, 1, 2, 3, 4, 4 + CODES
OBS_DIM: Final = NAMED + CODES
# Units of the layer: what is read, who speaks, who is the decoy, the wall, and one for each code.
READ, SPEAKS, LURES, NEAR, MATCH = 0, 1, 2, 3, 4
WIDTH: Final = MATCH + CODES
LOUD: Final = 20.0  # difference of logits: the others get e^-20 of the attention
LEAK: Final = 0.8  # by which GATv2's leaky ReLU tells a match of codes from none
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Planted:
    """A policy, states, and which messages matter in them."""

    family: str
    policy: GraphPolicy
    observations: Tensor  # (S, N, D)
    reference: Tensor  # (Q, N, D), other states
    relevant: Bools  # (S, N, N): [s, i, j], message j -> i; False on the diagonal
    counted: Bools  # (S, N): receivers that the rule speaks of, with relevant senders and others


@dataclass(frozen=True)
class Rule:
    """How a family's states are drawn, and what its decoder does with what is read."""

    speakers: int  # agents with the role, besides whom nobody is read; 0: codes name the sender
    decode: Callable[[Weights], None]
    same: bool = False  # speakers say the same
    bits: bool = False  # content is -1 or 1
    decoy: bool = False
    wall: bool = False
    fewest: int = 3  # agents, so that there is somebody to read and somebody not to


class Weights:
    """The decoder's two layers, of four hidden units; each line is loc += out * relu(read, near, bias)."""

    HIDDEN = 4

    def __init__(self) -> None:
        self.into = torch.zeros(self.HIDDEN, WIDTH)
        self.bias = torch.zeros(self.HIDDEN)
        self.out = torch.zeros(4, self.HIDDEN)  # two locations, two scales
        self._used = 0

    def add(self, out: float, read: float, near: float = 0.0, bias: float = 0.0) -> None:
        k, self._used = self._used, self._used + 1
        self.into[k, READ], self.into[k, NEAR], self.bias[k] = read, near, bias
        self.out[:2, k] = out


def _proportional(w: Weights) -> None:
    """loc = 2 read."""
    w.add(2.0, 1.0)
    w.add(-2.0, -1.0)


def _amplified(w: Weights) -> None:
    """loc = 8 read: a quarter of the attention is enough."""
    w.add(8.0, 1.0)
    w.add(-8.0, -1.0)


def _saturated(w: Weights) -> None:
    """loc = 2 clip(read / 0.4, -1, 1): half of what is said is as good as all of it."""
    for sign in (1.0, -1.0):
        w.add(sign * 5.0, sign)
        w.add(-sign * 5.0, sign, bias=-0.4)


def _disagreement(w: Weights) -> None:
    """loc = 2 (1 - |read|), read = -1 or 1 where both say the same and 0 where they do not."""
    w.add(2.0, 0.0, bias=1.0)
    w.add(-2.0, 1.0)
    w.add(-2.0, -1.0)


def _gated(w: Weights) -> None:
    """loc = 2 read near a wall, 0 elsewhere: |read| <= 1."""
    w.add(2.0, 1.0, near=2.0, bias=-2.0)
    w.add(-2.0, -1.0, near=2.0, bias=-2.0)
    # Without content both units are 0 near the wall too: relu(2 near - 2) = 0.


FAMILIES: Final[dict[str, Rule]] = {
    "one-sender": Rule(0, _proportional),
    "by-content": Rule(1, _proportional),
    "redundant-pair": Rule(2, _saturated, same=True, bits=True, fewest=4),
    "exclusive-or": Rule(2, _disagreement, bits=True, fewest=4),
    "decoy": Rule(1, _amplified, decoy=True),
    "near-wall": Rule(1, _gated, wall=True),
}


def planted(family: str, n_agents: int, *, n_steps: int = 100, seed: int = 0) -> Planted:
    """A family's policy and drawn states. Raises InputError for an unknown family or team size."""
    if family not in FAMILIES:
        raise unknown("family", family, FAMILIES)
    rule = FAMILIES[family]
    if not rule.fewest <= n_agents <= CODES:
        raise InputError(
            f"{family} takes {rule.fewest} to {CODES} agents, got {n_agents}: choose a number in that range."
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
        counted[s, chosen] = False  # who speaks hears itself
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
        gat_activation="identity", residual=True, decoder=(Weights.HIDDEN,), decoder_activation="relu",
    )  # fmt: skip
    policy = build_policy(architecture)
    assert isinstance(policy, GraphPolicy)
    weights = Weights()
    rule.decode(weights)
    gat, first, last = policy.gat, policy.decoder[0], policy.decoder[-1]
    assert isinstance(first, nn.Linear)
    assert isinstance(last, nn.Linear)
    with torch.no_grad():
        for parameter in policy.parameters():
            parameter.zero_()
        said, asked, logit = gat.lin_l.weight, gat.lin_r.weight, gat.att.view(-1)
        said[READ, CONTENT] = 1.0
        said[SPEAKS, SPEAKER] = said[LURES, DECOY] = 1.0
        logit[SPEAKS], logit[LURES] = LOUD, LOUD + 1.0
        for k in range(CODES):  # 1 where the sender's code is the one named, 0 where one of the two is k
            said[MATCH + k, CODE + k] = asked[MATCH + k, NAMED + k] = 1.0
            if not rule.speakers:
                gat.lin_r.bias[MATCH + k] = -1.0
                logit[MATCH + k] = LOUD / LEAK
        gat.res.weight[NEAR, WALL] = 1.0
        first.weight.copy_(weights.into)
        first.bias.copy_(weights.bias)
        last.weight.copy_(weights.out)
    return policy
