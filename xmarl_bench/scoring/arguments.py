"""Checks of what is asked for that need no network: they run before torch is imported."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from pydantic import TypeAdapter, ValidationError

from xmarl_bench.errors import InputError, unknown
from xmarl_bench.policy import PolicyCard
from xmarl_bench.records.field_types import Person
from xmarl_bench.records.strict_json import first_error, shown
from xmarl_bench.rollout.cell import Cell

ALL: Final = "all"


def check_behaviour_episodes(episodes: int | None) -> None:
    """Raise InputError if the number of episodes played on an explanation is invalid."""
    if episodes is not None and episodes < 0:
        raise InputError(f"behaviour_episodes must be at least 0, got {episodes}: give 0 to play none.")


def check_submitter(name: str | None) -> None:
    """Raise InputError if no entry could hold the name, before anything is scored."""
    if name is not None:
        try:
            TypeAdapter(Person).validate_python(name)
        except ValidationError as error:
            problem = first_error(error)[0].removeprefix("Value error, ")
            raise InputError(f"submitter {shown(name)} {problem}: give another name.") from None


def check_among(names: Sequence[str], explainers: Sequence[str]) -> None:
    """Raise InputError if a name is neither ALL nor an explainer of the run."""
    for name in names:
        if name != ALL and name not in explainers:
            raise unknown("explainer", name, [*explainers, ALL], "the explainers of this run")


def check_fit(card: PolicyCard, cell: Cell) -> None:
    """Raise InputError if the policy cannot act in the cell."""
    continuous = card.architecture.distribution != "categorical"
    task = cell.make().with_actions(continuous)
    if card.architecture.obs_dim != task.obs_dim:
        raise InputError(
            f"policy {card.name!r} takes observations of {card.architecture.obs_dim} entries, {cell.task} "
            f"gives {task.obs_dim}: choose a policy trained for {cell.task}."
        )
    if card.architecture.action_dim != task.action_width:
        entries = "action entries" if continuous else "actions to choose from"
        raise InputError(
            f"policy {card.name!r} has {card.architecture.action_dim} {entries}, {cell.task} takes "
            f"{task.action_width}: choose a policy trained for {cell.task}."
        )
    card.architecture.graph.check(cell.n_agents, task.obs_dim)
    if card.task != cell.task:
        raise InputError(
            f"policy {card.name!r} was trained for {card.task}, not for {cell.task}: "
            f"choose a policy trained for that task."
        )
