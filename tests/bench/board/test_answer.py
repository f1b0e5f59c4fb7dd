"""The sentences about a ranking, on boards made by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pytest

from tests.helpers.made_entries import made_entry
from xmarl_bench.board import board_of
from xmarl_bench.board.answer import answer_about, answer_of, answer_on_term, gamed_by, number
from xmarl_bench.board.entry_rows import Json
from xmarl_bench.board.regulariser import families_of, regulariser_of


def ranking(levels: Mapping[str, Sequence[float]], runs: int = 1) -> Json:
    """The ranking of explainers with these message fidelities, one for each policy; controls have 0.1.

    runs: policies in a row that have one training seed.
    """
    board = board_of(
        (f"{name}{k}", made_entry(f"p{k}", name, 0.5, training_seed=k // runs, message_fidelity=level))
        for name, each in levels.items()
        for k, level in enumerate(each)
    )
    found: Json = board["rankings"][0]
    return found


def test_a_clear_winner() -> None:
    """Student's half width of 0.9, 0.8 and 0.85 is 4.303 x 0.05 / sqrt(3) = 0.124; b is some 0.6 below."""
    found = ranking({"a": [0.9, 0.8, 0.85], "b": [0.31, 0.2, 0.24]})
    assert answer_of(found) == [
        "`a` leads with a message fidelity of 0.850 (95 %: 0.726 to 0.974), over 3 policies.",
        "The next, `b`, is 0.600 (0.575 to 0.625) below.",
        "All are better than `random`.",
        "All are better than `nearest`.",
    ]


def test_policies_of_one_seed_count_as_one() -> None:
    """Means of the pairs are 0.9 and 0.8: Student's half width with 1 degree of freedom is 12.706 x 0.05."""
    found = ranking({"a": [0.9, 0.9, 0.8, 0.8], "b": [0.9, 0.8, 0.6, 0.6]}, runs=2)
    (first, second, *_) = answer_of(found)
    assert first.endswith("0.850 (95 %: 0.215 to 1.000), over 4 policies (2 independent trainings).")
    assert second == "No other explainer differs significantly from the first."


def test_one_training_tests_nothing() -> None:
    said = answer_of(ranking({"a": [0.9, 0.8], "b": [0.3, 0.2]}, runs=2))
    assert said == [
        "`a` leads with a message fidelity of 0.850, over 2 policies (1 independent training).",
        "Nothing is tested: one training gives no interval.",
    ]


def test_cells_weigh_the_same() -> None:
    """Two policies with three agents and one with four: (0.9 + 0.7) / 2 and 0.4 have a mean of 0.6."""
    levels = ((3, 0, 0.9), (3, 1, 0.7), (4, 0, 0.4))
    board = board_of(
        (
            f"{name}{n}{seed}",
            made_entry(
                f"p{n}{seed}", name, 0.5, n_agents=n, training_seed=seed, message_fidelity=level - below
            ),
        )
        for name, below in (("a", 0.0), ("b", 0.1))
        for n, seed, level in levels
    )
    (first, *_) = answer_of(board["rankings"][0])
    assert "`a` leads with a message fidelity of 0.600 (95 %: " in first
    assert first.endswith("over 3 policies in 2 cells.")


def test_a_tie_is_not_a_win() -> None:
    found = ranking({"a": [0.9, 0.5, 0.9], "b": [0.5, 0.9, 0.8], "c": [0.2, 0.1, 0.2]})
    said = answer_of(found)
    assert said[0].startswith("`a` leads with a message fidelity of 0.767")
    assert said[1].startswith(
        "`b` does not differ significantly from the first; the best that does, `c`, is 0.600"
    )
    tied = answer_of(ranking({"a": [0.9, 0.5, 0.9], "b": [0.5, 0.9, 0.8]}))
    assert tied[1] == "No other explainer differs significantly from the first."
    same = answer_of(ranking({"a": [0.9, 0.8], "b": [0.9, 0.8]}))
    assert same[0].startswith("`a` and `b` lead with")


def test_nobody_is_better_than_random() -> None:
    found = ranking({"a": [0.1, 0.5, -0.1], "b": [0.0, 0.0, 0.1]})
    said = answer_of(found)
    assert said[0].startswith("No explainer is shown to be better than a `random` ranking. `a` leads")
    assert said[-1] == "None is shown to be better than `nearest`."
    about = answer_about("b", found)
    assert about[0].startswith("`b` has rank 2 of 2 (95 %: ")
    assert about[1] == "It is not shown to be better than `random`: by \u22120.067 (\u22120.210 to 0.077)."


def test_some_are_no_better_than_a_control() -> None:
    said = answer_of(ranking({"a": [0.9, 0.8, 0.85], "b": [0.1, 0.2, 0.05]}))
    assert said[2:] == [
        "Not shown to be better than `random`: `b`.",
        "Not shown to be better than `nearest`: `b`.",
    ]


def test_the_units_of_one_policy_are_its_episodes() -> None:
    (first, *_) = answer_of(ranking({"a": [0.9], "b": [0.2]}))
    assert first.endswith("over 1 policy, whose episodes are the units.")


def test_nothing_ranked_and_partly_scored() -> None:
    assert answer_of(None)[0].startswith("Nothing is ranked here")
    found = ranking({"a": [0.9, 0.8], "b": [0.3, 0.2], "c": [0.95]})
    assert answer_about("c", found) == ["`c` is not ranked here: scored on 1 of 2 policies."]
    assert answer_about("unknown", found)[0].startswith("`unknown` is not ranked here")


def test_a_control_games_fid_delta() -> None:
    found = ranking({"a": [0.9, 0.8]})
    assert gamed_by(found["rows"]).startswith("The control `")
    assert "gets a FidDelta of 0.100 and a message fidelity of 0.100; `a`, the first, gets" in gamed_by(
        found["rows"]
    )
    assert gamed_by([]) == ""


@pytest.mark.parametrize(
    ("with_term", "said"),
    [
        ((0.91, 0.69), "raises the message fidelity of `a`: 0.400 without and 0.800 with it, a difference of "
         "0.400 (0.273 to 0.527), over 2 pairs of training runs."),
        ((0.5, 0.2), "is not shown to change the message fidelity of `a`: 0.400 without and 0.350 with it"),
        ((0.3, 0.11), "lowers the message fidelity of `a`"),
    ],
)  # fmt: skip
def test_what_the_regulariser_does(with_term: tuple[float, float], said: str) -> None:
    """Pairs of 3 and 4 agents, 0.5 and 0.3 without the term; a policy of 5 agents has no partner."""
    listed = [("w", n, level, 0.1) for n, level in zip((3, 4), with_term, strict=True)]
    listed += [("o", 3, 0.5, 0.0), ("o", 4, 0.3, 0.0), ("alone", 5, 0.1, 0.0)]
    board = board_of(
        (
            f"{name}{n}",
            made_entry(f"{name}{n}", "a", 0.5, n_agents=n, attention_entropy=term, message_fidelity=x),
        )
        for name, n, x, term in listed
    )
    families = families_of(board["tables"])
    assert [(family["n_agents"], family["kind"]) for family in families] == [(3, "paper"), (4, "paper")]
    assert said in answer_on_term("a", regulariser_of(families)["a"])


def test_without_a_pair_nothing_is_said_of_the_regulariser() -> None:
    assert answer_on_term("a", None).startswith("No pair of ranked policies")


def test_numbers_are_rounded_once() -> None:
    assert [number(x) for x in (0.12345, -0.0001, -0.5, None)] == ["0.123", "0.000", "\u22120.500", "\u2013"]
    assert number(0.0005, 3) == f"{0.0005:.3f}"
