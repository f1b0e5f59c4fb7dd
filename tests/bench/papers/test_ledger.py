"""Statements are judged by the rules: on hand-made numbers, at the limits, and with sides exchanged."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from tests.helpers.made_samples import made_samples
from xmarl_bench.metrics.student import student_interval, student_p
from xmarl_bench.papers.kailas2025.claims import (
    ATTENTION,
    GNN,
    Cell,
    Claim,
    Combine,
    Contrast,
    Quantifier,
    Side,
    Term,
    beats,
    improves,
    improves_more,
    keeps,
    unmoved,
)
from xmarl_bench.papers.kailas2025.ledger import Compared, Judge, Verdict, combine, compare, decide, quantify
from xmarl_bench.papers.kailas2025.samples import Place, Run, Samples, Scored

CELLS = tuple(Cell("blind_navigation_v0", n) for n in (3, 4, 5))
H, N, U, X = Verdict.HELD, Verdict.NOT_HELD, Verdict.NOT_DECIDED, Verdict.NOT_MEASURED
EVERY, MOST, MIXED = Quantifier.EVERY, Quantifier.MOST, Quantifier.MIXED
OPPOSITE = {H: N, N: H, U: U, X: X}


@pytest.mark.parametrize(
    ("verdicts", "quantifier", "expected"),
    [
        ([H, H, H], EVERY, H), ([H, H, U], EVERY, U), ([H, H, N], EVERY, N), ([H, X, X], EVERY, H),
        ([H, H, N], MOST, H), ([H, U, U], MOST, U), ([H, N, N], MOST, N), ([H, N], MOST, N),
        ([H, H, X, X, X], MOST, H), ([U, U, N], MOST, U),
        ([H, N, U], MIXED, H), ([H, H, H], MIXED, N), ([N, N], MIXED, N), ([H, U, U], MIXED, U),
        ([H, X, X], MIXED, U), ([N, X], MIXED, U),
        ([X, X], EVERY, X), ([X, X], MOST, X), ([X, X], MIXED, X),
    ],
)  # fmt: skip
def test_quantifiers_over_cells(verdicts: list[Verdict], quantifier: Quantifier, expected: Verdict) -> None:
    assert quantify(verdicts, quantifier) is expected


@pytest.mark.parametrize(
    ("verdicts", "how", "expected"),
    [
        ([H, H], Combine.ALL, H), ([H, U], Combine.ALL, U), ([U, N], Combine.ALL, N),
        ([H, N], Combine.ANY, H), ([U, N], Combine.ANY, U), ([N, N], Combine.ANY, N),
        ([H, X], Combine.ALL, X), ([H, X], Combine.ANY, X),
    ],
)  # fmt: skip
def test_contrasts_of_a_cell_are_combined(verdicts: list[Verdict], how: Combine, expected: Verdict) -> None:
    assert combine(verdicts, how) is expected


def compared(low: float, high: float, effect: float = 0.5) -> Compared:
    middle = (low + high) / 2
    return Compared(3, 150, 0, middle, 0.0, middle, (low, high), 0.001, effect)


BETTER = beats(ATTENTION, GNN, "fid_delta")
SAME, NO_WORSE = unmoved(ATTENTION, "fid_delta", 0.1), keeps("success_rate", 0.1)


@pytest.mark.parametrize(
    ("contrast", "low", "high", "effect", "p", "expected"),
    [
        (BETTER, 0.1, 0.2, 0.5, 0.01, H), (BETTER, -0.2, -0.1, -0.5, 0.01, N),
        (BETTER, 0.1, 0.2, 0.5, 0.06, U), (BETTER, -0.2, 0.1, -0.5, 0.06, U),
        (SAME, -0.05, 0.1, 0.0, 1.0, H), (SAME, -0.05, 0.11, 0.0, 1.0, U), (SAME, 0.11, 0.2, 0.9, 0.0, N),
        (SAME, -0.3, -0.11, 0.9, 0.0, N),
        (NO_WORSE, -0.1, 0.5, 0.0, 1.0, H), (NO_WORSE, -0.2, 0.5, 0.0, 1.0, U),
        (NO_WORSE, -0.3, -0.2, 0.0, 1.0, N),
    ],
)  # fmt: skip
def test_a_contrast_is_judged_by_interval_and_margin(
    contrast: Contrast, low: float, high: float, effect: float, p: float, expected: Verdict
) -> None:
    """Here p is also that of a difference beyond the margin."""
    beyond = 0.01 if expected is N else 0.5
    assert decide(contrast, compared(low, high, effect), p, beyond) is expected
    if contrast.margin and expected is N:
        assert decide(contrast, compared(low, high, effect), p, 0.06) is U


def test_without_an_interval_nothing_is_decided_and_without_a_value_nothing_measured() -> None:
    assert decide(BETTER, Compared(1, 1, 0, 1.0, 0.0, 1.0, None, 0.0, 1.0), 0.0) is U
    assert decide(BETTER, Compared(0, 0, 0, None, None, None, None, None, None), None) is X


def test_numbers_by_hand() -> None:
    """Lower is better, so the difference is positive if a is smaller; means are over policies' means."""
    a, b = [np.array([1.0, 3.0]), np.array([5.0])], [np.array([2.0, 6.0]), np.array([5.5])]
    made = compare(a, b, -1)
    assert (made.n_policies, made.n_episodes, made.n_nan) == (2, 3, 0)
    assert (made.a, made.b) == (3.5, 4.75)
    assert made.difference == pytest.approx((2.0 + 0.5) / 2)
    assert made.p == pytest.approx(stats.ttest_1samp([2.0, 0.5], 0.0).pvalue)
    # Of 9 pairs of episodes a is smaller in all but 3 > 2 and 5 > 2.
    assert made.effect == pytest.approx((7 - 2) / 9)


