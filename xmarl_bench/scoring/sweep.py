"""Computes the pieces that the cache lacks, on however many workers, and files each result as it comes.

The parent alone reads and writes the cache: workers are handed policy and observations, and need no file
system in common. A piece that fails is recorded with its error and stops no other.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

from torch import Tensor

from xmarl_bench.entry.protocol import SANITY_EPISODES
from xmarl_bench.errors import InputError
from xmarl_bench.explain.absence import reference_states
from xmarl_bench.explain.controls import controls_of
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.explain.fitting import fitted
from xmarl_bench.parallel.fan_out import Failure, fan_out
from xmarl_bench.parallel.workers import Workers
from xmarl_bench.rollout.episodes import Episode, Rollout
from xmarl_bench.scoring.behaviour import BehaviourBlock, Played
from xmarl_bench.scoring.carried import Carried
from xmarl_bench.scoring.measure import Explained, Measured, Unit
from xmarl_bench.scoring.pieces import Piece, World
from xmarl_bench.scoring.results import PLAYED, Result, Results

Group = tuple[Piece, ...]  # of the same states, which one worker prepares once; or one block to act out
Load = tuple[Unit, ...] | BehaviourBlock | str  # a group; a text is why it cannot be had
Handed = Carried[Load]
Returned = list[Measured] | Played | InputError


def play(rollout: Carried[Rollout]) -> list[Episode]:
    """What a worker does first."""
    return rollout.load.play()


def run(handed: Handed) -> Returned:
    """What a worker does then."""
    load = handed.load
    if isinstance(load, str):
        raise InputError(load)
    if isinstance(load, BehaviourBlock):
        return load.run()
    return [unit.run() for unit in load]


@dataclass
class Sweep:
    """One run over all that is missing, by the keys of the pieces: which are to come, and why some failed."""

    results: Results
    explainers: dict[str, Explainer]  # by name
    workers: Workers
    parallel_episodes: int
    progress: bool
    proven: set[str] = field(default_factory=set)  # explainers that have worked before
    unsettled: set[str] = field(default_factory=set)
    errors: dict[str, str] = field(default_factory=dict)
    _ready: dict[tuple[World, str], Explainer] = field(default_factory=dict)  # fitted to the world's policy
    _references: dict[World, Tensor | None] = field(default_factory=dict)
    _known_controls: dict[World, tuple[Explainer, ...]] = field(default_factory=dict)

    def compute(self, pieces: Iterable[Piece]) -> Iterator[Piece]:
        """Each missing piece once, when it is settled: filed, or one of `errors`.

        Raises InputError before anything is explained where an explainer works on no policy at all, and
        where the cache cannot be written.
        """
        missing = dict[str, Piece]()
        for piece in pieces:
            if piece.key in missing:
                continue
            if not self.results.has(piece):
                missing[piece.key] = piece
            elif piece.explainer is not None:
                self.proven.add(piece.explainer)
        self.unsettled.update(missing)
        return self._compute(missing)

    def _compute(self, missing: dict[str, Piece]) -> Iterator[Piece]:
        yield from self._play([piece for piece in missing.values() if piece.kind in PLAYED])
        rest = [piece for piece in missing.values() if piece.kind not in PLAYED]
        for piece in rest:
            if piece.source is not None and piece.source.key in self.errors:
                yield self._settle(piece, InputError(self.errors[piece.source.key]))
        rest = [piece for piece in rest if piece.key not in self.errors]
        yield from self._make_ready(rest)
        groups: dict[object, list[Piece]] = {}
        for piece in rest:
            if piece.key not in self.errors:
                states = piece.key if piece.source is None else (piece.source.key, piece.timesteps)
                groups.setdefault(states, []).append(piece)
        yield from self._explain([tuple(group) for group in groups.values()])

    def _play(self, pieces: Sequence[Piece]) -> Iterator[Piece]:
        units = (self._rollout(piece) for piece in pieces)
        title = "roll out" if self.progress else None
        for k, episodes in fan_out(play, units, workers=self.workers, total=len(pieces), progress=title):
            yield self._settle(pieces[k], episodes)

    def _rollout(self, piece: Piece) -> Carried[Rollout]:
        world = piece.block.world
        rollout = Rollout(
            world.policy,
            world.cell.task,
            world.cell.n_agents,
            piece.block.seeds,
            world.max_cycles,
            messages=piece.kind == "episodes",
            parallel_episodes=self.parallel_episodes,
        )
        return Carried(rollout, world.policy)

    def _make_ready(self, pieces: Sequence[Piece]) -> Iterator[Piece]:
        """Fit explainers that learn to the policies, and try each on one timestep, until it works on one."""
        worlds: dict[str, dict[World, list[Piece]]] = {}
        for piece in pieces:
            if piece.explainer is not None:
                worlds.setdefault(piece.explainer, {}).setdefault(piece.block.world, []).append(piece)
        for name, its_worlds in worlds.items():
            works, reasons = name in self.proven, []
            for world, its_pieces in its_worlds.items():
                try:
                    self._fit(name, world)
                    works = works or self._try(name, world, its_pieces)
                except InputError as error:
                    reasons.append(error)
                    for piece in its_pieces:
                        self.errors[piece.key] = str(error)
            if reasons and not works:
                raise reasons[0]
            for its_pieces in its_worlds.values():
                for piece in its_pieces:
                    if piece.key in self.errors:
                        yield self._settle(piece, InputError(self.errors[piece.key]))

    def _fit(self, name: str, world: World) -> None:
        cell = world.cell
        self._ready[world, name] = fitted(
            self.explainers[name], world.policy, cell.task, cell.n_agents, world.seed
        )

    def _try(self, name: str, world: World, pieces: Sequence[Piece]) -> bool:
        """Whether it was tried: acting out needs no states that it could be tried on. Raises InputError."""
        piece = next((each for each in pieces if each.source is not None), None)
        if piece is None:
            return False
        unit, *_ = self._units((piece,))
        (result,) = replace(unit, timesteps=1, sanity=False).run().explained.values()
        if isinstance(result, InputError):
            raise result
        return True

    def _explain(self, groups: Sequence[Group]) -> Iterator[Piece]:
        """Where a whole group fails its pieces are computed one by one, so that blame is exact."""
        again: list[Group] = []
        units = (self._hand(group) for group in groups)
        title = "explain" if self.progress else None
        for k, result in fan_out(run, units, workers=self.workers, total=len(groups), progress=title):
            group = groups[k]
            if isinstance(result, Failure) and len(group) > 1:
                again += [(piece,) for piece in group]
                continue
            for piece in group:
                yield self._settle(piece, result if isinstance(result, Failure) else _value(piece, result))
        if again:
            yield from self._explain(again)

    def _hand(self, group: Group) -> Handed:
        """Never raises: it is called wherever the next unit is wanted, not where a unit fails."""
        piece = group[0]
        load: Load
        try:
            load = self._acting(piece) if piece.source is None else self._units(group)
        except InputError as error:
            load = str(error)
        return Carried(load, piece.block.world.policy)

    def _units(self, group: Group) -> tuple[Unit, ...]:
        piece = group[0]
        world, source = piece.block.world, piece.source
        assert source is not None
        names = [each.explainer for each in group if each.explainer is not None]
        return tuple(
            Unit(
                world.policy,
                tuple(self._ready[world, name] for name in names),
                episode,
                world.seed,
                piece.timesteps,
                sanity=k < SANITY_EPISODES,
                reference=self._reference(world),
                controls=self._controls(world),
                shared=any(each.kind == "shared" for each in group),
            )
            for k, episode in enumerate(self.results.episodes(source), start=piece.block.first)
        )

    def _reference(self, world: World) -> Tensor | None:
        if world not in self._references:
            cell = world.cell
            self._references[world] = reference_states(world.policy, cell.task, cell.n_agents)
        return self._references[world]

    def _controls(self, world: World) -> tuple[Explainer, ...]:
        if world not in self._known_controls:
            self._known_controls[world] = controls_of(world.cell.task, world.card)
        return self._known_controls[world]

    def _acting(self, piece: Piece) -> BehaviourBlock:
        world, name = piece.block.world, piece.explainer
        explainer = None if name is None else self._ready[world, name]
        return BehaviourBlock(
            world.policy, explainer, world.cell.task, world.cell.n_agents, piece.block.seeds, world.seed,
            world.max_cycles,
        )  # fmt: skip

    def _settle(self, piece: Piece, result: object) -> Piece:
        """File what was computed, or why it was not."""
        self.unsettled.discard(piece.key)
        if isinstance(result, Failure):
            self.errors[piece.key] = result.error
            self.results.cache.fail(piece.key, f"{result.error}\n{result.traceback or ''}")
        elif isinstance(result, InputError):
            self.errors[piece.key] = str(result)
            self.results.cache.fail(piece.key, str(result))
        else:
            self.results.write(piece, result)  # type: ignore[arg-type]
        return piece


def _value(piece: Piece, returned: Returned) -> Result | InputError:
    """The result of one piece out of what a worker returned."""
    if isinstance(returned, InputError | Played):
        return returned
    if piece.explainer is None:
        return [each.shared for each in returned if each.shared is not None]
    explained = [each.explained[piece.explainer] for each in returned]
    wrong = [each for each in explained if isinstance(each, InputError)]
    return wrong[0] if wrong else [each for each in explained if isinstance(each, Explained)]
