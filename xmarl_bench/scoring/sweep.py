"""Computes the pieces missing from the cache, on any number of workers, and writes each result as it comes.

Only the parent reads and writes the cache: workers receive policy and observations, and need no shared file
system. A piece that fails is recorded with its error and does not stop the others.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

from torch import Tensor

from xmarl_bench.entry.protocol import SANITY_EPISODES
from xmarl_bench.errors import InputError
from xmarl_bench.explain.controls import controls_of
from xmarl_bench.explain.explainer import Explainer, fitted
from xmarl_bench.explain.simulator import Simulator
from xmarl_bench.parallel.fan_out import Failure, fan_out
from xmarl_bench.parallel.workers import Workers
from xmarl_bench.policy import GraphPolicy
from xmarl_bench.rollout.episodes import Episode, Rollout
from xmarl_bench.rollout.reference_states import fit_states
from xmarl_bench.scoring.behaviour import BehaviourBlock, Played
from xmarl_bench.scoring.measure import Explained, Measured, Unit
from xmarl_bench.scoring.pieces import Environment, Piece
from xmarl_bench.scoring.policy_payload import PolicyPayload
from xmarl_bench.scoring.results import PLAYED, Result, Results

Group = tuple[Piece, ...]  # pieces on the same states, which a worker prepares once; or one behaviour piece
Work = tuple[Unit, ...] | BehaviourBlock | str  # the work of a group; a text: why it cannot be prepared
Payload = PolicyPayload[Work]
Returned = list[Measured] | Played | InputError


def play(rollout: PolicyPayload[Rollout]) -> list[Episode]:
    """On a worker: play episodes. Of a team without messages only the task metrics are read."""
    episodes = rollout.work.play()
    if rollout.work.messages:
        return episodes
    return [replace(each, observations=each.observations[:, :0]) for each in episodes]


def run(payload: Payload) -> Returned:
    """On a worker: explain and measure a group, or roll out a behaviour block."""
    work = payload.work
    if isinstance(work, str):
        raise InputError(work)
    if isinstance(work, BehaviourBlock):
        return work.run()
    return [unit.run() for unit in work]


@dataclass
class Sweep:
    """One run over all missing pieces. Tracks by key which are unsettled and why some failed."""

    results: Results
    explainers: dict[str, Explainer]  # by name
    workers: Workers
    parallel_episodes: int
    progress: bool
    proven: set[str] = field(default_factory=set)  # explainers that have worked at least once
    unsettled: set[str] = field(default_factory=set)
    errors: dict[str, str] = field(default_factory=dict)
    _ready: dict[tuple[Environment, str], Explainer] = field(default_factory=dict)  # fitted to its policy

    def __post_init__(self) -> None:
        self._fit_states, self._controls = cache(_fit_states), cache(_controls)

    def compute(self, pieces: Iterable[Piece]) -> Iterator[Piece]:
        """Yield each missing piece once it is settled: written to the cache, or in `errors`.

        Raises InputError before anything is explained if no explainer works on any policy, and if the cache
        cannot be written.
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
                groups.setdefault(self._group(piece), []).append(piece)
        yield from self._explain([tuple(group) for group in groups.values()])

    def _group(self, piece: Piece) -> object:
        """What the pieces of a group have in common: the states. A slow explainer is alone, because the
        results of a group are written together, and it takes longer than to prepare the states."""
        if piece.source is None:
            return piece.key
        alone = piece.explainer if piece.explainer and self.explainers[piece.explainer].slow else None
        return piece.block.environment, piece.source.key, piece.timesteps, alone

    def _play(self, pieces: Sequence[Piece]) -> Iterator[Piece]:
        units = (self._rollout(piece) for piece in pieces)
        title = "roll out" if self.progress else None
        for k, episodes in fan_out(play, units, workers=self.workers, total=len(pieces), progress=title):
            yield self._settle(pieces[k], episodes)

    def _rollout(self, piece: Piece) -> PolicyPayload[Rollout]:
        environment = piece.block.environment
        rollout = Rollout(
            environment.policy,
            environment.cell,
            piece.block.seeds,
            environment.max_cycles,
            messages=piece.kind == "episodes",
            parallel_episodes=self.parallel_episodes,
        )
        return PolicyPayload(rollout, environment.policy)

    def _make_ready(self, pieces: Sequence[Piece]) -> Iterator[Piece]:
        """Fit explainers that need it, and try each explainer on one timestep of policies until it works.

        An explainer that works nowhere is settled by its errors. Raises InputError if none works anywhere.
        """
        explained: dict[tuple[str, Environment], list[Piece]] = {}
        for piece in pieces:
            if piece.explainer is not None:
                explained.setdefault((piece.explainer, piece.block.environment), []).append(piece)
        reasons = list[InputError]()
        for (name, environment), its_pieces in explained.items():
            try:
                self._fit(name, environment)
                if name not in self.proven and self._try(name, environment, its_pieces):
                    self.proven.add(name)
            except InputError as error:
                reasons.append(error)
                for piece in its_pieces:
                    self.errors[piece.key] = str(error)
        if reasons and not any(name in self.proven for name, _ in explained):
            raise reasons[0]
        for piece in pieces:
            if piece.key in self.errors:
                yield self._settle(piece, InputError(self.errors[piece.key]))

    def _fit(self, name: str, environment: Environment) -> None:
        self._ready[environment, name] = fitted(
            self.explainers[name], environment.policy, lambda: self._fit_states(environment), environment.seed
        )

    def _try(self, name: str, environment: Environment, pieces: Sequence[Piece]) -> bool:
        """Whether the explainer was tried: behaviour pieces have no states for this. Raises InputError."""
        piece = next((each for each in pieces if each.source is not None), None)
        if piece is None:
            return False
        unit, *_ = self._units((piece,))
        (result,) = replace(unit, timesteps=1, sanity=False).run().explained.values()
        if isinstance(result, InputError):
            raise result
        return True

    def _explain(self, groups: Sequence[Group]) -> Iterator[Piece]:
        """If a whole group fails, its pieces are computed one by one, to find which one fails."""
        again: list[Group] = []
        units = (self._payload(group) for group in groups)
        title = "explain" if self.progress else None
        for k, result in fan_out(run, units, workers=self.workers, total=len(groups), progress=title):
            group = groups[k]
            if isinstance(result, Failure) and len(group) > 1:
                again += [(piece,) for piece in group]
                continue
            for piece in group:
                yield self._settle(piece, _value(piece, result))
        if again:
            yield from self._explain(again)

    def _payload(self, group: Group) -> Payload:
        """Never raises, because fan_out calls it when it needs the next unit: the worker raises the error."""
        piece = group[0]
        work: Work
        try:
            work = self._acting(piece) if piece.source is None else self._units(group)
        except InputError as error:
            work = str(error)
        return PolicyPayload(work, piece.block.environment.policy)

    def _units(self, group: Group) -> tuple[Unit, ...]:
        piece = group[0]
        environment, source = piece.block.environment, piece.source
        assert source is not None
        names = [each.explainer for each in group if each.explainer is not None]
        return tuple(
            Unit(
                environment.policy,
                tuple(self._in_world(name, environment, episode) for name in names),
                episode,
                environment.seed,
                piece.timesteps,
                sanity=k < SANITY_EPISODES,
                reference=self._reference(environment),
                controls=self._controls(environment),
                shared=any(each.kind == "shared" for each in group),
            )
            for k, episode in enumerate(self.results.get(source), start=piece.block.first)
        )

    def _in_world(self, name: str, environment: Environment, episode: Episode) -> Explainer:
        """The explainer, fitted to the policy, with the simulator of the episode if it simulates."""
        ready, cell = self._ready[environment, name], environment.cell
        if not ready.simulates:
            return ready
        return replace(ready, simulator=Simulator(cell.task, cell.n_agents, episode.seed))

    def _reference(self, environment: Environment) -> Tensor | None:
        """The states of `xmarl_bench.rollout.reference_states`, played once with those to fit on."""
        return self._fit_states(environment) if isinstance(environment.policy, GraphPolicy) else None

    def _acting(self, piece: Piece) -> BehaviourBlock:
        environment, name = piece.block.environment, piece.explainer
        explainer = None if name is None else self._ready[environment, name]
        return BehaviourBlock(
            environment.policy, explainer, environment.cell, piece.block.seeds, environment.seed,
            environment.max_cycles,
            self._reference(environment) if piece.kind == "absences" else None,
        )  # fmt: skip

    def _settle(self, piece: Piece, result: object) -> Piece:
        """Write the result to the cache, or record the error."""
        self.unsettled.discard(piece.key)
        if isinstance(result, Failure):
            self.errors[piece.key] = result.error
            self.results.cache.fail(piece.key, f"{result.error}\n{result.traceback or ''}")
        elif isinstance(result, InputError):
            self.errors[piece.key] = str(result)
            self.results.cache.fail(piece.key, str(result))
        else:
            self.results.write(piece, result)
        return piece


def _fit_states(environment: Environment) -> Tensor:
    """The states that explainers are fitted on."""
    return fit_states(environment.policy, environment.cell, environment.max_cycles)


def _controls(environment: Environment) -> tuple[Explainer, ...]:
    return controls_of(environment.cell.task, environment.card)


def _value(piece: Piece, returned: Returned | Failure) -> Result | InputError | Failure:
    """The result of one piece from a worker's return value."""
    if isinstance(returned, Failure | InputError | Played):
        return returned
    if piece.explainer is None:
        return [each.shared for each in returned if each.shared is not None]
    explained = [each.explained[piece.explainer] for each in returned]
    wrong = [each for each in explained if isinstance(each, InputError)]
    return wrong[0] if wrong else [each for each in explained if isinstance(each, Explained)]
