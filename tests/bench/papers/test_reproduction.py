"""docs/reproduction.md is made from its data, and its data is from the shipped policies."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import RunCli
from tests.helpers.made_samples import made_samples
from xmarl_bench.entry.protocol import PROTOCOL
from xmarl_bench.errors import InputError
from xmarl_bench.papers.kailas2025.claims import ATTENTION, GNN, Cell, Claim, Quantifier, beats
from xmarl_bench.papers.kailas2025.ledger import Judge, Verdict
from xmarl_bench.papers.kailas2025.plan import STUDIES
from xmarl_bench.papers.kailas2025.reproduction import (
    DATA,
    PAGE,
    command,
    findings_of,
    main,
    numbers,
    over_all,
    page_of,
    sentence,
    survival,
)
from xmarl_bench.papers.kailas2025.results import SCHEMA, judged_record
from xmarl_bench.plugins.names import find_policies
from xmarl_bench.policy.card import load_card

DOCS = Path(__file__).parents[3] / "docs"


def findings() -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads((DOCS / DATA).read_bytes())
    return found


def test_the_page_is_up_to_date() -> None:
    """If it fails, run the studies again, then python -m xmarl_bench.papers.kailas2025.reproduction."""
    assert (DOCS / PAGE).read_text(encoding="utf-8") == page_of(findings())


def test_the_numbers_are_of_the_shipped_policies() -> None:
    """If it fails, policies were replaced: run the studies again and make the page from them."""
    shipped = {name: load_card(folder).weights_sha256 for name, folder in find_policies().items()}
    for study in findings():
        if study["protocol"]["id"] != PROTOCOL:  # of another protocol, which the page must say
            assert "**Outdated.**" in (DOCS / PAGE).read_text(encoding="utf-8")
            continue
        for policy in study["policies"]:
            assert shipped.get(policy["name"]) == policy["weights_sha256"], policy["name"]


def test_every_statement_is_on_the_page() -> None:
    text = (DOCS / PAGE).read_text(encoding="utf-8")
    for study in findings():
        assert [claim["id"] for claim in study["ledger"]] == [
            claim.id for claim in STUDIES[study["study"]].claims
        ]
        for claim in [*study["ledger"], *study["beyond"]]:
            assert sentence(claim) in text
        assert command(study) in text


CELLS = tuple(Cell("blind_navigation_v0", n) for n in (3, 4))


def record(
    level: float, metric: str = "fid_delta", quantifier: Quantifier = Quantifier.MOST
) -> dict[str, Any]:
    """Attention `level` above GNNExplainer."""
    samples = made_samples(
        CELLS, (ATTENTION, GNN), lambda c, name, r, m: level * (name == ATTENTION), episodes=40
    )
    judge = Judge(samples)
    claim = Claim(
        "x", "7", "here", "Attention is better", CELLS, (beats(ATTENTION, GNN, metric),), quantifier
    )
    return judged_record(judge.judge(claim), cells=False)


def test_a_sentence_states_its_place_and_numbers() -> None:
    text = sentence(record(0.3))
    assert text.startswith("Attention is better (line 7; asked of most cells): of 2 cells 2 held; FidDelta, ")
    assert "attention against gnn_explainer: +0.3" in text
    assert "effect +" in text
    assert text.endswith(", p < 0.001, 12 policies.")
    assert numbers(record(0.0)).startswith("of 2 cells 2 not decided")


@pytest.mark.parametrize(("level", "said"), [(0.3, "held: FidDelta +0.3"), (-0.3, "not held: FidDelta -0.3")])
def test_all_policies_together_are_judged_too(level: float, said: str) -> None:
    text = over_all(record(level))
    assert text.startswith(said)
    assert text.endswith("], 12 policies")


def test_a_mean_over_cells_does_not_judge_mixed_results() -> None:
    claim = record(0.3, quantifier=Quantifier.MIXED)
    assert claim["verdict"] == Verdict.NOT_HELD
    assert over_all(claim).startswith("FidDelta +0.3")


@pytest.mark.parametrize(("level", "kind"), [(0.3, "held"), (-0.3, "reversed"), (0.0, "open")])
def test_survival_counts_the_lenses(level: float, kind: str) -> None:
    seen = record(level, "budgeted_fidelity")
    lenses = [{"name": "a lens", "claims": [seen]}, {"name": "another", "claims": []}]
    (survived,) = survival({"ledger": [record(0.3)], "lenses": lenses})
    assert survived["n"] == 1
    assert {each: len(survived[each]) for each in ("held", "reversed", "open")} == {
        "held": 0, "reversed": 0, "open": 0, kind: 1,
    }  # fmt: skip
    assert survival({"ledger": [record(-0.3)], "lenses": lenses}) == []


def test_a_page_is_made_from_a_folder_of_results(tmp_path: Path) -> None:
    judged = [record(0.3)]
    results = {
        "schema": SCHEMA, "study": "main", "title": "A title", "existing": False, "families": ["paper"],
        "policies": [], "missing": ["passage, N = 5"], "core_hours": 1.25,
        "protocol": {"id": PROTOCOL, "episodes": 4, "timesteps": 3, "seeds": [0, 3]}, "performance": [],
        "ledger": judged, "beyond": [], "lenses": [{"name": "a lens", "text": "seen so", "claims": judged}],
    }  # fmt: skip
    (tmp_path / "study").mkdir()
    (tmp_path / "study" / "results.json").write_text(json.dumps(results))
    main([tmp_path / "study"], tmp_path)
    page = (tmp_path / PAGE).read_text()
    assert json.loads((tmp_path / DATA).read_text()) == [json.loads(json.dumps(findings_of(results)))]
    assert "## In short (family `paper`)" in page
    assert "## A title (family `paper`)" in page
    assert "### Held: 1 of 1" in page
    assert "Attention is better: **survives**, held through the one lens that applies to it" in page
    assert "Missing: passage, N = 5." in page
    assert "took 1.2 core-hours" in page
    assert "- Larger teams than in training: navigation: `xmarl-bench study zero-shot`\n\n**How" in page
    assert "xmarl-bench study main --jobs 2 --policy paper --episodes 4 --timesteps 3\n" in page
    existing = command({**results, "existing": True})
    assert existing.startswith("xmarl-bench study main --entries leaderboard --policy paper")
    again = {**results, "title": "Another title"}
    (tmp_path / "study" / "results.json").write_text(json.dumps(again))
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "results.json").write_text(json.dumps({**results, "families": ["residual"]}))
    main([tmp_path / "other", tmp_path / "study"], tmp_path)
    kept = [(each["title"], each["families"]) for each in json.loads((tmp_path / DATA).read_text())]
    assert kept == [("Another title", ["paper"]), ("A title", ["residual"])]
    with pytest.raises(InputError, match="run `xmarl-bench study` first"):
        main([tmp_path / "none"], tmp_path)


def test_the_command_without_results_says_what_to_do(run_cli: RunCli) -> None:
    assert "zero-shot" in run_cli("study", "--help").out
