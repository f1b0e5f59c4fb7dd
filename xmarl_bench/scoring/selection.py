"""Selects the policies, explainers and cells of a command by their names.

Policies are chosen by their cards, before any network is built, so that a wrong argument does not wait for
torch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from xmarl_bench.errors import InputError
from xmarl_bench.explain.control_names import SUMMARIES as CONTROL_NAMES
from xmarl_bench.isolation.conversation import Isolation
from xmarl_bench.isolation.tasks import ask_task
from xmarl_bench.origin.references import check_named, check_reference, is_reference
from xmarl_bench.plugins.names import explainer_names, explainer_plugin, place_of, registered_policies
from xmarl_bench.policy import PolicyCard, load_policy
from xmarl_bench.policy.card import load_card
from xmarl_bench.policy.default_policies import default_policies, is_checkpoint
from xmarl_bench.rollout.cell import Cell
from xmarl_bench.scoring.arguments import ALL, check_fit

if TYPE_CHECKING:
    from xmarl_bench.explain.explainer import Explainer
    from xmarl_bench.isolation.limits import Limits
    from xmarl_bench.policy import Policy

    Opened = tuple[Policy, PolicyCard]

FINISHED, DEFAULT = "finished", "default"


@dataclass(frozen=True)
class Chosen:
    """A policy of which only the card was read, and its cells in the run."""

    card: PolicyCard
    opened: Callable[[], Opened]
    cells: tuple[Cell, ...] = ()

    def open(self) -> tuple[Policy, PolicyCard, tuple[Cell, ...]]:
        """Build its network."""
        return *self.opened(), self.cells


def select_policies(
    names: Sequence[str],
    tasks: Sequence[str],
    agents: Sequence[str],
    teams: Sequence[int] = (),
    *,
    trust_code: bool = False,
    limits: Limits | None = None,
) -> list[tuple[Policy, PolicyCard, tuple[Cell, ...]]]:
    """The policies that `choose_policies` chooses, opened. Raises the first of its errors."""
    chosen, failures = choose_policies(names, tasks, agents, teams, trust_code=trust_code, limits=limits)
    if failures:
        raise failures[0]
    return [each.open() for each in chosen]


def choose_policies(
    names: Sequence[str],
    tasks: Sequence[str],
    agents: Sequence[str],
    teams: Sequence[int] = (),
    *,
    trust_code: bool = False,
    limits: Limits | None = None,
) -> tuple[list[Chosen], list[InputError]]:
    """The policies to run, each with its cells, and the errors of those whose code fails.

    Runs only code of policies that have their own. limits: of its processes; None: it runs in this process.

    `all`: the policies trained for one of the given tasks and team sizes; those with their own code only with
    `trust_code`. `finished`: the same without checkpoints along training. The name of a family: the finished
    ones that belong to it. `default`: the best seed of each cell, of DEFAULT_FAMILY if the cell has one. A
    policy given by name, bundle or module:factory, also beside these, runs with every given team size, or its
    own for `all`.

    teams: team sizes to run the chosen policies with, in place of those they were trained for. Raises
    InputError if the code of every policy fails.
    """
    failures = list[InputError]()

    def code(name: str) -> dict[str, Chosen]:
        """A policy that is code, which makes its card as it runs; nothing if that fails."""
        from xmarl_bench.plugins.registry import ask_policy  # imports torch

        try:
            opened = ask_policy(name, isolation, trust_code=True)
        except InputError as error:
            failures.append(error)
            return {}
        return {name: Chosen(opened[1], lambda: opened)}

    sizes = _sizes(agents)
    isolation = None if limits is None else Isolation(limits)
    wanted_tasks = [ask_task(task, isolation, trust_code=trust_code).name for task in tasks if task != ALL]
    any_task = ALL in tasks
    words, meant = _meant(names, code if trust_code else None)
    chosen = {
        name: each
        for name, each in meant.items()
        if (any_task or each.card.task in wanted_tasks) and (sizes is None or each.card.n_agents in sizes)
    }
    own_size = set(chosen) - set(names)  # policies that run with the team size that they were trained for
    if words and not chosen:
        tasks_asked = "any task" if any_task else " or ".join(wanted_tasks)
        sizes_asked = "any number of" if sizes is None else " or ".join(map(str, sizes))
        raise InputError(
            f"no policy is installed for {tasks_asked} with {sizes_asked} agents: "
            f"see `xmarl-bench list policies`, or give the folder of a policy bundle."
        )
    for name in names:
        if name not in words and name not in chosen:
            place = place_of(name, trust_code=trust_code)
            chosen |= _bundled(name, place) if isinstance(place, Path) else code(name)
    if failures and not chosen:
        raise failures[0]
    selected: list[Chosen] = []
    for name, policy in chosen.items():
        card = policy.card
        ask_task(card.task, isolation, trust_code=trust_code)
        # Names of policies are unique in a run, because files of entries are named by them.
        if any(card.name == other.card.name for other in selected):
            raise InputError(
                f"two policies are named {card.name!r} ({name} is one): rename one, or leave it out."
            )
        asked = dict.fromkeys(teams) or (None if name in own_size else sizes) or [card.n_agents]
        cells = tuple(Cell(card.task, n) for n in asked)
        if not any_task and card.task not in wanted_tasks:
            check_fit(card, Cell(wanted_tasks[0], cells[0].n_agents))  # raises the reason
        for cell in cells:
            check_fit(card, cell)
        selected.append(replace(policy, cells=cells))
    return selected, failures


def _meant(
    names: Sequence[str], code: Callable[[str], dict[str, Chosen]] | None
) -> tuple[set[str], dict[str, Chosen]]:
    """The words `all`, `finished`, `default` and families among the names, and the policies that they mean.

    code: opens policies that are code; None: leaves them out.
    """
    installed, failures = registered_policies()
    if not set(names) - set(installed):
        return set(), {}
    found: dict[str, Chosen] = {}
    for name, place in installed.items():
        if isinstance(place, Path):
            try:
                found |= _bundled(name, place)
            except InputError as error:
                failures.append(error)
    families = {each.card.family for each in found.values()}
    words = {name for name in names if name in {ALL, FINISHED, DEFAULT, *families}}
    if not words:
        return set(), {}
    if failures:  # the policy that failed may be meant
        raise failures[0]
    if code is not None:
        for name, place in installed.items():
            if not isinstance(place, Path):
                found |= code(name)
    if ALL in words:
        return words, found
    finished = {name: each for name, each in found.items() if not is_checkpoint(each.card)}
    cards_of_them = [each.card for each in finished.values()]
    best = {card.name for card in default_policies(cards_of_them)} if DEFAULT in words else set()
    return words, {
        name: each
        for name, each in finished.items()
        if FINISHED in words or each.card.family in words or each.card.name in best
    }


def _bundled(name: str, place: Path) -> dict[str, Chosen]:
    card = load_card(place)
    return {name: Chosen(card, partial(load_policy, place, card))}


def explainers_meant(names: Sequence[str]) -> list[str]:
    """The explainers meant, each once; `all` omits controls, because every entry contains them.

    Loads nothing. Raises InputError for an unknown name, and for a file that cannot be read.
    """
    meant: list[str] = []
    for name in names:
        if name == ALL:
            meant += [each for each in explainer_names() if each not in CONTROL_NAMES]
            continue
        check_named(name)
        if is_reference(name):
            check_reference(name)
        elif name not in CONTROL_NAMES:
            explainer_plugin(name)
        meant.append(name)
    return list(dict.fromkeys(meant))


def select_explainers(
    names: Sequence[str], limits: Limits | None = None
) -> tuple[list[Explainer], list[InputError]]:
    """The explainers that `explainers_meant` means, loaded, and the errors of those that do not load.

    limits: of the processes of explainers that are not shipped; None: all run in this process. Raises
    InputError if none loads.
    """
    from xmarl_bench.plugins.registry import ask_explainer  # imports torch

    isolation = None if limits is None else Isolation(limits)
    found: list[Explainer] = []
    failures: list[InputError] = []
    for name in explainers_meant(names):
        try:
            found.append(ask_explainer(name, isolation))
        except InputError as error:
            failures.append(error)
    if failures and not found:
        raise failures[0]
    return found, failures


def _sizes(agents: Sequence[str]) -> list[int] | None:
    """Team sizes asked for, None for each policy's own."""
    if ALL in agents:
        return None
    try:
        return [int(text) for text in dict.fromkeys(agents)]
    except ValueError:
        raise InputError(
            f"agents must be numbers or {ALL!r}, got {', '.join(agents)}: give team sizes, or {ALL!r}."
        ) from None