def claim(*contrasts: Contrast, quantifier: Quantifier = EVERY, cells: tuple[Cell, ...] = CELLS) -> Claim:
    return Claim("x", "1", "here", "text", cells, contrasts, quantifier)


def test_a_difference_is_held_and_no_difference_is_undecided() -> None:
    """Attention is 0.3 above GNNExplainer with the term, equal without it; for gef lower is better."""

    def level(cell: Cell, explainer: str, regularised: bool, metric: str) -> float:
        return 0.3 * (explainer == ATTENTION and regularised)

    judge = Judge(made_samples(CELLS, (ATTENTION, GNN), level))
    above = judge.judge(claim(beats(ATTENTION, GNN, "fid_delta", regularised=True)))
    assert above.verdict is H
    assert above.overall[0].compared.difference == pytest.approx(0.3, abs=0.01)
    assert above.overall[0].compared.n_policies == 9
    assert judge.judge(claim(beats(ATTENTION, GNN, "gef", regularised=True))).verdict is N
    assert judge.judge(claim(beats(ATTENTION, GNN, "fid_delta", regularised=False))).verdict is U
    assert judge.judge(claim(improves(ATTENTION, "fid_delta"))).verdict is H
    assert judge.judge(claim(improves_more(ATTENTION, GNN, "fid_delta"))).verdict is H
    assert judge.judge(claim(improves_more(GNN, ATTENTION, "fid_delta"))).verdict is N
    assert judge.judge(claim(unmoved(GNN, "fid_delta"))).verdict is H
    assert judge.judge(claim(unmoved(ATTENTION, "fid_delta"))).verdict is N
    assert judge.judge(claim(keeps("success_rate", 0.05))).verdict is H
    assert judge.judge(claim(keeps("makespan", 0.05))).verdict is N
    mixed = claim(improves(ATTENTION, "fid_delta"), quantifier=MIXED)
    assert judge.judge(mixed).verdict is N


def test_bonferroni_is_over_the_tests_of_a_statement() -> None:
    judge = Judge(made_samples(CELLS, (ATTENTION, GNN), lambda *_: 0.0))
    alone = judge.judge(claim(beats(ATTENTION, GNN, "fid_delta"), cells=CELLS[:1])).cells[0].contrasts[0]
    together = judge.judge(claim(beats(ATTENTION, GNN, "fid_delta"))).cells[0].contrasts[0]
    assert alone.compared.p is not None
    assert alone.p_adjusted == alone.compared.p
    assert together.compared.p is not None
    assert together.p_adjusted == min(1.0, 3 * together.compared.p)


