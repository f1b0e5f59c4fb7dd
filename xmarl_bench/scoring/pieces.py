"""The work that requests ask for, cut into pieces: what each is, and the key of its result in the cache.

A piece is a block of consecutive episodes of a policy: played; played without messages (`mute`); measured
without any explainer (`shared`); explained by one explainer; or acted out on an explainer's masks
(`behaviour`). Requests that need the same piece share it, in one run and between runs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

from xmarl_bench.policy import Policy, PolicyCard
from xmarl_bench.rollout.cell import BLOCK, Cell
from xmarl_bench.scoring.behaviour import BLOCK as BEHAVIOUR_BLOCK
from xmarl_bench.scoring.piece_keys import Keys, piece_key
from xmarl_bench.scoring.request import Request

Kind = Literal["episodes", "mute", "shared", "explained", "behaviour"]


@dataclass(frozen=True)
class World:
    """What an episode depends on beside its number; all explainers of a policy share its episodes."""

    policy: Policy = field(compare=False)
    card: PolicyCard = field(compare=False)
    policy_key: str
    cell: Cell
    seed: int
    max_cycles: int | None

    @classmethod
    def of(cls, request: Request, cell: Cell, keys: Keys) -> World:
        policy, card, sampling = request.policy, request.card, request.sampling
        key = keys.policy(policy, card)
        return cls(policy, card, key, cell, sampling.seed, sampling.max_cycles)


@dataclass(frozen=True)
class Block:
    """Consecutive episodes of a world."""

    world: World
    first: int  # number of the first in its run
    seeds: tuple[int, ...]  # of the environment

    def key(self) -> list[str | int | list[int] | None]:
        world, seeds = self.world, list(self.seeds)
        where = world.policy_key, world.cell.task, world.cell.n_agents
        return [*where, world.seed, world.max_cycles, self.first, seeds]


@dataclass(frozen=True)
class Piece:
    """A block's work of one kind. `key` names its result."""

    kind: Kind
    block: Block
    timesteps: int | None  # at most so many of each episode; None is all
    explainer: str | None  # its name; None where none has a part in it
    key: str
    source: Piece | None = None  # the episodes whose states are explained

    def __str__(self) -> str:
        block, last = self.block, self.block.first + len(self.block.seeds) - 1
        what = self.kind if self.explainer is None else f"{self.kind} by {self.explainer}"
        return f"{block.world.card.name}, {what}, episodes {block.first}-{last}"


@dataclass(frozen=True)
class Needs:
    """The pieces that a request's entry is made of, in the order of its episodes, for one cell."""

    world: World
    episodes: tuple[Piece, ...]
    mute: tuple[Piece, ...]  # the same without messages between agents
    shared: tuple[Piece, ...]
    explained: tuple[Piece, ...]
    behaviour: tuple[Piece, ...]  # none where it is not asked for
    random_behaviour: tuple[Piece, ...]  # of messages chosen at random: the floor

    def __iter__(self) -> Iterator[Piece]:
        yield from self.episodes
        yield from self.mute
        yield from self.shared
        yield from self.explained
        yield from self.behaviour
        yield from self.random_behaviour


def needs(request: Request, cell: Cell, keys: Keys) -> Needs:
    world, sampling, n_played = World.of(request, cell, keys), request.sampling, request.behaviours(cell)
    name, its_key = request.explainer.name, keys.explainer(request.explainer)

    def played(kind: Kind) -> tuple[Piece, ...]:
        return tuple(
            Piece(kind, block, None, None, piece_key(kind, *block.key()))
            for block in blocks(world, sampling.seeds, BLOCK)
        )

    episodes = played("episodes")
    acted = tuple(blocks(world, sampling.seeds[:n_played], BEHAVIOUR_BLOCK))

    def explained(kind: Kind, by: str | None, *keys: str) -> tuple[Piece, ...]:
        t = sampling.timesteps
        return tuple(
            Piece(kind, of.block, t, by, piece_key(kind, *of.block.key(), t, *keys), of) for of in episodes
        )

    def behaviour(by: str | None, *keys: str) -> tuple[Piece, ...]:
        return tuple(
            Piece("behaviour", block, None, by, piece_key("behaviour", *block.key(), *keys))
            for block in acted
        )

    return Needs(
        world,
        episodes,
        played("mute"),
        explained("shared", None, f"initial seed {request.card.initial_seed}"),
        explained("explained", name, its_key),
        behaviour(name, its_key),
        behaviour(None),
    )


def blocks(world: World, seeds: list[int], size: int) -> Iterator[Block]:
    for first in range(0, len(seeds), size):
        yield Block(world, first, tuple(seeds[first : first + size]))


@dataclass(frozen=True)
class Plan:
    """A request, and the pieces that it needs cell by cell."""

    request: Request
    needs: tuple[Needs, ...]

    @classmethod
    def of(cls, request: Request, keys: Keys) -> Plan:
        return cls(request, tuple(needs(request, cell, keys) for cell in request.cells))

    def __iter__(self) -> Iterator[Piece]:
        for each in self.needs:
            yield from each

    @property
    def piece_keys(self) -> list[str]:
        return [piece.key for piece in self]
