"""Comparative statements as data: what is compared, in which cells, and when the statement holds.

A statement is a set of contrasts "a is better than b on a metric", judged cell by cell, with a quantifier
over cells. Quantifiers are the paper's words, the rules are ours:

- EVERY ("consistently", "across all"): held if it holds in every cell; not held if a cell shows the reverse.
- MOST ("tends to"): held if it holds in over half of the cells; not held if the reverse does in half.
- MIXED: held if at least one cell goes up and one down; not held if all are decided the same way.
- TOGETHER: judged once, on the policies of all cells; for controls, with one mean per policy in entries.

Cells that are missing or were not measured are skipped and counted.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from xmarl_bench.counted import counted
from xmarl_bench.metrics.table import METRICS, OF_POLICIES, Direction, names_of

# +1 if a higher value is better, -1 if a lower one is. The paper wants a high D(alpha) and a low attention
# entropy.
ORIENTATION: dict[str, int] = {
    metric.name: 1 if metric.direction is Direction.HIGHER else -1
    for metric in METRICS
    if metric.direction is not Direction.NONE
} | {"attention_distance": 1, "attention_entropy": -1}
OF_THE_POLICY = names_of(*OF_POLICIES)  # the same in every explainer's entry


class Quantifier(StrEnum):
    EVERY = "every cell"
    MOST = "most cells"
    MIXED = "cells both ways"
    TOGETHER = "all policies together"


class Relation(StrEnum):
    BETTER = "better"  # a above b
    NO_WORSE = "no worse"  # a not below b by more than the margin
    SAME = "same"  # a and b within the margin


class Combine(StrEnum):
    """How the contrasts of a cell combine to its verdict."""

    ALL = "all"
    ANY = "any"


@dataclass(frozen=True)
class Cell:
    """A cell of a study, in which a statement is judged. None: the terms set this field."""

    task: str
    n_trained: int
    more: int | None = 0  # agents more than in training
    percent: int | None = None  # of training; None: the finished policy
    regularised: bool | None = None

    @property
    def label(self) -> str:
        parts = [self.task.removeprefix("blind_").removesuffix("_v0"), f"N = {self.n_trained}"]
        if self.more:
            parts.append(f"tested with {self.n_trained + self.more}")
        if self.percent is not None:
            parts.append(f"{self.percent} % of training")
        if self.regularised is not None:
            parts.append("with the term" if self.regularised else "without the term")
        return ", ".join(parts)


@dataclass(frozen=True)
class Term:
    """One set of episodes: an explainer on the policies of a cell. Fields set here override the cell's."""

    explainer: str
    regularised: bool | None = None
    percent: int | None = None
    more: int | None = None


@dataclass(frozen=True)
class Side:
    """A term, or the difference of two terms: an improvement or a lead."""

    term: Term
    minus: Term | None = None

    @property
    def terms(self) -> tuple[Term, ...]:
        return (self.term,) if self.minus is None else (self.term, self.minus)


@dataclass(frozen=True)
class Contrast:
    """A relation between a and b on a metric; BETTER: a is better than b."""

    metric: str
    a: Side
    b: Side
    relation: Relation = Relation.BETTER
    margin: float = 0.0  # in units of the metric; of NO_WORSE and SAME

    @property
    def label(self) -> str:
        """What is compared; without the explainer if the metric depends on the policy only."""
        one, other = self.a, self.b
        if one.minus is not None or other.minus is not None:
            return f"{_named(one)} against {_named(other)}"
        conditions = _condition(one.term), _condition(other.term)
        if self.metric in OF_THE_POLICY:
            return " against ".join(conditions)
        names = one.term.explainer, other.term.explainer
        if names[0] == names[1]:
            return f"{names[0]}, {' against '.join(conditions)}"
        if conditions[0] == conditions[1]:
            return " against ".join(names) + (f", {conditions[0]}" if conditions[0] else "")
        return f"{_named(one)} against {_named(other)}"


def _condition(term: Term) -> str:
    parts = []
    if term.regularised is not None:
        parts.append("with the term" if term.regularised else "without the term")
    if term.percent is not None:
        parts.append(f"at {term.percent} % of training")
    if term.more is not None:
        parts.append(f"{counted(term.more, 'agent')} more")
    return ", ".join(parts)


