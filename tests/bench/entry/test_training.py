"""Policies whose trainings share a start have one training; nothing else does."""

from __future__ import annotations

import pytest

from tests.helpers.made_entries import made_entry
from xmarl_bench.entry.training import training_of


def training(name: str = "p", seed: int | None = 0, **changes: object) -> str:
    return training_of(made_entry(name, "attention", 0.5, training_seed=seed, **changes).policy)  # type: ignore[arg-type]


def test_the_entropy_term_sets_in_later() -> None:
    assert training("without") == training("with", attention_entropy=0.1)


@pytest.mark.parametrize(
    "changes", [{"seed": 1}, {"n_agents": 4, "trained": 4}, {"task": "blind_passage_v0"}, {"residual": True}]
)
def test_other_seeds_teams_tasks_and_networks_are_other_trainings(changes: dict[str, object]) -> None:
    assert training() != training(**changes)  # type: ignore[arg-type]


def test_without_a_seed_every_policy_is_a_training_of_its_own() -> None:
    assert training("one", None) != training("other", None)
    assert training("one", None) == training("one", None)
