"""docs/dose.md says what the records of the runs say, and its answer follows the numbers."""

from __future__ import annotations

import json
import runpy
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
DOSES = 0.0, 0.1, 0.3


@pytest.fixture(scope="module")
def script() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "docs" / "make_dose.py"))


def records(fidelity: dict[int, tuple[float, ...]]) -> list[dict[str, Any]]:
    """Seed -> message fidelity by lambda."""
    control = {"message_fidelity": 0.25}
    return [
        {"lambda": weight, "seed": seed, "message_fidelity": value, "success": 1.0 - weight,
         "no_agent_collision": 0.9, "success_without_messages": 0.5, "attention_entropy": 1.0 - weight,
         "controls": {"nearest": control, "initial-attention": control}}
        for seed, values in fidelity.items()
        for weight, value in zip(DOSES, values, strict=True)
    ]  # fmt: skip


def test_the_page_is_that_of_the_records(script: dict[str, Any]) -> None:
    """If this fails, run docs/make_dose.py."""
    page, runs = script["made"]()
    assert len(runs) >= 4 and 0.0 in runs
    assert (ROOT / "docs" / "dose.md").read_text(encoding="utf-8") == page
    assert (ROOT / "docs" / "dose.png").is_file()


def test_records_and_the_board_agree_on_shipped_policies(script: dict[str, Any]) -> None:
    board = json.loads((ROOT / "leaderboard" / "leaderboard.json").read_bytes())
    on_board = {
        policy["name"]: row["metrics"]["message_fidelity"]["value"]
        for table in board["tables"]
        for policy in table["policies"]
        for row in policy["rows"]
        if row["explainer"] == "attention" and policy["trained_n_agents"] == table["n_agents"]
    }
    _, runs = script["made"]()
    both = [each for of_seeds in runs.values() for each in of_seeds.values() if each["name"] in on_board]
    assert len(both) >= 2
    for each in both:
        assert each["message_fidelity"] == pytest.approx(on_board[each["name"]], abs=1e-6)


@pytest.mark.parametrize(
    ("fidelity", "said"),
    [
        (
            {0: (0.5, 0.6, 0.7), 1: (0.4, 0.7, 0.8), 2: (0.1, 0.2, 0.3)},
            "makes attention truer: within a seed, Kendall's tau of ",
        ),
        (
            {0: (0.7, 0.6, 0.5), 1: (0.8, 0.7, 0.4), 2: (0.3, 0.2, 0.1)},
            "More of the term makes attention less true: ",
        ),
        (
            {0: (0.5, 0.6, 0.7), 1: (0.7, 0.6, 0.5), 2: (0.5, 0.7, 0.6)},
            "It is not decided whether more of the term",
        ),
    ],
)
def test_the_answer_follows_the_numbers(
    fidelity: dict[int, tuple[float, ...]], said: str, script: dict[str, Any]
) -> None:
    """Three seeds order three lambdas alike by chance once in 6^3: p is 2 / 216."""
    text = script["answer"](script["runs_of"](records(fidelity)))
    assert said in text
    assert "Tau of lambda and success is -1.00 (p 0.009)," in text
    assert "agents touching undefined. At lambda 0.3 " in text  # it is constant


@pytest.mark.parametrize(
    ("nearest", "said"),
    [
        ((0.3, 0.3, 0.3), "changes by +0.00 [+0.00, +0.00], and the lead of attention over it by +0.30 "),
        ((0.3, 0.5, 0.6), "So it is not shown that attention gains more than this control does"),
    ],
)
def test_attention_is_judged_beside_the_nearest_agent(
    nearest: tuple[float, ...], said: str, script: dict[str, Any]
) -> None:
    made = records({0: (0.5, 0.6, 0.75), 1: (0.5, 0.7, 0.85)})
    for k, record in enumerate(made):
        value = 0.3 + (nearest[k % len(DOSES)] - 0.3) * (1.0 + 0.01 * record["seed"])
        record["controls"] = {**record["controls"], "nearest": {"message_fidelity": value}}
    assert said in script["answer"](script["runs_of"](made))


def test_a_difference_is_told_where_its_interval_excludes_0(script: dict[str, Any]) -> None:
    made = records({0: (0.50, 0.66, 0.2), 1: (0.50, 0.65, 0.6), 2: (0.50, 0.67, 0.9)})
    text = script["answer"](script["runs_of"](made))
    assert text.count("With lambda") == 1
    assert (
        "With lambda 0.1 message fidelity differs from that without the term by +0.16 [+0.14, +0.18]" in text
    )


def test_a_seed_counts_where_it_has_every_lambda(script: dict[str, Any]) -> None:
    made = [*records({0: (0.5, 0.6, 0.7), 1: (0.4, 0.5, 0.6)}), *records({2: (0.9, 0.1, 0.0)})[:2]]
    runs = script["runs_of"](made)
    assert script["trend"](runs, "message_fidelity").n == 2
    difference = script["against_none"](runs, 0.1, "message_fidelity")  # 0.1, 0.1 and -0.8
    assert difference.value == pytest.approx(-0.2)
    (_, _, first), *_ = [[row[0], row[1], row[2]] for row in script["rows"](runs)]
    assert first == "0.60"
