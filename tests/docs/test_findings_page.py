"""docs/findings.md says what the board says, and its sentences follow the numbers."""

from __future__ import annotations

import runpy
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.made_entries import made_entry
from xmarl_bench.board import board_of
from xmarl_bench.board.scores import Scores

DOCS = Path(__file__).parents[2] / "docs"
ABSENCES = tuple(f"{each}_budgeted_fidelity" for each in ("comm", "mean", "resample", "renormalised"))
CONTROLS = "random", "all-ones", "initial-attention", "nearest"
EXPLAINERS = (
    "attention",
    "occlusion",
    "shapley-messages",
    "gnn_explainer",
    "gnn_explainer-tuned",
    "graphmask",
    "graphmask-messages",
)
METRICS = "message_fidelity", "fid_delta", *ABSENCES


@pytest.fixture(scope="module")
def script() -> dict[str, Any]:
    return runpy.run_path(str(DOCS / "make_findings.py"))


def scores(values: dict[str, float]) -> Scores:
    """Two pairs of policies: each explainer's value, by default 0, rises by some 0.01 from policy to policy.

    Differences are unequal, but only in the fifth digit.
    """
    controls = {name: values.get(name, 0.0) for name in CONTROLS}
    policies = [(task, weight) for task in ("passage", "discovery") for weight in (0.0, 0.1)]
    entries = []
    for k, (task, weight) in enumerate(policies):
        for name in EXPLAINERS:
            value = values.get(name, 0.0)
            levels: dict[str, Any] = dict.fromkeys(METRICS, value + 0.01 * k + 1e-5 * value * k**2)
            entries.append(
                made_entry(f"{task}-n3-residual-lambda{weight}-seed0", name, 0.5, task=f"blind_{task}_v0",
                           attention_entropy=weight, controls=controls, **levels)
            )  # fmt: skip
    return Scores.of(board_of((entry.file_name, entry) for entry in entries))


def test_the_page_is_that_of_the_board(script: dict[str, Any]) -> None:
    """If this fails, run docs/make_findings.py."""
    page, findings = script["made"]()
    assert (DOCS / "findings.md").read_text(encoding="utf-8") == page
    for each in findings:
        assert (DOCS / f"findings-{each.name}.png").is_file()


def test_families_are_compared_if_there_are_two(script: dict[str, Any]) -> None:
    of_one = scores({"attention": 0.9, "occlusion": 0.5})
    assert script["by_family"](of_one).endswith("Other families are open.")
    architecture = {**of_one.policies[0]["architecture"], "residual": True}
    others = [{**each, "architecture": architecture} for each in of_one.policies[1:]]
    said = script["by_family"](replace(of_one, policies=[of_one.policies[0], *others]))
    assert said.startswith("In `paper`, 1 policy, `attention` is first (0.92)")
    # Mean over cells: of 0.91 in passage, and of 0.92 and 0.93 in discovery.
    assert "in `residual`, 3 policies, `attention` is first (0.92)" in said
    assert said.endswith("Spearman's correlation of both orders is 1.00.")


