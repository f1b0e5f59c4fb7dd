"""Ranks, their intervals and tie groups."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.helpers.made_entries import made_board, made_entry
from xmarl_bench.board import board_of
from xmarl_bench.board.columns import ORDER
from xmarl_bench.board.entry_rows import Json
from xmarl_bench.board.ranking import Floats, complete_part, places
from xmarl_bench.board.regulariser import score_of
from xmarl_bench.board.scores import Scores
from xmarl_bench.entry.protocol import SAMPLED
from xmarl_bench.entry.schema import Entry, OracleRecord
from xmarl_bench.metrics.statistics import over_units


def board(entries: Sequence[Entry]) -> Json:
    return board_of([(f"{k}.json", entry) for k, entry in enumerate(entries)])


def order_of(entry: Entry) -> float:
    summary = entry.results[0].metrics.message_fidelity
    assert summary is not None
    assert summary.value is not None
    return summary.value


def noisy(levels: Sequence[float], n_policies: int, n_episodes: int, seed: int = 1) -> list[Floats]:
    """Policies differ, but differences that competitors share cancel in pairs."""
    generator = np.random.default_rng(seed)
    return [
        np.array(levels)[:, None]
        + generator.normal(size=n_episodes)
        + 0.1 * generator.normal(size=(len(levels), n_episodes))
        for _ in range(n_policies)
    ]


def test_places_by_hand() -> None:
    blocks = noisy([0.0, 1.0, 0.99, -5.0], n_policies=1, n_episodes=12)
    found = places([float(x) for x in blocks[0].mean(axis=1)], blocks)
    first, second = (1, 2) if found[1].rank == 1 else (2, 1)
    assert [found[r].rank for r in (first, second, 0, 3)] == [1, 2, 3, 4]
    assert found[0].rank_interval == (3, 3)
    assert found[3].rank_interval == (4, 4)
    assert found[1].rank_interval == found[2].rank_interval == (1, 2)
    assert [found[r].tie_group for r in (first, second, 0, 3)] == [1, 1, 2, 3]
    interval = found[3].interval
    assert interval is not None
    assert interval[0] < blocks[0][3].mean() < interval[1]


def test_who_is_behind_surely_does_not_hide_a_later_tie_with_the_first() -> None:
    """The second is 0.1 below in every episode, give or take 0.01; the third 0.2, give or take 1."""
    noise = np.array([-1.0, 1.0] * 6)
    found = places([1.0, 0.9, 0.8], [np.stack([0.0 * noise + 1.0, 0.9 + 0.01 * noise, 0.8 + noise])])
    assert [place.ties_first for place in found] == [True, False, True]
    assert [place.tie_group for place in found] == [1, 2, 2]


def test_scores_equal_up_to_rounding_share_a_rank() -> None:
    (block,) = noisy([1.0, 0.0], n_policies=1, n_episodes=12)
    block = np.stack([block[1], block[0], block[0] * (1 + 1e-15)])
    found = places([float(row.mean()) for row in block], [block])
    assert [place.rank for place in found] == [3, 1, 1]
    assert [place.rank_interval for place in found] == [(3, 3), (1, 1), (1, 1)]
    assert [place.tie_group for place in found] == [2, 1, 1]


@pytest.mark.slow
@given(st.lists(st.floats(-1, 1), min_size=1, max_size=5), st.integers(1, 3), st.integers(0, 5))
def test_places_have_the_properties_of_a_ranking(levels: list[float], n_policies: int, seed: int) -> None:
    blocks = noisy(levels, n_policies, 8, seed)
    values = [float(np.mean([block[r].mean() for block in blocks])) for r in range(len(levels))]
    found = places(values, blocks)
    by_rank = sorted(range(len(levels)), key=lambda r: found[r].rank)
    assert [found[r].rank for r in by_rank] == list(range(1, len(levels) + 1))
    assert [values[r] for r in by_rank] == sorted(values, reverse=True)
    groups = [found[r].tie_group for r in by_rank]
    assert groups[0] == 1
    assert set(np.diff(groups)) <= {0, 1}
    for place in found:
        assert place.rank_interval is not None
        assert 1 <= place.rank_interval[0] <= place.rank_interval[1] <= len(levels)


@pytest.mark.parametrize("n_policies", [1, 4])
def test_intervals_and_groups_equal_those_of_the_statistics(n_policies: int) -> None:
    levels = [3.0, 3.0, 2.0, 1.0, 1.0]
    blocks = noisy(levels, n_policies, n_episodes=30)
    rows = [[block[r] for block in blocks] for r in range(5)]
    values = [float(np.mean([block[r].mean() for block in blocks])) for r in range(5)]
    found = places(values, blocks)
    zeros = [np.zeros(30)] * n_policies
    for place, row in zip(found, rows, strict=True):
        assert place.interval == pytest.approx(over_units(row, zeros).interval)
    order = sorted(range(5), key=lambda r: -values[r])
    head, group = order[0], 1
    for r in order[1:]:
        if not over_units(rows[head], rows[r]).holds_zero:
            head, group = r, group + 1
        assert found[r].tie_group == group
    assert group >= 3


def test_three_unequal_runs_do_not_separate_ranks() -> None:
    """A mean that is higher in each of three runs, by different amounts, is not significantly higher."""
    blocks = [np.array([[by, by], [0.0, 0.0]]) for by in (0.1, 0.5, 1.2)]
    found = places([0.6, 0.0], blocks)
    assert [place.rank for place in found] == [1, 2]
    assert [place.rank_interval for place in found] == [(1, 2), (1, 2)]
    assert [place.tie_group for place in found] == [1, 1]


def test_an_episode_counts_if_all_have_a_number() -> None:
    block = np.array([[2.9, np.nan, 3.0, 3.1], [0.0, 50.0, 0.0, 0.0]])
    found = places([3.0, 0.0], [block])
    assert [place.rank_interval for place in found] == [(1, 1), (2, 2)]  # the 50 has no pair


def test_one_episode_separates_no_ranks() -> None:
    found = places([0.1, 0.9], [np.array([[0.1], [0.9]])])
    assert [(p.rank, p.rank_interval, p.interval, p.tie_group) for p in found] == [
        (2, None, None, 1), (1, None, None, 1),
    ]  # fmt: skip
    assert places([], []) == []


def test_an_explainer_on_few_policies_does_not_shrink_the_common_set() -> None:
    full = {f"policy{k}": ["a", "b", "c"] for k in range(5)}
    policies, explainers = list(full), ["a", "b", "c"]
    assert complete_part(full) == (policies, explainers)
    assert complete_part({**full, "new": ["a"]}) == (policies, explainers)
    assert complete_part({**full, "policy0": ["a", "b", "c", "new"]}) == (policies, explainers)
    assert complete_part({"p": ["a"], "q": ["b"]}) == ([], [])
    assert complete_part({}) == ([], [])


@pytest.mark.slow
def test_ranking_over_policies_has_each_explainers_mean() -> None:
    entries = [
        *made_board([f"policy{k}" for k in range(6)], {"good": 0.9, "twin": 0.9, "bad": 0.3}),
        made_entry("policy0", "partial", 0.95),
    ]
    made = board(entries)
    overall = next(each for each in made["rankings"] if each["task"] is None)
    rows = {row["explainer"]: row for row in overall["rows"]}
    assert [policy["name"] for policy in overall["policies"]] == [f"policy{k}" for k in (0, 3, 1, 4, 2, 5)]
    means = {
        name: np.mean([order_of(e) for e in entries if e.explainer.name == name])
        for name in ("good", "twin", "bad")
    }
    for name, mean in means.items():
        assert rows[name]["value"] == pytest.approx(mean)
        assert rows[name]["interval"][0] < mean < rows[name]["interval"][1]
        assert rows[name]["n_policies"] == 6
    assert rows["bad"]["rank"] == 3
    assert rows["good"]["tie_group"] == rows["twin"]["tie_group"] == 1
    assert rows["bad"]["tie_group"] == 2
    assert rows["partial"]["rank"] is None  # the best value, of one policy of six
    assert rows["partial"]["n_policies"] == 1
    assert rows["random"]["control"] is True
    assert rows["random"]["value"] == pytest.approx(0.1)
    assert rows["partial"]["reason"] == "scored on 1 of 6 policies"
    cells = [(each["task"], each["n_agents"]) for each in made["rankings"]]
    assert cells == [(None, None), *(("blind_navigation_v0", n) for n in (None, 3, 4, 5))]


def test_of_explainers_with_one_name_the_one_on_most_policies_is_ranked() -> None:
    """Other hyperparameters make another explainer. It is not the best value that counts."""
    everywhere = [made_entry(f"policy{k}", "mine", 0.4, n_agents=3 + k) for k in (0, 1)]
    entries = [*made_board(["policy0", "policy1"], {"good": 0.8}), *everywhere]
    other = made_entry("policy0", "mine", 0.95, submitter="somebody else", hyperparameters={"epochs": 9})
    for more in ([], [other]):
        overall = next(each for each in board([*entries, *more])["rankings"] if each["task"] is None)
        rows = {row["explainer"]: row for row in overall["rows"]}
        assert (rows["good"]["rank"], rows["mine"]["rank"]) == (1, 2)
        assert rows["mine"]["value"] == pytest.approx(np.mean([order_of(each) for each in everywhere]))


def test_of_an_explainer_s_entries_on_a_policy_the_newest_counts() -> None:
    """In the ranking, in what is said of it and of the term, whatever the files' names and values."""
    old = made_entry("policy", "mine", 0.9)
    finished = {"finished": "2026-02-02T00:00:00Z"}
    again = made_entry("policy", "mine", 0.3, submitter="somebody else")
    again = again.model_copy(update={"provenance": again.provenance.model_copy(update=finished)})
    for listed in ([old, again], [again, old]):
        made = board([*listed, made_entry("policy", "good", 0.8)])
        (ranking,) = (each for each in made["rankings"] if each["task"] is None)
        rows = {row["explainer"]: row for row in ranking["rows"]}
        expected = pytest.approx(order_of(again))
        assert rows["mine"]["value"] == expected
        assert Scores.of(made).mean(ORDER["by"], "mine") == expected
        assert score_of(made["tables"][0]["policies"][0], "mine") == expected


