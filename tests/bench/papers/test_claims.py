"""The ledgers' data: statements can be judged and have a place; the paper's numbers are correct."""

from __future__ import annotations

import re

import pytest

from xmarl_bench.entry.metric_records import EpisodeRow
from xmarl_bench.explain.controls import CONTROLS
from xmarl_bench.papers.kailas2025.beyond_claims import BEYOND_CLAIMS
from xmarl_bench.papers.kailas2025.claims import (
    ORIENTATION,
    Quantifier,
    Relation,
    beats,
    improves,
    improves_more,
    keeps,
)
from xmarl_bench.papers.kailas2025.lenses import LENSES, Lens
from xmarl_bench.papers.kailas2025.paper import MAIN, TRAINING, ZERO_SHOT, Performance, Reported
from xmarl_bench.papers.kailas2025.plan import EXPLAINERS, STUDIES
from xmarl_bench.papers.kailas2025.tables import METRIC_NAMES
from xmarl_bench.plugins.names import explainer_names

CLAIMS = [claim for study in STUDIES.values() for claim in (*study.claims, *study.beyond)]


def test_every_statement_has_a_unique_name_and_a_place() -> None:
    assert len({claim.id for claim in CLAIMS}) == len(CLAIMS)
    for claim in CLAIMS:
        if claim not in BEYOND_CLAIMS:
            assert re.fullmatch(r"[\d, -]+(, table)?", claim.lines), claim
            assert claim.section
    assert {line for claim in CLAIMS for line in re.findall(r"\d+", claim.lines)} >= {
        "285", "331", "335", "337", "339", "341", "421", "426", "430", "433", "558", "596", "599", "602",
        "645", "648", "651",
    }  # fmt: skip


def test_statements_use_only_what_a_study_measures() -> None:
    for claim in CLAIMS:
        assert claim.cells, claim.id
        for contrast in claim.contrasts:
            assert contrast.metric in {*EpisodeRow.model_fields} & {*METRIC_NAMES}, claim.id
            names = {term.explainer for side in (contrast.a, contrast.b) for term in side.terms}
            assert names <= {*EXPLAINERS, *CONTROLS}, claim.id
            if names & set(CONTROLS):  # one value per policy cannot decide a cell
                assert claim.quantifier is Quantifier.TOGETHER, claim.id


def test_the_explainers_are_registered_and_the_metrics_are_in_entries() -> None:
    assert set(EXPLAINERS) <= set(explainer_names())
    assert set(ORIENTATION) <= set(EpisodeRow.model_fields)


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: lens.name)
def test_a_lens_changes_only_explainers_and_metrics_of_some_statements(lens: Lens) -> None:
    seen = [(claim, lens.apply(claim)) for claim in CLAIMS]
    touched = [(before, after) for before, after in seen if after is not None]
    assert touched
    for before, after in touched:
        assert (after.id, after.text, after.cells) == (before.id, before.text, before.cells)
        for one, other in zip(before.contrasts, after.contrasts, strict=True):
            assert other.relation is one.relation
            assert (other.margin == 0.0) is (one.relation is Relation.BETTER)
            assert ORIENTATION[other.metric] == ORIENTATION[one.metric]


def test_cells_are_those_of_the_paper_s_figures() -> None:
    assert [len(study.cells) for study in STUDIES.values()] == [9, 4, 9]
    assert [cell.label for cell in STUDIES["zero-shot"].cells][:2] == [
        "navigation, N = 3, tested with 4",
        "navigation, N = 3, tested with 5",
    ]
    assert STUDIES["training"].cells[0].label == "navigation, N = 3, 20 % of training"


def test_the_papers_numbers() -> None:
    """Some values of its tables, typed again; success is a rate, and collisions are only where possible."""
    assert MAIN["blind_navigation_v0", 5]["makespan"] == (Reported(200.92, 116.44), Reported(175.86, 104.04))
    assert MAIN["blind_passage_v0", 3]["no_object_collision"] == (Reported(0.0, 0.0), Reported(0.06, 0.2))
    assert MAIN["blind_discovery_v0", 4]["success_rate"] == (Reported(0.99, 0.12), Reported(0.95, 0.22))
    assert TRAINING[20]["success_rate"] == (Reported(0.22, 0.41), Reported(0.75, 0.43))
    assert ZERO_SHOT[5, 8]["reward"] == (Reported(5.04, 4.22), Reported(5.82, 3.48))
    tables: list[Performance] = [*MAIN.values(), *TRAINING.values(), *ZERO_SHOT.values()]
    assert len(tables) == 9 + 3 + 9
    for table in tables:
        for pair in (table[name] for name in table if name not in ("reward", "makespan")):
            assert all(0.0 <= each.mean <= 1.0 for each in pair)
    assert all(("no_object_collision" in MAIN[key]) is (key[0] == "blind_passage_v0") for key in MAIN)
    assert all(("no_agent_collision" in MAIN[key]) is (key[0] != "blind_discovery_v0") for key in MAIN)


def test_a_lens_skips_statements_that_it_cannot_change() -> None:
    """Success and D(alpha) depend on no explainer; a wider lens does not repeat a narrower one."""
    by_name = {lens.name: lens for lens in LENSES}
    claims = {claim.id: claim for claim in CLAIMS}
    for lens in LENSES:
        assert lens.apply(claims["main-success"]) is None
        assert lens.apply(claims["main-distance"]) is None
    assert by_name["all three variants"].apply(claims["main-graphmask-fid-minus"]) is None
    assert by_name["all three variants"].apply(claims["main-graphmask-least"]) is not None
    assert by_name["variants by communication-only budgeted"].apply(claims["main-attention-gef"]) is None
    seen = by_name["corrected GraphMask"].apply(claims["main-graphmask-fid-minus"])
    assert seen is not None
    assert seen.contrasts == (improves("graphmask", "fid_minus"),)


def test_labels_name_what_differs() -> None:
    assert beats("attention", "graphmask", "gef", regularised=True).label == (
        "attention against graphmask, with the term"
    )
    assert improves("attention", "gef").label == "attention, with the term against without the term"
    assert keeps("success_rate", 0.05).label == "with the term against without the term"
    assert improves_more("a", "b", "gef").label == (
        "(a with the term minus a without the term) against (b with the term minus b without the term)"
    )