def test_the_p_beyond_a_margin_is_of_the_t_test_against_it() -> None:
    a, b = [np.array([-0.3]), np.array([-0.5]), np.array([-0.45])], [np.zeros(1)] * 3
    expected = stats.ttest_1samp([-0.3, -0.5, -0.45], -0.1).pvalue
    assert compare(a, b, 1, 0.1).p_beyond == pytest.approx(expected)
    assert compare(a, b, -1, 0.1).p_beyond == pytest.approx(expected)  # of the nearer margin
    assert compare(a, b, 1, 0.6).p_beyond == 1.0
    assert compare(a, b, 1).p_beyond is None
    assert compare(a[:1], b[:1], 1, 0.1).p_beyond is None


def verdicts(contrast: Contrast, difference: np.ndarray, cells: int) -> list[list[Verdict]]:
    """(statements * cells, runs) differences of means -> verdicts of the cells of each statement."""
    margin, (low, high), p = contrast.margin, student_interval(difference), student_p(difference)
    mean = difference.mean(axis=-1)
    beyond = np.where(np.abs(mean) <= margin, 1.0, student_p(difference - np.copysign(margin, mean)[:, None]))
    each = [
        decide(
            contrast,
            Compared(3, 150, 0, m, 0.0, m, (lo, hi), None, None),
            min(1.0, cells * one),
            min(1.0, cells * other),
        )
        for m, lo, hi, one, other in zip(mean, low, high, p, beyond, strict=True)
    ]
    return [each[k : k + cells] for k in range(0, len(each), cells)]


