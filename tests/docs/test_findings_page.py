"""docs/findings.md says what the board says, and its sentences follow the numbers."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import pytest

from xmarl_bench.board.scores import Scores

DOCS = Path(__file__).parents[2] / "docs"
ABSENCES = tuple(f"{each}_budgeted_fidelity" for each in ("comm", "mean", "resample", "renormalised"))
CONTROLS = "random", "all-ones", "initial-attention", "nearest"
EXPLAINERS = (
    "attention",
    "occlusion",
    "gnn_explainer",
    "gnn_explainer-tuned",
    "graphmask",
    "graphmask-messages",
)
METRICS = "message_fidelity", "fid_delta", *ABSENCES


@pytest.fixture(scope="module")
def script() -> dict[str, Any]:
    return runpy.run_path(str(DOCS / "make_findings.py"))


def scores(values: dict[str, float], *, tied: int = 1) -> Scores:
    """Two pairs of policies: each explainer's value, by default 0, rises by 0.01 from policy to policy."""
    policies = [
        {
            "name": f"{task}-n3-residual-lambda{weight}-seed0",
            "task": f"blind_{task}_v0",
            "n_agents": 3,
            "training_seed": 0,
            "attention_entropy": weight,
            "metrics": {name: {"value": 1.0 + weight} for name in ("attention_entropy", "success_rate")},
        }
        for task in ("passage", "discovery")
        for weight in (0.0, 0.1)
    ]
    of_policies: dict[str, dict[str, float]] = {
        name: {
            str(policy["name"]): values.get(name, 0.0) + 0.01 * k * (name in EXPLAINERS)
            for k, policy in enumerate(policies)
        }
        for name in (*EXPLAINERS, *CONTROLS)
    }
    ranked = sorted(EXPLAINERS, key=lambda name: -values.get(name, 0.0))
    return Scores(policies, ranked, ranked[:tied], dict.fromkeys(METRICS, of_policies))


def test_the_page_is_that_of_the_board(script: dict[str, Any]) -> None:
    """If this fails, run docs/make_findings.py."""
    page, findings = script["made"]()
    assert (DOCS / "findings.md").read_text(encoding="utf-8") == page
    for each in findings:
        assert (DOCS / f"findings-{each.name}.png").is_file()


def test_a_clear_winner_leads_surely_and_a_tie_does_not(script: dict[str, Any]) -> None:
    clear = script["who_leads"](scores({"attention": 0.9, "occlusion": 0.5}))
    assert clear.title == "attention leads surely"
    assert "occlusion: +0.40 [+0.40, +0.40] for attention" in clear.text
    tie = script["who_leads"](scores({"attention": 0.9, "occlusion": 0.9}, tied=2))
    assert tie.title == "Several explainers lead, and none leads surely"
    assert "It does not differ significantly from occlusion." in tie.text


@pytest.mark.parametrize(
    ("untrained", "title"),
    [
        (0.0, "Attention tells what training put there"),
        (0.9, "Attention may be our initialisation"),
        (1.5, "Training makes attention worse"),
    ],
)
def test_attention_is_judged_beside_its_initialisation(
    untrained: float, title: str, script: dict[str, Any]
) -> None:
    found = script["attention_is_learnt"](scores({"attention": 0.885, "initial-attention": untrained}))
    assert found.title == title


def test_defaults_are_judged_beside_chance(script: dict[str, Any]) -> None:
    better = script["defaults_fail"](scores({"gnn_explainer": 0.3}))
    assert better.title == "GNNExplainer's defaults are better than chance"
    none = script["defaults_fail"](scores({"gnn_explainer": -0.015}))
    assert none.title == "GNNExplainer's defaults are no better than chance"


def test_the_term_is_judged_over_pairs_of_runs(script: dict[str, Any]) -> None:
    found = script["regulariser"](scores({"attention": 0.5}))
    assert "+0.01 [+0.01, +0.01] message fidelity of attention, over 2 pairs" in found.text
    assert found.title == "Minimising attention entropy makes attention truer"


def test_scores_are_those_of_the_ranking_over_all_tasks() -> None:
    def row(name: str, value: float | None) -> dict[str, Any]:
        return {"explainer": name, "metrics": {"message_fidelity": {"value": value}, "gef": None}}

    board = {
        "rankings": [
            {
                "task": None,
                "oracle": "enumerated",
                "policies": [{"name": "a", "n_agents": 3}],
                "rows": [
                    {"explainer": "x", "rank": 1, "tie_group": 1},
                    {"explainer": "y", "rank": 2, "tie_group": 2},
                    {"explainer": "random", "rank": None, "tie_group": None},
                ],
            }
        ],
        "tables": [
            {
                "task": "t",
                "n_agents": n_agents,
                "oracle": "enumerated",
                "policies": [{"name": name, "rows": [row("x", 0.5), row("y", None)]}],
            }
            for name, n_agents in (("a", 3), ("a", 8), ("b", 3))
        ],
    }
    found = Scores.of(board)
    assert [(each["name"], each["n_agents"]) for each in found.policies] == [("a", 3)]
    assert (found.explainers, found.tied) == (["x", "y"], ["x"])
    assert found.values == {"message_fidelity": {"x": {"a": 0.5}}}