def test_gated_policies_are_not_ranked() -> None:
    listed = [made_entry("fine", "a", 0.5), made_entry("failing", "a", 0.9, success_rate=0.2)]
    made = board(listed)
    overall = made["rankings"][0]
    assert [policy["name"] for policy in overall["policies"]] == ["fine"]
    groups = {policy["name"]: policy for policy in made["tables"][0]["policies"]}
    (row,) = [row for row in groups["failing"]["rows"] if row["entry_id"]]
    assert (row["rank"], row["rank_interval"], row["tie_group"]) == (None, None, None)
    assert groups["failing"]["gate"] == "success rate 0.200, under 0.5"


def test_a_policy_without_message_fidelity_is_not_ranked() -> None:
    made = board([made_entry("deep", "a", 0.5, message_fidelity=None)])
    assert made["rankings"] == []
    assert all(row["rank"] is None for row in made["tables"][0]["policies"][0]["rows"])


def test_a_ranking_is_computed_over_training_runs() -> None:
    """Three policies of one cell and one of another, computed by hand from their means."""
    levels = {"a": (0.9, 0.8, 0.3, 0.7), "b": (0.5, 0.5, 0.5, 0.5)}
    entries = {
        name: [
            made_entry(f"p{k}", name, level, n_agents=3 if k < 3 else 4, message_fidelity=level)
            for k, level in enumerate(each)
        ]
        for name, each in levels.items()
    }
    made = board([entry for each in entries.values() for entry in each])
    ranking = next(each for each in made["rankings"] if each["task"] is None)
    a, b = (next(row for row in ranking["rows"] if row["explainer"] == name) for name in "ab")
    assert a["iqm"] == pytest.approx((0.8 + 0.7) / 2)
    assert (a["values"], b["values"]) == ([0.9, 0.8, 0.3, 0.7], [0.5, 0.5, 0.5, 0.5])