@pytest.mark.slow
@pytest.mark.parametrize("quantifier", [EVERY, MOST])
@pytest.mark.parametrize("n_runs", [3, 5])
@pytest.mark.parametrize("spread", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("contrast", [BETTER, NO_WORSE, SAME], ids=lambda contrast: contrast.relation.value)
def test_verdicts_have_their_nominal_error_rate(
    contrast: Contrast, spread: float, n_runs: int, quantifier: Quantifier
) -> None:
    """At most one statement in twenty is held, or not held, on nine cells whose difference is at the limit.

    The limit is 0 or the margin, where neither verdict is right; runs have 50 skewed episodes.
    """
    rng = np.random.default_rng([n_runs, int(10 * spread)])
    runs = spread * rng.normal(size=(9 * 800, n_runs, 1))
    difference = (runs + rng.exponential(size=(9 * 800, n_runs, 50)) - 1.0).mean(axis=-1) - contrast.margin
    found = [quantify(each, quantifier) for each in verdicts(contrast, difference, 9)]
    for verdict in (H, N):
        assert np.mean([each is verdict for each in found]) <= 0.05


def test_undecided_cells_decide_no_statement() -> None:
    for quantifier in (EVERY, MOST, MIXED):
        for n in range(1, 10):
            assert quantify([U] * n, quantifier) is U
            assert quantify([U] * n + [X], quantifier) is U


@pytest.mark.slow
@given(st.floats(-0.5, 0.5), st.integers(0, 3))
def test_exchanging_the_sides_reverses_the_verdict(shift: float, seed: int) -> None:
    def level(cell: Cell, explainer: str, regularised: bool, metric: str) -> float:
        return shift * (explainer == ATTENTION)

    judge = Judge(made_samples(CELLS[:1], (ATTENTION, GNN), level, episodes=10 + seed))
    one = judge.judge(claim(beats(ATTENTION, GNN, "fid_delta"), cells=CELLS[:1]))
    other = judge.judge(claim(beats(GNN, ATTENTION, "fid_delta"), cells=CELLS[:1]))
    if (
        one.verdict is not U and other.verdict is not U
    ):  # an undecided verdict may depend on the bootstrap's draws
        assert other.verdict is OPPOSITE[one.verdict]
    first, second = one.overall[0].compared, other.overall[0].compared
    assert first.difference is not None
    assert second.difference == pytest.approx(-first.difference, abs=1e-12)
    assert second.effect == pytest.approx(-(first.effect or 0.0), abs=1e-12)


def scored(name: str, *values: float) -> Scored:
    return {"fid_delta": np.array(values)}


def test_regularised_runs_are_paired_with_unregularised_ones() -> None:
    """Pairs share architecture and seed; unpaired runs are left out, several lambdas share a partner."""
    place = Place.of(CELLS[0], Term(ATTENTION))
    runs = {
        Run("a", 0.0, 0): scored("a0", 1.0, 2.0),
        Run("a", 0.1, 0): scored("a0 low", 3.0, 4.0),
        Run("a", 0.5, 0): scored("a0 high", 5.0, 6.0),
        Run("a", 0.1, 1): scored("no partner", 7.0, 8.0),
        Run("b", 0.0, 0): scored("another architecture", 9.0, 9.5),
    }
    samples = Samples({(place, ATTENTION): runs})
    a, b, _ = samples.blocks(CELLS[0], improves(ATTENTION, "fid_delta"))
    assert [x.tolist() for x in a] == [[3.0, 4.0], [5.0, 6.0]]
    assert [x.tolist() for x in b] == [[1.0, 2.0], [1.0, 2.0]]


def test_a_control_is_one_value_per_policy() -> None:
    place, run = Place.of(CELLS[0], Term(ATTENTION)), Run("a", 0.0, 0)
    samples = Samples(
        {
            (place, ATTENTION): {run: scored("a0", 1.0, 2.0, float("nan"))},
            (place, "oracle"): {run: scored("a0", 4.0)},
        }
    )
    a, b, _ = samples.blocks(CELLS[0], beats("oracle", ATTENTION, "fid_delta"))
    assert ([x.tolist() for x in a], [x.tolist() for x in b]) == ([[4.0]], [[1.5]])


def test_a_lead_is_a_difference_of_two_terms() -> None:
    near, far = (Cell("blind_navigation_v0", 3, more=more) for more in (1, 3))
    run = Run("a", 0.1, 0)
    samples = Samples(
        {
            (Place.of(near, Term(ATTENTION)), ATTENTION): {run: scored("near", 5.0, 6.0)},
            (Place.of(near, Term(GNN)), GNN): {run: scored("near", 1.0, 1.0)},
            (Place.of(far, Term(ATTENTION)), ATTENTION): {run: scored("far", 3.0, 3.0)},
            (Place.of(far, Term(GNN)), GNN): {run: scored("far", 2.0, 1.0)},
        }
    )
    leads = [Side(Term(ATTENTION, True, more=m), Term(GNN, True, more=m)) for m in (1, 3)]
    contrast = Contrast("fid_delta", leads[0], leads[1])
    a, b, _ = samples.blocks(Cell("blind_navigation_v0", 3, more=None), contrast)
    assert (a[0].tolist(), b[0].tolist()) == ([4.0, 5.0], [1.0, 2.0])


def test_one_training_in_teams_of_two_sizes_is_one_unit() -> None:
    cells = tuple(Cell("blind_navigation_v0", 3, more=more) for more in (1, 3))
    leads = {(0, 1): 0.4, (0, 3): 0.6, (1, 1): 0.2, (1, 3): 0.2}  # (seed, agents more)
    samples = Samples()
    for (seed, more), lead in leads.items():
        place, run = Place("blind_navigation_v0", 3, more, None), Run("a", 0.0, seed)
        for explainer, value in ((ATTENTION, lead), (GNN, 0.0)):
            samples.scored.setdefault((place, explainer), {})[run] = scored("p", value)
    found = Judge(samples).compare(beats(ATTENTION, GNN, "fid_delta"), cells)
    low, high = student_interval(np.array([0.5, 0.2]))
    assert found.n_policies == 4
    assert found.interval == pytest.approx((low, high))
