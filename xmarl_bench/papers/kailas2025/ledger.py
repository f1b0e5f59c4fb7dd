"""Judges statements on samples: held, not held or not decided, with the numbers.

The training is the unit: its checkpoints, its teams of several sizes, and its runs with and without the term
are not independent, and count as one. A contrast holds by the paired t-test over trainings, p under 0.05
after Bonferroni over the tests of the statement. "The same" and "no worse" hold if Student's interval of the
mean difference is within the margin. They are refuted by the same test of a difference beyond the margin,
also after Bonferroni: without it, chance puts one of nine cells beyond the margin in one of five statements.
Differences are positive in the direction of the statement. The paper's own test, Mann-Whitney U of the
pooled episodes of all runs, treats episodes of one run as independent runs, so it decides nothing here; only
its effect size is reported.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import chain

import numpy as np

from xmarl_bench.metrics.statistics import bonferroni, over_runs, rank_biserial
from xmarl_bench.metrics.student import Design, mean_of
from xmarl_bench.papers.kailas2025.claims import (
    ORIENTATION,
    Cell,
    Claim,
    Combine,
    Contrast,
    Quantifier,
    Relation,
)
from xmarl_bench.papers.kailas2025.samples import Blocks, Paired, Samples

ALPHA = 0.05


class Verdict(StrEnum):
    HELD = "held"
    NOT_HELD = "not held"
    NOT_DECIDED = "not decided"
    NOT_MEASURED = "not measured"


@dataclass(frozen=True)
class Compared:
    """Both sides of a contrast on some policies. Differences and effect are positive as claimed."""

    n_policies: int  # or pairs of policies
    n_episodes: int
    n_nan: int
    a: float | None  # mean over trainings of the mean over episodes
    b: float | None
    difference: float | None
    interval: tuple[float, float] | None
    p: float | None  # of the paired t-test over runs
    effect: float | None  # rank-biserial correlation of the episodes, in [-1, 1]
    p_beyond: float | None = None  # of the same test of a difference beyond the margin; 1 if it is within


@dataclass(frozen=True)
class JudgedContrast:
    contrast: Contrast
    compared: Compared
    p_adjusted: float | None
    p_beyond_adjusted: float | None
    verdict: Verdict


@dataclass(frozen=True)
class JudgedCell:
    cell: Cell
    contrasts: tuple[JudgedContrast, ...]
    verdict: Verdict


@dataclass(frozen=True)
class Judged:
    """A statement, judged."""

    claim: Claim
    cells: tuple[JudgedCell, ...]
    overall: tuple[JudgedContrast, ...]  # of each contrast, the policies of all cells together
    verdict: Verdict

    def count(self, verdict: Verdict) -> int:
        return sum(cell.verdict is verdict for cell in self.cells)


@dataclass
class Judge:
    """Judges claims on the same samples. A comparison that several claims need is computed once."""

    samples: Samples
    known: dict[tuple[Contrast, tuple[Cell, ...]], Compared] = field(default_factory=dict)

    def judge(self, claim: Claim) -> Judged:
        compared = [[self.compare(each, (cell,)) for each in claim.contrasts] for cell in claim.cells]
        n = len(claim.contrasts)
        family = _judged(claim.contrasts * len(compared), [each for row in compared for each in row])
        cells = []
        for k, cell in enumerate(claim.cells):
            judged = family[k * n : (k + 1) * n]
            cells.append(JudgedCell(cell, judged, combine([each.verdict for each in judged], claim.combine)))
        everywhere = [self.compare(each, claim.cells) for each in claim.contrasts]
        overall = _judged(claim.contrasts, everywhere)
        if claim.quantifier is Quantifier.TOGETHER:
            verdict = combine([each.verdict for each in overall], claim.combine)
        else:
            verdict = quantify([cell.verdict for cell in cells], claim.quantifier)
        return Judged(claim, tuple(cells), overall, verdict)

    def compare(self, contrast: Contrast, cells: tuple[Cell, ...]) -> Compared:
        key = contrast, cells
        if key not in self.known:
            parts = [self.samples.blocks(cell, contrast) for cell in cells]
            pairs = Paired(*(list(chain(*each)) for each in zip(*parts, strict=True)))
            self.known[key] = compare(
                pairs.a,
                pairs.b,
                ORIENTATION[contrast.metric],
                contrast.margin,
                pairs.design,
            )
        return self.known[key]


def compare(
    a: Blocks, b: Blocks, orientation: int, margin: float = 0.0, design: Design | None = None
) -> Compared:
    """Compare two lists of (E,) arrays, one pair per policy. orientation: -1 if lower is better."""
    oriented = [orientation * x for x in a], [orientation * x for x in b]
    difference = over_runs(*oriented, design=design)
    beyond = None
    if margin and difference.value is not None:
        nearer = math.copysign(margin, difference.value)
        beyond = over_runs([x - nearer for x in oriented[0]], oriented[1], design=design).p
        beyond = 1.0 if abs(difference.value) <= margin and beyond is not None else beyond
    effect = rank_biserial(np.concatenate(a), np.concatenate(b)) if a else None
    measured = [
        k
        for k, (x, y) in enumerate(zip(a, b, strict=True))
        if not np.isnan(x).all() and not np.isnan(y).all()
    ]
    kept = None if design is None else design.of(measured)

    def mean(side: Blocks) -> float | None:
        means = np.array([np.nanmean(side[k]) for k in measured])
        return float(mean_of(means, kept)) if measured else None

    return Compared(
        n_policies=len(measured),
        n_episodes=difference.n,
        n_nan=difference.n_nan,
        a=mean(a),
        b=mean(b),
        difference=difference.value,
        interval=difference.interval,
        p=difference.p,
        effect=None if effect is None else orientation * effect,
        p_beyond=beyond,
    )


def decide(
    contrast: Contrast, compared: Compared, p_adjusted: float | None, p_beyond: float | None = None
) -> Verdict:
    """The verdict of a contrast; NOT_HELD: the reverse was shown. p_beyond: adjusted, for a margin."""
    if compared.difference is None:
        return Verdict.NOT_MEASURED
    if compared.interval is None:
        return Verdict.NOT_DECIDED
    low, high = compared.interval
    margin = contrast.margin
    if contrast.relation is Relation.BETTER:
        if p_adjusted is None or p_adjusted >= ALPHA:
            return Verdict.NOT_DECIDED
        return Verdict.HELD if compared.difference > 0 else Verdict.NOT_HELD
    same = contrast.relation is Relation.SAME
    if low >= -margin and (high <= margin or not same):
        return Verdict.HELD
    beyond = compared.difference < -margin or (same and compared.difference > margin)
    shown = p_beyond is not None and p_beyond < ALPHA
    return Verdict.NOT_HELD if beyond and shown else Verdict.NOT_DECIDED


def combine(verdicts: Sequence[Verdict], how: Combine) -> Verdict:
    """The verdict of a cell from those of its contrasts."""
    if Verdict.NOT_MEASURED in verdicts:
        return Verdict.NOT_MEASURED
    first, last = (Verdict.NOT_HELD, Verdict.HELD) if how is Combine.ALL else (Verdict.HELD, Verdict.NOT_HELD)
    if first in verdicts:
        return first
    return last if all(each is last for each in verdicts) else Verdict.NOT_DECIDED


def quantify(verdicts: Sequence[Verdict], quantifier: Quantifier) -> Verdict:
    """The verdict of a statement from those of its cells, see xmarl_bench.papers.kailas2025.claims."""
    n = len(verdicts) - verdicts.count(Verdict.NOT_MEASURED)
    held, reverse = verdicts.count(Verdict.HELD), verdicts.count(Verdict.NOT_HELD)
    if n == 0:
        return Verdict.NOT_MEASURED
    if quantifier is Quantifier.EVERY:
        yes, no = held == n, reverse > 0
    elif quantifier is Quantifier.MOST:
        yes, no = 2 * held > n, 2 * reverse >= n
    else:
        yes, no = held > 0 and reverse > 0, n > 1 and n in (held, reverse)
    return Verdict.HELD if yes else Verdict.NOT_HELD if no else Verdict.NOT_DECIDED


def _judged(contrasts: Sequence[Contrast], compared: Sequence[Compared]) -> tuple[JudgedContrast, ...]:
    """Judge all contrasts of a statement, which are one family of tests."""
    adjusted = _adjusted([each.p for each in compared])
    beyond = _adjusted([each.p_beyond for each in compared])
    return tuple(
        JudgedContrast(contrast, each, p, q, decide(contrast, each, p, q))
        for contrast, each, p, q in zip(contrasts, compared, adjusted, beyond, strict=True)
    )


def _adjusted(p: Sequence[float | None]) -> list[float | None]:
    """p-values after Bonferroni over the tests made."""
    values = iter(bonferroni([each for each in p if each is not None]).tolist())
    return [None if each is None else next(values) for each in p]