def test_what_rows_share_is_stated_once() -> None:
    """Numbers of episodes, if they differ from the protocol's, and reasons; nothing if not measured."""
    entries = [made_entry("p", name, 0.5, gef=None) for name in "ab"]
    (cell,) = entries[0].results
    few = cell.metrics.fid_plus.model_copy(update={"n": 48, "n_nan": 2})
    metrics = cell.metrics.model_copy(update={"fid_plus": few})
    entries[0] = entries[0].model_copy(update={"results": (cell.model_copy(update={"metrics": metrics}),)})
    made = board(entries)
    (policy,) = made["tables"][0]["policies"]
    rows = {row["explainer"]: row for row in policy["rows"]}
    assert {name: set(rows[name]["metrics"]["fid_plus"]) for name in "ab"} == {
        "a": {"value", "interval", "n", "n_nan"},
        "b": {"value", "interval"},
    }
    assert (rows["a"]["metrics"]["fid_plus"]["n"], rows["a"]["metrics"]["fid_plus"]["n_nan"]) == (48, 2)
    assert "gef" not in rows["a"]["metrics"]
    assert {made["not_measured"][rows[name]["not_measured"]]["no_object_collision"] for name in "ab"} == {
        "the task has no walls"
    }
    assert len(made["not_measured"]) == 1
    assert rows["random"]["not_measured"] is None