@pytest.mark.slow
def test_a_clear_winner_leads_surely_and_a_tie_does_not(
    script: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    clear = script["who_leads"](scores({"attention": 0.9, "occlusion": 0.5}))
    assert clear.title == "attention leads surely"
    assert "`attention` leads" in clear.text
    assert "The next, `occlusion`, is 0.400 (0.400 to 0.400) below." in clear.text
    monkeypatch.setitem(script["who_leads"].__globals__, "rests_on_zero", lambda _: True)
    assert script["who_leads"](scores({"attention": 0.9, "occlusion": 0.5})).title.endswith("model zero")
    tie = script["who_leads"](scores({"attention": 0.9, "occlusion": 0.9}))
    assert tie.title == "Several explainers lead, and none leads surely"
    assert "`attention` and `occlusion` lead" in tie.text


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


def test_attention_beside_the_nearest_agent_is_told_by_task(script: dict[str, Any]) -> None:
    found = script["attention_is_learnt"](scores({"attention": 0.5, "nearest": 0.25}))
    # Of two policies each, one training: 0.255 and 0.275 without interval.
    assert found.text.endswith(
        "By task, attention less the nearest agent is +0.28 in discovery, +0.26 in passage."
    )


def test_first_ones_are_told_together(script: dict[str, Any]) -> None:
    assert script["firsts"]({"a": 0.5, "b": 0.4}) == "`a` is"
    assert script["firsts"]({"a": 0.5, "b": 0.5 + 1e-9, "c": 0.5}) == "`a`, `b` and `c` are"


def test_who_is_first_is_undecided_where_absence_models_are_not_shown_to_differ(
    script: dict[str, Any],
) -> None:
    same = scores({"attention": 0.9, "occlusion": 0.5})
    assert script["absence_decides"](same).title == "attention is first under all absence models"
    under_mean = {name: dict(of) for name, of in same.values[ABSENCES[1]].items()}
    above = dict(zip(under_mean["attention"], (0.2, 0.1, -0.1, -0.1), strict=True))
    under_mean["occlusion"] = {name: under_mean["attention"][name] + x for name, x in above.items()}
    unsure = replace(same, values={**same.values, ABSENCES[1]: under_mean})
    assert script["absence_decides"](unsure).title.endswith("may decide who is first")
    under_mean["occlusion"] = {name: 1.001 * value + 0.3 for name, value in under_mean["attention"].items()}
    sure = replace(same, values={**same.values, ABSENCES[1]: under_mean})
    found = script["absence_decides"](sure)
    assert found.title.endswith("message decides who is first")
    assert "+0.30 [+0.30, +0.30] above attention" in found.text


def test_defaults_are_judged_beside_chance(script: dict[str, Any]) -> None:
    better = script["defaults_fail"](scores({"gnn_explainer": 0.3}))
    assert better.title == "GNNExplainer's defaults are better than chance"
    none = script["defaults_fail"](scores({"gnn_explainer": -0.015}))
    assert none.title == "GNNExplainer's defaults are no better than chance"


def test_the_term_is_judged_over_pairs_of_runs(script: dict[str, Any]) -> None:
    found = script["regulariser"](scores({"attention": 0.5}))
    assert "a difference of 0.010 (0.010 to 0.010), over 2 pairs of training runs." in found.text
    assert found.title == "Attention-entropy regularisation raises message fidelity of attention"


def test_scores_are_those_of_the_ranking_over_all_tasks() -> None:
    def row(name: str, value: float | None, partial: str | None) -> dict[str, Any]:
        metrics = {"message_fidelity": {"value": value}, "gef": None}
        of_entry = {"partial": partial, "date": "2026-01-01", "file": f"{name}.json"}
        return {"explainer": name, "control": False, "metrics": metrics, **of_entry}

    board = {
        "rankings": [
            {
                "task": None,
                "protocol": "p",
                "oracle": "enumerated",
                "policies": [{"name": "a", "n_agents": 3}],
                "rows": [
                    {"explainer": "x", "rank": 1, "ties_first": True},
                    {"explainer": "y", "rank": 2, "ties_first": False},
                    {"explainer": "random", "rank": None, "ties_first": None},
                ],
            }
        ],
        "tables": [
            {
                "task": "t",
                "protocol": protocol,
                "n_agents": n_agents,
                "oracle": "enumerated",
                "policies": [{"name": name, "rows": [row("x", value, partial), row("y", None, partial)]}],
            }
            for name, n_agents, protocol, value, partial in (
                ("a", 3, "p", 0.5, None),
                ("a", 3, "p", 0.9, "shorter episodes"),
                ("a", 3, "q", 0.9, None),
                ("a", 8, "p", 0.9, None),
                ("b", 3, "p", 0.9, None),
            )
        ],
    }
    found = Scores.of(board)
    assert [(each["name"], each["n_agents"]) for each in found.policies] == [("a", 3)]
    assert (found.explainers, found.tied) == (["x", "y"], ["x"])
    assert found.values == {"message_fidelity": {"x": {"a": 0.5}}}
