"""What the answers of a board rest on: the absence model `zero`, pairs with policies that are not ranked."""

from __future__ import annotations

from typing import Any

import pytest

from tests.helpers.made_entries import made_entry
from xmarl_bench.board import board_of
from xmarl_bench.board.regulariser import families_of
from xmarl_bench.board.robustness import (
    answer_by,
    lead_without_zero,
    others_with_term,
    rests_on_zero,
    with_gated_pairs,
)
from xmarl_bench.board.scores import Scores
from xmarl_bench.metrics.table import ORDER, UNDER_ABSENCES


def board(levels: dict[str, tuple[float, ...]], n_policies: int = 3) -> dict[str, Any]:
    """Explainers with these budgeted fidelities on average, zero first."""
    entries = []
    for number, (name, of) in enumerate(levels.items(), start=1):
        for k in range(n_policies):
            more = 0.01 * number * (k - (n_policies - 1) / 2)
            each: dict[str, Any] = {metric: x + more for metric, x in zip(UNDER_ABSENCES, of, strict=True)}
            each[ORDER] = sum(of) / 4 + more
            entries.append((f"{name}{k}", made_entry(f"p{k}", name, 0.5, training_seed=k, **each)))
    return board_of(entries)


@pytest.mark.parametrize(
    ("second", "said"),
    [
        ((0.4, 0.6, 0.6, 0.6), "That lead rests on the absence model `zero`, which Shapley values and "
         "occlusion assume themselves: by the mean of the other three, `a` less `b` is \u22120.100"),
        ((0.4, 0.3, 0.3, 0.3), "That lead does not rest on the absence model `zero`"),
    ],
)  # fmt: skip
def test_a_lead_is_told_without_zero(second: tuple[float, ...], said: str) -> None:
    scores = Scores.of(board({"a": (0.9, 0.5, 0.5, 0.5), "b": second}))
    assert lead_without_zero(scores).startswith(said)
    assert rests_on_zero(scores) == ("lead rests on" in said)
    _, lead, rests, *_ = answer_by(scores)
    assert lead.startswith("The next, `b`, is") and rests.startswith(said)


def test_every_ranking_tells_what_its_lead_rests_on() -> None:
    made = board({"a": (0.9, 0.5, 0.5, 0.5), "b": (0.4, 0.6, 0.6, 0.6)})
    assert {ranking["task"] for ranking in made["rankings"]} == {None, made["tables"][0]["task"]}
    for ranking in made["rankings"]:
        said = answer_by(Scores.of(made, ranking))
        assert said[2].startswith("That lead rests on the absence model `zero`"), ranking["task"]


def test_without_a_lead_nothing_is_added() -> None:
    scores = Scores.of(board({"a": (0.9, 0.5, 0.5, 0.5)}))
    assert lead_without_zero(scores) == "" and not rests_on_zero(scores)
    assert not any(" on the absence model" in each for each in answer_by(scores))


def paired(*, success: float = 0.9) -> list[dict[str, Any]]:
    """Two pairs in cells of 3 and 4 agents, and one of 5 whose policy with the term has this success."""
    listed = []
    for n in (3, 4, 5):
        for term in (0.0, 0.1):
            for name, gain in (("attention", 0.3), ("first", 0.2), ("flat", 0.0)):
                gain *= 1.0 + 0.02 * (n - 3.5)
                level = 0.5 + gain * (term > 0.0) - 0.1 * (n == 5 and term > 0.0)
                of_policy = success if n == 5 and term > 0.0 else 0.9
                listed.append(
                    made_entry(f"n{n}-{term}", name, 0.5, n_agents=n, attention_entropy=term,
                               message_fidelity=level, success_rate=of_policy)
                )  # fmt: skip
    tables: list[dict[str, Any]] = board_of((each.file_name, each) for each in listed)["tables"]
    return tables


def test_what_the_term_does_to_the_others() -> None:
    said = others_with_term(families_of(paired(success=0.4)), "attention", "first")
    assert said == (
        "It raises that of 1 of the 2 other explainers too, and changes that of `first` by 0.200 "
        "(0.175 to 0.225); `attention` less `first` changes by 0.100 (0.087 to 0.113)."
    )
    assert others_with_term(families_of(paired()), "first", "first") == ""


def test_pairs_that_the_gate_left_out() -> None:
    """Differences are 0.297, 0.303 and 0.209; success changes by 0, 0 and -0.5."""
    said = with_gated_pairs(paired(success=0.4), "attention")
    assert said.startswith(
        "1 pair is left out, because the board does not rank one of the policies or both; "
    )
    assert "the differences are 0.270 (" in said and "and \u22120.167 (" in said
    assert with_gated_pairs(paired(), "attention") == ""