def test_a_sampled_oracle_is_a_table_and_a_ranking_of_its_own() -> None:
    sampled = OracleRecord(kind="sampled", orders=8, error=0.02, definition=SAMPLED)
    made = board(
        [
            made_entry(policy, explainer, level, n_agents=4, oracle=oracle)
            for policy, oracle in (
                ("shallow", None),
                ("counted", OracleRecord(kind="enumerated")),
                ("deep", sampled),
            )
            for explainer, level in (("attention", 0.8), ("guess", 0.2))
        ]
    )
    tables = {table["oracle"]: [policy["name"] for policy in table["policies"]] for table in made["tables"]}
    assert tables == {"enumerated": ["counted", "shallow"], "sampled": ["deep"]}
    assert [policy["oracle_error"] for policy in made["tables"][1]["policies"]] == [0.02]
    over = {
        (each["oracle"], each["task"]): [p["name"] for p in each["policies"]] for each in made["rankings"]
    }
    for task in (None, "blind_navigation_v0"):
        assert over["enumerated", task] == ["counted", "shallow"]
        assert over["sampled", task] == ["deep"]
    assert all(
        row["rank"] is not None for each in made["rankings"] for row in each["rows"] if not row["control"]
    )


def test_a_policy_in_a_larger_team_is_ranked_in_that_cell_alone() -> None:
    made = board(
        [
            made_entry("five", explainer, level, n_agents=n_agents, trained=5)
            for n_agents in (5, 8)
            for explainer, level in (("attention", 0.8), ("guess", 0.2))
        ]
    )
    over = {each["n_agents"]: each["policies"] for each in made["rankings"]}
    assert set(over) == {None, 5, 8}
    assert (
        over[None]
        == over[5]
        == [{"name": "five", "task": "blind_navigation_v0", "n_agents": 5, "trained_n_agents": 5}]
    )
    assert over[8] == [{"name": "five", "task": "blind_navigation_v0", "n_agents": 8, "trained_n_agents": 5}]


def test_the_gate_holds_for_larger_teams_too() -> None:
    made = board(
        [made_entry("five", "attention", 0.8, n_agents=8, trained=5, success_gain=0.0, reward_gain=0.0)]
    )
    (table,) = made["tables"]
    assert "messages are not shown to help" in table["policies"][0]["gate"]
    assert made["rankings"] == []
