"""The tiers that run an entry again: some episodes (spot), or everything (full).

Spot plays and explains k random episodes and compares each row, except behavioural fidelity, which depends on
all episodes together. Full scores the entry as `xmarl-bench score` does and compares every row, aggregate and
control. Metrics that are newer than the entry are not compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial

import numpy as np

from xmarl_bench.entry.aggregation import BEHAVIOUR, BEHAVIOUR_UNDER
from xmarl_bench.entry.protocol import SANITY_EPISODES
from xmarl_bench.entry.schema import CellResult, Entry, ExplainerRecord
from xmarl_bench.explain.controls import controls_of
from xmarl_bench.explain.explainer import Explainer, fitted
from xmarl_bench.explain.simulator import Simulator
from xmarl_bench.metrics.table import OPTIONAL
from xmarl_bench.policy import GraphPolicy, Policy, PolicyCard
from xmarl_bench.rollout.cell import Cell, Sampling
from xmarl_bench.rollout.episodes import Rollout
from xmarl_bench.rollout.reference_states import fit_states
from xmarl_bench.scoring.cell_result import NOT_PLAYED, episode_row
from xmarl_bench.scoring.entry_records import explainer_record
from xmarl_bench.scoring.measure import Explained, Unit
from xmarl_bench.scoring.request import Request
from xmarl_bench.scoring.score import entries_of, score_requests
from xmarl_bench.submission.consistency import lacks
from xmarl_bench.submission.recompute import Difference, differences

# Fields of an explainer's record that may differ: they tell where it was found, not what it is.
WHERE = ("seed", "code", "paper", "distribution", "version", "entry_point", "code_sha256", "isolated")


@dataclass
class Rerun:
    """Numbers of an entry and of its rerun."""

    episodes: list[list[Difference]] = field(default_factory=list)  # by episode played again
    aggregates: list[Difference] = field(default_factory=list)  # of full only
    findings: list[str] = field(default_factory=list)

    @property
    def differences(self) -> list[Difference]:
        return [each for episode in self.episodes for each in episode] + self.aggregates


def rerun(
    entry: Entry,
    policy: Policy,
    card: PolicyCard,
    explainer: Explainer,
    *,
    episodes: int | None,
    rng: np.random.Generator,
) -> Rerun:
    """Play and explain `episodes` episodes of each cell again; None: all.

    Raises InputError if policy, explainer and cells do not fit, or if the explainer fails.
    """
    requests = requests_of(entry, policy, card, explainer)
    if episodes is None:  # without a cache: everything is computed
        return compared(entry, list(entries_of(score_requests(requests))))
    result = Rerun()
    for k, (cell, request) in enumerate(zip(entry.results, requests, strict=True)):
        chosen = sorted(rng.permutation(len(cell.episodes))[:episodes].tolist())
        _spot(result, f"results.{k}", cell, request, chosen)
    return result


def requests_of(entry: Entry, policy: Policy, card: PolicyCard, explainer: Explainer) -> list[Request]:
    """What scores each cell of the entry again. Raises InputError if policy and cells do not fit."""
    protocol, requests = entry.protocol, []
    for cell in entry.results:
        sampling = Sampling(protocol.episodes, protocol.timesteps, cell.max_cycles, entry.explainer.seed)
        cells = (Cell(cell.task, cell.n_agents),)
        requests.append(Request(policy, card, explainer, cells, sampling, cell.behaviour_episodes))
    return requests


def compared(entry: Entry, again: Sequence[Entry]) -> Rerun:
    """The entry beside its new scores, one for each of `requests_of`."""
    result = Rerun()
    for k, (cell, scored) in enumerate(zip(entry.results, again, strict=True)):
        _compare(result, f"results.{k}", cell, scored.results[0])
    return result


def other_explainer(entry: Entry, explainer: Explainer) -> list[str]:
    """Findings if the explainer to run is not the entry's."""
    there, here = entry.explainer, explainer_record(explainer, 0)
    findings = [
        f"explainer.{name} is {getattr(there, name)!r}, but {getattr(here, name)!r} here."
        for name in ExplainerRecord.model_fields
        if name not in WHERE and getattr(there, name) != getattr(here, name)
    ]
    if there.code_sha256 not in (None, here.code_sha256):
        findings.append("explainer.code_sha256 disagrees with the file run here.")
    return findings


def _spot(result: Rerun, where: str, cell: CellResult, request: Request, chosen: Sequence[int]) -> None:
    sampling = request.sampling
    states = cache(partial(fit_states, request.policy, request.cells[0], sampling.max_cycles))
    explainer = fitted(request.explainer, request.policy, states, sampling.seed)
    seeds = tuple(sampling.seeds[k] for k in chosen)
    rollouts = [
        Rollout(request.policy, request.cells[0], seeds, sampling.max_cycles, messages=messages)
        for messages in (True, False)
    ]
    reference = states() if isinstance(request.policy, GraphPolicy) else None
    for k, episode, mute in zip(chosen, *(each.play() for each in rollouts), strict=True):
        sanity = k < SANITY_EPISODES
        ready = replace(explainer, simulator=Simulator(cell.task, cell.n_agents, episode.seed))
        unit = Unit(
            request.policy, (ready,), episode, sampling.seed, sampling.timesteps, sanity, reference,
            controls_of(cell.task, request.card),
        )  # fmt: skip
        measured = unit.run()
        explained = measured.explained[explainer.name]
        if not isinstance(explained, Explained):
            raise explained
        assert measured.shared is not None
        row = episode_row(request.cells[0], episode, mute, measured.shared, explained, NOT_PLAYED)
        skipped = {*BEHAVIOUR, *BEHAVIOUR_UNDER, *_newer(cell)}
        result.episodes.append(list(differences(f"{where}.episodes.{k}", cell.episodes[k], row, skipped)))


def _newer(cell: CellResult) -> set[str]:
    """Metrics that are newer than the entry."""
    return {name for name in OPTIONAL if lacks(cell, name)}


def _compare(result: Rerun, where: str, cell: CellResult, again: CellResult) -> None:
    newer = _newer(cell)
    for k, (row, other) in enumerate(zip(cell.episodes, again.episodes, strict=True)):
        result.episodes.append(list(differences(f"{where}.episodes.{k}", row, other, newer)))
    measured = cell.not_measured.keys() == again.not_measured.keys() - newer
    if not measured or cell.controls.keys() != again.controls.keys():
        result.findings.append(f"{where}: the rerun measures other metrics or controls than the entry.")
        return
    result.aggregates += differences(f"{where}.metrics", cell.metrics, again.metrics, newer)
    for name, control in cell.controls.items():
        result.aggregates += differences(f"{where}.controls.{name}", control, again.controls[name], newer)
