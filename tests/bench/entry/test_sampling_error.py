"""The error that a sampled oracle gives to a cell, by hand."""

from __future__ import annotations

import math

import pytest

from tests.helpers.made_entries import made_entry
from xmarl_bench.entry.aggregation import sampling_error
from xmarl_bench.entry.metric_records import BudgetRow, EpisodeRow


def budget(errors: tuple[float | None, ...] | None, *room: float) -> BudgetRow:
    zeros = (0.0,) * len(room)
    return BudgetRow(explained=zeros, random=zeros, oracle=room, random_error=errors)


def rows(*budgets: dict[str, BudgetRow]) -> list[EpisodeRow]:
    (cell,) = made_entry("policy", "explainer", 0.5, n_agents=4, episodes=len(budgets)).results
    return [row.model_copy(update=each) for row, each in zip(cell.episodes, budgets, strict=True)]


def test_errors_are_in_units_of_the_room_and_fall_with_episodes() -> None:
    first = budget((0.1, 0.1), 0.5, 0.25)  # (0.1 / 0.5 + 0.1 / 0.25) / 2 = 0.3
    other = budget((0.2, 9.0), 0.5, 1e-4)  # 0.4: a budget without room is not counted
    assert sampling_error(rows({"comm_budget": first}, {"comm_budget": other})) == pytest.approx(
        math.hypot(0.3, 0.4) / 2
    )


def test_the_absence_model_that_errs_most_stands_for_all() -> None:
    both = {"comm_budget": budget((0.1,), 1.0), "mean_budget": budget((0.2,), 1.0)}
    assert sampling_error(rows(both)) == pytest.approx(0.2)
    edges = {"budget": budget((5.0,), 1.0)}  # all edges are no part of message fidelity
    assert sampling_error(rows({**both, **edges})) == pytest.approx(0.2)


def test_there_is_none_where_nothing_was_drawn_or_is_to_be_ranked() -> None:
    assert sampling_error(rows({"comm_budget": budget(None, 1.0)})) is None
    assert sampling_error(rows({"comm_budget": budget((0.1,), 1e-4)})) is None
    assert sampling_error(rows({"comm_budget": budget((0.0,), 1.0)})) == 0.0
