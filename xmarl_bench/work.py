"""The work that requests ask for: each piece once, however many entries use it, in the order of need.

Explainers on the same states are explained and measured together, for they share F(1), the oracle and the
controls. No score depends on what it is computed together with.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from xmarl_bench.behaviour import BehaviourBlock, Played, blocks
from xmarl_bench.errors import InputError
from xmarl_bench.explainer import Explainer
from xmarl_bench.fitting import fitted
from xmarl_bench.measure import Measured, Unit
from xmarl_bench.policy import Policy
from xmarl_bench.protocol import SANITY_EPISODES
from xmarl_bench.request import Cell, Request
from xmarl_bench.rollout import Episode, Rollout, play_all


@dataclass(frozen=True)
class World:
    """What an episode depends on beside its number; all explainers of a policy share its episodes."""

    policy: Policy
    cell: Cell
    seed: int
    max_cycles: int | None


@dataclass(frozen=True)
class States:
    """The states explained, of each episode of a world."""

    world: World
    timesteps: int | None


@dataclass(frozen=True)
class Behaviours:
    """The explainer on whose masks the team of a world acts."""

    world: World
    explainer: str | None  # None: messages chosen at random


Key = States | Behaviours
Piece = Unit | BehaviourBlock
Result = Measured | Played | InputError
Users = Mapping[str | None, tuple[Explainer | None, int]]  # by explainer's name: on how many episodes
Wanted = dict[Key, dict[str | None, tuple[Explainer | None, int]]]
Episodes = Mapping[World, Sequence[Episode]]


def world_of(request: Request, cell: Cell) -> World:
    return World(request.policy, cell, request.sampling.seed, request.sampling.max_cycles)


def needs(request: Request, cell: Cell) -> list[tuple[Key, Explainer | None, int]]:
    """What an entry is made of: work, by which explainer, on how many episodes."""
    world, explainer = world_of(request, cell), request.explainer.explainer
    needed: list[tuple[Key, Explainer | None, int]] = [
        (States(world, request.sampling.timesteps), explainer, request.sampling.episodes)
    ]
    n_behaviours = request.behaviours(cell)
    if n_behaviours:
        needed.append((Behaviours(world, explainer.name), explainer, n_behaviours))
        needed.append((Behaviours(world, None), None, n_behaviours))
    return needed


def wanted(requests: Sequence[Request]) -> Wanted:
    """All work of a run. Raises InputError where two explainers share a name: entries are filed by it."""
    merged: Wanted = {}
    for request in requests:
        for cell in request.cells:
            for key, explainer, n_episodes in needs(request, cell):
                explainers = merged.setdefault(key, {})
                name = None if explainer is None else explainer.name
                known, most = explainers.get(name, (explainer, 0))
                if known != explainer:
                    raise InputError(f"two explainers are named {name!r}: rename one.")
                explainers[name] = explainer, max(n_episodes, most)
    return merged


def fit_explainers(work: Wanted) -> Wanted:
    """The same work by explainers that have been fitted to the policies, each to each once."""
    done: dict[tuple[World, str], Explainer] = {}
    for key, users in work.items():
        world, cell = key.world, key.world.cell
        for name, (explainer, n_episodes) in users.items():
            if explainer is None or explainer.fit is None:
                continue
            if (world, explainer.name) not in done:
                done[world, explainer.name] = fitted(
                    explainer, world.policy, cell.task, cell.n_agents, world.seed
                )
            users[name] = done[world, explainer.name], n_episodes
    return work


def roll_out_worlds(
    requests: Sequence[Request], *, jobs: int, parallel_episodes: int, progress: str | None
) -> dict[World, list[Episode]]:
    """The episodes that all requests together need, each played once."""
    seeds: dict[World, list[int]] = {}
    for request in requests:
        for cell in request.cells:
            known = seeds.setdefault(world_of(request, cell), [])
            known += request.sampling.seeds[len(known) :]
    rollouts = [
        Rollout(world.policy, world.cell.task, world.cell.n_agents, tuple(each), world.max_cycles)
        for world, each in seeds.items()
    ]
    played = play_all(rollouts, jobs=jobs, parallel_episodes=parallel_episodes, progress=progress)
    return dict(zip(seeds, played, strict=True))


def pieces(key: Key, users: Users, episodes: Episodes) -> Iterator[Piece]:
    """The pieces of one key, by episode: what workers are handed."""
    world = key.world
    n_episodes = max(n for _, n in users.values())
    if isinstance(key, Behaviours):
        explainer, _ = users[key.explainer]
        seeds = [episode.seed for episode in episodes[world][:n_episodes]]
        cell = world.cell
        yield from blocks(
            world.policy, explainer, cell.task, cell.n_agents, seeds, world.seed, world.max_cycles
        )
        return
    for k, episode in enumerate(episodes[world][:n_episodes]):
        explainers = tuple(each for each, n in users.values() if each is not None and k < n)
        sanity = k < SANITY_EPISODES
        yield Unit(world.policy, explainers, episode, world.seed, key.timesteps, sanity)


def check_explainers(work: Wanted, episodes: Episodes) -> None:
    """Try every explainer on one timestep of every policy. Raises the first error, before much is done."""
    for key, users in work.items():
        if isinstance(key, States):
            first, *_ = pieces(key, users, episodes)
            assert isinstance(first, Unit)
            for result in replace(first, timesteps=1, sanity=False).run().explained.values():
                if isinstance(result, InputError):
                    raise result


def run(piece: Piece) -> Result:
    return piece.run()