def _named(side: Side) -> str:
    terms = [" ".join(filter(None, (term.explainer, _condition(term)))) for term in side.terms]
    return terms[0] if len(terms) == 1 else f"({' minus '.join(terms)})"


@dataclass(frozen=True)
class Claim:
    """One statement of the paper, and where it is made."""

    id: str
    lines: str  # of paper.tex
    section: str
    text: str
    cells: tuple[Cell, ...]
    contrasts: tuple[Contrast, ...]
    quantifier: Quantifier = Quantifier.MOST
    combine: Combine = Combine.ALL

    def __post_init__(self) -> None:
        for contrast in self.contrasts:
            assert contrast.metric in ORIENTATION, contrast.metric
            assert (contrast.relation is Relation.BETTER) == (contrast.margin == 0.0), self.id


@dataclass(frozen=True)
class Statements:
    """Makes the claims of a study: in all its cells, if none are given."""

    study: str
    cells: tuple[Cell, ...]

    def __call__(
        self,
        id: str,
        lines: str,
        section: str,
        text: str,
        *contrasts: Contrast,
        quantifier: Quantifier = Quantifier.MOST,
        combine: Combine = Combine.ALL,
        cells: tuple[Cell, ...] = (),
    ) -> Claim:
        name = f"{self.study}-{id}"
        return Claim(name, lines, section, text, cells or self.cells, contrasts, quantifier, combine)


# The paper's explainers by registered name: its GraphMask is torch_geometric's.
ATTENTION, GNN, GRAPHMASK = "attention", "gnn_explainer", "graphmask-pyg"
PAPER_EXPLAINERS = (ATTENTION, GNN, GRAPHMASK)
# Variants that the paper does not have: attention divided by its row maximum, tuned GNNExplainer, and
# GraphMask as its own paper describes it.
VARIANTS = {ATTENTION: "attention-rowmax", GNN: "gnn_explainer-tuned", GRAPHMASK: "graphmask"}

# 1 % of the range of an action, [-1, 1]: smaller changes do not count.
FIDELITY_MARGIN = 0.02
RATE_MARGIN = 0.05  # of a success or collision rate


def beats(better: str, worse: str, metric: str, *, regularised: bool | None = None) -> Contrast:
    """One explainer above another on the same policies."""
    return Contrast(metric, Side(Term(better, regularised)), Side(Term(worse, regularised)))


def best(explainer: str, metric: str, *, regularised: bool | None = None) -> tuple[Contrast, ...]:
    """One of the paper's explainers above the other two on the same policies."""
    others = [other for other in PAPER_EXPLAINERS if other != explainer]
    return tuple(beats(explainer, other, metric, regularised=regularised) for other in others)


def worst(explainer: str, metric: str, *, regularised: bool | None = None) -> tuple[Contrast, ...]:
    """The other two of the paper's explainers above one on the same policies."""
    others = [other for other in PAPER_EXPLAINERS if other != explainer]
    return tuple(beats(other, explainer, metric, regularised=regularised) for other in others)


def improves(explainer: str, metric: str) -> Contrast:
    """The explainer on regularised policies above itself on unregularised ones."""
    return Contrast(metric, Side(Term(explainer, True)), Side(Term(explainer, False)))


def worsens(explainer: str, metric: str) -> Contrast:
    return Contrast(metric, Side(Term(explainer, False)), Side(Term(explainer, True)))


def unmoved(explainer: str, metric: str, margin: float = FIDELITY_MARGIN) -> Contrast:
    """No difference between regularised and unregularised policies."""
    return Contrast(metric, Side(Term(explainer, True)), Side(Term(explainer, False)), Relation.SAME, margin)


def keeps(metric: str, margin: float, explainer: str = ATTENTION) -> Contrast:
    """The regularised policies no worse. For task metrics, any explainer's entry gives the same values."""
    return Contrast(
        metric, Side(Term(explainer, True)), Side(Term(explainer, False)), Relation.NO_WORSE, margin
    )


def improves_more(one: str, other: str, metric: str) -> Contrast:
    """The term helps one explainer by more than another."""
    return Contrast(
        metric, Side(Term(one, True), Term(one, False)), Side(Term(other, True), Term(other, False))
    )
