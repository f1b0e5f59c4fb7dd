"""The work of requests, cut into pieces, each with the key of its result in the cache.

A piece is one kind of work on a block of consecutive episodes of a policy: playing them; playing them without
messages (`mute`); measuring what needs no explainer (`shared`); explaining them with one explainer; or
rolling the team out on an explainer's masks, under the absence model zero (`behaviour`) or under the others
(`absences`). Requests that need the same piece share it, within a run and between runs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain, zip_longest
from typing import Literal, NamedTuple

from xmarl_bench.entry.protocol import ABSENCE_EPISODES
from xmarl_bench.policy import Policy, PolicyCard
from xmarl_bench.rollout.cell import BLOCK, Cell
from xmarl_bench.scoring.behaviour import BLOCK as BEHAVIOUR_BLOCK
from xmarl_bench.scoring.piece_keys import Keys, piece_key
from xmarl_bench.scoring.request import Request

Kind = Literal["episodes", "mute", "shared", "explained", "behaviour", "absences"]


@dataclass(frozen=True)
class Environment:
    """What an episode depends on besides its number. All explainers of a policy share its episodes."""

    policy: Policy = field(compare=False)
    card: PolicyCard = field(compare=False)
    policy_key: str
    initial_seed: int | None  # of the policy's weights: one of the controls depends on it
    task_key: str | None  # None: a task of xmarl_envs
    cell: Cell
    seed: int
    max_cycles: int | None

    @classmethod
    def of(cls, request: Request, cell: Cell, keys: Keys) -> Environment:
        policy, card, sampling = request.policy, request.card, request.sampling
        key = keys.policy(policy, card)
        task, seed = keys.task(cell), sampling.seed
        return cls(policy, card, key, card.initial_seed, task, cell, seed, sampling.max_cycles)


@dataclass(frozen=True)
class Block:
    """Consecutive episodes of an environment."""

    environment: Environment
    first: int  # number of its first episode in the run
    seeds: tuple[int, ...]  # environment seeds of its episodes

    def key(self) -> list[str | int | list[int] | None]:
        environment, seeds = self.environment, list(self.seeds)
        cell = environment.cell
        where = environment.policy_key, environment.task_key, cell.task, cell.n_agents
        return [*where, environment.seed, environment.max_cycles, self.first, seeds]


@dataclass(frozen=True)
class Piece:
    """One kind of work on a block. `key` identifies its result."""

    kind: Kind
    block: Block
    timesteps: int | None  # at most so many of each episode; None: all
    explainer: str | None  # its name; None if no explainer is involved
    key: str
    source: Piece | None = None  # the episodes whose states are explained

    def __str__(self) -> str:
        block, last = self.block, self.block.first + len(self.block.seeds) - 1
        what = self.kind if self.explainer is None else f"{self.kind} by {self.explainer}"
        return f"{block.environment.card.name}, {what}, episodes {block.first}-{last}"


class Needs(NamedTuple):
    """The pieces of one cell of a request's entry, in the order of its episodes."""

    episodes: tuple[Piece, ...]
    mute: tuple[Piece, ...]  # the same episodes without messages between agents
    shared: tuple[Piece, ...]
    explained: tuple[Piece, ...]
    behaviour: tuple[Piece, ...]  # empty if the request does not ask for it
    absences: tuple[Piece, ...]  # the first of these episodes under the other absence models
    random_behaviour: tuple[Piece, ...]  # on messages chosen at random
    random_absences: tuple[Piece, ...]


def needs(request: Request, cell: Cell, keys: Keys) -> Needs:
    environment, sampling = Environment.of(request, cell, keys), request.sampling
    name, its_key = request.explainer.name, keys.explainer(request.explainer)
    seeds, n_acted, n_others = sampling.seeds, request.behaviours(cell), request.absence_behaviours(cell)
    played = blocks(environment, seeds, BLOCK)
    acted = blocks(environment, seeds[:n_acted], BEHAVIOUR_BLOCK)
    others = blocks(environment, seeds[:n_others], ABSENCE_EPISODES)
    episodes = _pieces("episodes", played)
    explained = partial(_pieces, blocks=played, timesteps=sampling.timesteps, sources=episodes)
    return Needs(
        episodes=episodes,
        mute=_pieces("mute", played),
        shared=explained("shared", key=f"initial seed {request.card.initial_seed}"),
        explained=explained("explained", explainer=name, key=its_key),
        behaviour=_pieces("behaviour", acted, explainer=name, key=its_key),
        absences=_pieces("absences", others, explainer=name, key=its_key),
        random_behaviour=_pieces("behaviour", acted),
        random_absences=_pieces("absences", others),
    )


def _pieces(
    kind: Kind,
    blocks: Sequence[Block],
    *,
    explainer: str | None = None,
    key: str | None = None,  # of what the results depend on besides the blocks
    timesteps: int | None = None,
    sources: Sequence[Piece] = (),
) -> tuple[Piece, ...]:
    return tuple(
        Piece(kind, block, timesteps, explainer, piece_key(kind, block.key(), timesteps, key), source)
        for block, source in zip_longest(blocks, sources)
    )


def blocks(environment: Environment, seeds: list[int], size: int) -> list[Block]:
    return [
        Block(environment, first, tuple(seeds[first : first + size])) for first in range(0, len(seeds), size)
    ]


@dataclass(frozen=True)
class Plan:
    """A request, and the pieces that it needs for each cell."""

    request: Request
    needs: tuple[Needs, ...]

    @classmethod
    def of(cls, request: Request, keys: Keys) -> Plan:
        return cls(request, tuple(needs(request, cell, keys) for cell in request.cells))

    def __iter__(self) -> Iterator[Piece]:
        for each in self.needs:
            yield from chain(*each)

    @property
    def piece_keys(self) -> list[str]:
        return [piece.key for piece in self]
