"""Entries as samples: per cell, explainer and training run, one value of a metric per episode.

Architecture, weight lambda of the attention-entropy term, and seed identify a training run of a cell. A
regularised run is compared with the run of the same architecture and seed without the term, episode by
episode: scoring starts all policies from the same states.
"""

from __future__ import annotations

import hashlib
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from xmarl_bench.entry.schema import Entry
from xmarl_bench.errors import InputError
from xmarl_bench.explain.control_names import INVERTED
from xmarl_bench.metrics.student import Design
from xmarl_bench.metrics.table import METRICS
from xmarl_bench.papers.kailas2025.claims import Cell, Contrast, Side, Term
from xmarl_bench.policy import PolicyCard
from xmarl_bench.records.files import canonical_json

Floats = NDArray[np.float64]
KEPT = tuple(metric.name for metric in METRICS)
Blocks = list[Floats]  # one array of episodes (E,) per training run
# One (policy, explainer) pair in one cell, by metric: (E,), NaN if it is not a number or was not measured.
Scored = dict[str, Floats]


class Paired(NamedTuple):
    """Both sides of a contrast, run by run."""

    a: Blocks
    b: Blocks
    trainings: list[Hashable]  # runs of one training share its start, or all of it

    @property
    def design(self) -> Design:
        return Design(clusters=tuple(self.trainings))


@dataclass(frozen=True, order=True)
class Run:
    """A training run of a cell."""

    architecture: str
    attention_entropy: float
    seed: int

    @property
    def unregularised(self) -> Run:
        return Run(self.architecture, 0.0, self.seed)


@dataclass(frozen=True)
class Place:
    """The task and length of a training, and the team sizes in training and test."""

    task: str
    n_trained: int
    more: int
    percent: int | None

    @classmethod
    def of(cls, cell: Cell, term: Term) -> Place:
        """The place of a term in a cell. The term's fields override the cell's."""
        more = cell.more if term.more is None else term.more
        percent = cell.percent if term.percent is None else term.percent
        return cls(cell.task, cell.n_trained, 0 if more is None else more, percent)


@dataclass
class Samples:
    """All samples of a study. Controls are stored like explainers, with one mean per policy."""

    scored: dict[tuple[Place, str], dict[Run, Scored]] = field(default_factory=dict)

    @classmethod
    def of(cls, pairs: Iterable[tuple[PolicyCard, Entry]]) -> Samples:
        """The samples of entries. Raises InputError as `check` does."""
        pairs = list(pairs)
        cls.check(card for card, _ in pairs)
        samples = cls()
        for card, entry in pairs:
            samples._add(card, entry)
        return samples

    @staticmethod
    def check(cards: Iterable[PolicyCard]) -> None:
        """Raise InputError, before anything is scored, if two policies are the same run of a cell."""
        known: dict[tuple[str, int, int | None, Run], str] = {}
        for card in cards:
            key = card.task, card.n_agents, percent_of(card), run_of(card)
            if known.setdefault(key, card.name) != card.name:
                raise InputError(
                    f"{known[key]!r} and {card.name!r} are policies of one cell, architecture, lambda and "
                    f"training seed: leave one of them out by giving the others with --policy."
                )

    def _add(self, card: PolicyCard, entry: Entry) -> None:
        (cell,) = entry.results
        place = Place(cell.task, card.n_agents, cell.n_agents - card.n_agents, percent_of(card))
        run = run_of(card)
        rows = {name: _floats([getattr(row, name) for row in cell.episodes]) for name in KEPT}
        known = self.scored.setdefault((place, entry.explainer.name), {})
        assert run not in known, card.name
        known[run] = rows
        for name, metrics in cell.controls.items():
            if name == INVERTED:
                continue
            summaries = {metric: getattr(metrics, metric, None) for metric in KEPT}
            means = {metric: _floats([each and each.value]) for metric, each in summaries.items()}
            known = self.scored.setdefault((place, name), {})
            known.setdefault(run, means)

    def of_term(self, cell: Cell, term: Term) -> dict[Run, Scored]:
        """The runs of a term in a cell, with and without the attention-entropy term."""
        return self.scored.get((Place.of(cell, term), term.explainer), {})

    def runs(self, cell: Cell, term: Term, regularised: bool | None) -> dict[Run, Scored]:
        """The runs without the term, with it, or (None) all, in order of architecture, lambda and seed."""
        every = self.of_term(cell, term)
        chosen = (run for run in every if regularised is None or (run.attention_entropy > 0) == regularised)
        return {run: every[run] for run in sorted(chosen)}

    def blocks(self, cell: Cell, contrast: Contrast) -> Paired:
        """Values of both sides, run by run: pairs of the same policy, or of partners with and without term.

        If a side is a control, of which entries keep only the mean, every policy is one value.
        """
        terms = [*contrast.a.terms, *contrast.b.terms]
        regularised = {_regularised(cell, term) for term in terms}
        partners = len(regularised) > 1
        lead = next((term for term in terms if _regularised(cell, term)), terms[0])
        found = Paired([], [], [])
        for run in self.runs(cell, lead, _regularised(cell, lead)):
            values: dict[Term, Floats] = {}
            for term in terms:
                its_run = run.unregularised if partners and not _regularised(cell, term) else run
                scored = self.of_term(cell, term).get(its_run)
                if scored is not None:
                    values[term] = scored[contrast.metric]
            if len(values) < len(set(terms)):
                continue  # one of them is missing
            if len({each.size for each in values.values()}) > 1:
                values = {term: np.array([_mean(each)]) for term, each in values.items()}
            for side, block in ((contrast.a, found.a), (contrast.b, found.b)):
                block.append(_side(side, values))
            found.trainings.append((cell.task, cell.n_trained, run.architecture, run.seed))
        return found


def pooled(runs: Mapping[Run, Scored], metric: str) -> Floats:
    """The episodes of all runs, concatenated, without those where the metric is not a number."""
    values = [each[metric] for each in runs.values()]
    x: Floats = np.concatenate(values) if values else np.array([])
    return x[~np.isnan(x)]


def percent_of(card: PolicyCard) -> int | None:
    """The share of training that a checkpoint has completed, in percent; None for a finished policy."""
    percent = card.training.get("percent")
    return None if percent is None else int(percent)


def run_of(card: PolicyCard) -> Run:
    """The training run of a policy. Raises InputError if its training seed is unknown."""
    if card.training_seed is None:
        raise InputError(
            f"the card of policy {card.name!r} has no training seed: leave it out by giving others with "
            f"--policy."
        )
    architecture = hashlib.sha256(canonical_json(card.architecture.model_dump(mode="json"))).hexdigest()
    return Run(architecture[:12], card.attention_entropy, card.training_seed)


def _regularised(cell: Cell, term: Term) -> bool | None:
    return cell.regularised if term.regularised is None else term.regularised


def _side(side: Side, values: dict[Term, Floats]) -> Floats:
    value = values[side.term]
    return value if side.minus is None else value - values[side.minus]


def _floats(values: Sequence[float | None]) -> Floats:
    """NaN for None."""
    return np.array(values, dtype=np.float64)


def _mean(values: Floats) -> float:
    numbers = values[~np.isnan(values)]
    return float(numbers.mean()) if numbers.size else float("nan")
