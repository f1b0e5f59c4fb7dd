"""Scores explainers on policies: rolls the policies out, explains and measures each episode, makes entries.

Work is fanned out by episodes. Bytes of an entry outside `provenance` and `cost` are the same for any
number of jobs and parallel episodes.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from xmarl_envs import TASKS

from xmarl_bench.entry import (
    DEFINITIONS,
    METRICS,
    CellResult,
    Cost,
    Entry,
    EpisodeRow,
    ExplainerRecord,
    Metrics,
    PolicyRecord,
    Protocol,
    Summary,
    make_entry,
)
from xmarl_bench.explainer import Explainer
from xmarl_bench.fan_out import check_parallel, fan_out
from xmarl_bench.measure import Measured, Unit, measure
from xmarl_bench.policy import GraphPolicy, PolicyCard, load_policy
from xmarl_bench.provenance import now, provenance
from xmarl_bench.registry import as_found, find_explainer, find_policy
from xmarl_bench.reproducible import derived_seed, one_thread
from xmarl_bench.request import Cell, Request, Sampling
from xmarl_bench.rollout import Episode, roll_out
from xmarl_bench.summary import summarise


def score(
    policy: str | Path | tuple[GraphPolicy, PolicyCard],
    explainer: str | Explainer,
    *,
    task: str | None = None,
    n_agents: int | None = None,
    episodes: int = 50,
    timesteps: int | None = None,
    max_cycles: int | None = None,
    seed: int = 0,
    jobs: int = 1,
    parallel_episodes: int = 50,
    progress: bool = False,
    submitter: str | None = None,
) -> Entry:
    """Score one explainer on one policy in one cell.

    Args:
        policy: a registered name, the folder of a bundle, or what `load_policy` returns.
        explainer: a registered name or an `Explainer`.
        task, n_agents: what the policy was trained for by default.
        episodes, timesteps, max_cycles, seed: which states, see `Sampling`.
        jobs: processes.
        parallel_episodes: episodes stepped side by side in a process.

    Raises InputError for anything wrong with these.
    """
    network, card = load_policy(find_policy(str(policy))) if isinstance(policy, str | Path) else policy
    found = find_explainer(explainer) if isinstance(explainer, str) else as_found(explainer)
    cell = Cell(card.task if task is None else task, card.n_agents if n_agents is None else n_agents)
    sampling = Sampling(episodes=episodes, timesteps=timesteps, max_cycles=max_cycles, seed=seed)
    request = Request(network, card, found, (cell,), sampling)
    entries = score_requests(
        [request], jobs=jobs, parallel_episodes=parallel_episodes, progress=progress, submitter=submitter
    )
    return next(iter(entries))


def score_requests(
    requests: Sequence[Request],
    *,
    jobs: int = 1,
    parallel_episodes: int = 50,
    progress: bool = False,
    submitter: str | None = None,
) -> Iterator[Entry]:
    """Yield an entry per request, in order, each as soon as it is complete.

    Every explainer is first tried on one timestep of every policy it is to explain, so that one that does
    not work is refused before anything is yielded.
    """
    check_parallel(jobs, parallel_episodes)
    started = now()
    episodes = _roll_out_all(requests, jobs, parallel_episodes, progress)
    for request in requests:
        for cell in request.cells:
            measure(_unit(request, cell, episodes[_key(request, cell)][0], timesteps=1))
    plan = [
        (request, cell, _unit(request, cell, episode, request.sampling.timesteps))
        for request in requests
        for cell in request.cells
        for episode in episodes[_key(request, cell)][: request.sampling.episodes]
    ]
    results = fan_out(
        measure, [unit for _, _, unit in plan], jobs=jobs, progress="explain" if progress else None
    )
    for request in requests:
        measured = {cell: [next(results) for _ in range(request.sampling.episodes)] for cell in request.cells}
        yield _entry(request, measured, started, jobs, submitter)


@dataclass(frozen=True)
class _Rollout:
    policy: GraphPolicy
    cell: Cell
    seeds: tuple[int, ...]
    max_cycles: int | None
    parallel_episodes: int

    def play(self) -> list[Episode]:
        with one_thread():
            return roll_out(
                self.cell.make(),
                copy.deepcopy(self.policy),  # memory as torch lays it out, see xmarl_bench.measure
                self.seeds,
                parallel_episodes=self.parallel_episodes,
                max_cycles=self.max_cycles,
            )


_Key = tuple[int, Cell, int, int | None]


def _key(request: Request, cell: Cell) -> _Key:
    """What an episode depends on beside its number; explainers of one policy share its episodes."""
    return id(request.policy), cell, request.sampling.seed, request.sampling.max_cycles


def _roll_out_all(
    requests: Sequence[Request], jobs: int, parallel_episodes: int, progress: bool
) -> dict[_Key, list[Episode]]:
    longest: dict[_Key, Request] = {}
    for request in requests:
        for cell in request.cells:
            key = _key(request, cell)
            if key not in longest or longest[key].sampling.episodes < request.sampling.episodes:
                longest[key] = request
    keys, units = [], []
    for key, request in longest.items():
        seeds = request.sampling.seeds
        chunk = min(parallel_episodes, -(-len(seeds) // jobs))
        for first in range(0, len(seeds), chunk):
            keys.append(key)
            units.append(
                _Rollout(
                    request.policy,
                    key[1],
                    tuple(seeds[first : first + chunk]),
                    request.sampling.max_cycles,
                    chunk,
                )
            )
    episodes: dict[_Key, list[Episode]] = {key: [] for key in longest}
    played = fan_out(_Rollout.play, units, jobs=jobs, progress="roll out" if progress else None)
    for key, part in zip(keys, played, strict=True):
        episodes[key] += part
    return episodes


def _unit(request: Request, cell: Cell, episode: Episode, timesteps: int | None) -> Unit:
    return Unit(
        policy=request.policy,
        explainer=request.explainer.explainer,
        episode=episode,
        seed=request.sampling.seed,
        timesteps=timesteps,
        walls=TASKS[cell.task].n_walls > 0,
    )


def _entry(
    request: Request, measured: dict[Cell, list[Measured]], started: str, jobs: int, submitter: str | None
) -> Entry:
    card, found, explainer, sampling = (
        request.card, request.explainer, request.explainer.explainer, request.sampling,
    )  # fmt: skip
    everything = [one for cell in measured.values() for one in cell]
    explained = sum(one.row.timesteps for one in everything)
    return make_entry(
        submitter=submitter,
        policy=PolicyRecord(
            name=card.name,
            task=card.task,
            n_agents=card.n_agents,
            weights_sha256=card.weights_sha256,
            architecture=card.architecture,
            attention_entropy=card.attention_entropy,
            training_seed=card.training_seed,
        ),
        explainer=ExplainerRecord(
            name=explainer.name,
            distribution=found.distribution,
            version=found.version,
            entry_point=found.entry_point,
            hyperparameters=dict(explainer.hyperparameters),
            stochastic=explainer.stochastic,
            control=explainer.control,
            seed=sampling.seed,
        ),
        protocol=Protocol(
            episodes=sampling.episodes,
            seeds=tuple(sampling.seeds),
            timesteps=sampling.timesteps,
            definitions=DEFINITIONS,
        ),
        results=tuple(_cell_result(cell, sampling, measured[cell]) for cell in request.cells),
        cost=Cost(
            explain_seconds_per_timestep=sum(one.explain_seconds for one in everything) / explained,
            explained_timesteps=explained,
        ),
        provenance=provenance(started, jobs),
    )


def _cell_result(cell: Cell, sampling: Sampling, measured: Sequence[Measured]) -> CellResult:
    rows = tuple(one.row for one in measured)
    return CellResult(
        task=cell.task,
        n_agents=cell.n_agents,
        max_cycles=sampling.max_cycles or TASKS[cell.task].default_max_cycles,
        metrics=cell_metrics(cell.task, sampling.seed, rows),
        episodes=rows,
    )


def cell_metrics(task: str, seed: int, rows: Sequence[EpisodeRow]) -> Metrics:
    """Aggregate rows; the resampling of a metric's interval depends on its name and the run's seed alone."""
    summaries: dict[str, Summary | None] = {}
    for metric in METRICS:
        if metric == "no_object_collision" and not TASKS[task].n_walls:
            summaries[metric] = None
            continue
        rng = np.random.default_rng(derived_seed("bootstrap", seed, metric))
        summaries[metric] = summarise([getattr(row, metric) for row in rows], rng)
    return Metrics.model_validate(summaries)
