"""From names to requests: selects the policies, explainers and cells of a command."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from xmarl_bench.errors import InputError, unknown
from xmarl_bench.explain.controls import CONTROLS
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.plugins.registry import (
    explainer_names,
    find_explainer,
    open_policy,
    registered_policies,
)
from xmarl_bench.policy import Policy, PolicyCard, load_policy
from xmarl_bench.policy.bundle import load_card
from xmarl_bench.policy.default_policies import default_policies, is_checkpoint
from xmarl_bench.rollout.cell import Cell, Sampling
from xmarl_bench.scoring.request import Request, check_fit
from xmarl_bench.tasks.sources import open_task

ALL, FINISHED, DEFAULT = "all", "finished", "default"
Opened = tuple[Policy, PolicyCard]


@dataclass(frozen=True)
class Installed:
    """A policy of which only the card was read."""

    card: PolicyCard
    open: Callable[[], Opened]


def select_policies(
    names: Sequence[str],
    tasks: Sequence[str],
    agents: Sequence[str],
    teams: Sequence[int] = (),
    *,
    trust_code: bool = False,
) -> list[tuple[Policy, PolicyCard, tuple[Cell, ...]]]:
    """The policies to run, each with its cells.

    `all`: the policies trained for one of the given tasks and team sizes; those with their own code only with
    `trust_code`. `finished`: the same without checkpoints along training. The name of a family: the finished
    ones that belong to it. `default`: the best seed of each cell, of DEFAULT_FAMILY if the cell has one. A
    policy given by name, bundle or module:factory runs with every given team size, or its own for `all`.

    teams: team sizes to run the chosen policies with, in place of those they were trained for.
    """
    sizes = _sizes(agents)
    wanted_tasks = [open_task(task, trust_code=trust_code).name for task in tasks if task != ALL]
    any_task = ALL in tasks
    meant = _meant(names, trust_code)
    if meant is not None:
        chosen = {
            name: each.open
            for name, each in meant.items()
            if (any_task or each.card.task in wanted_tasks) and (sizes is None or each.card.n_agents in sizes)
        }
        if not chosen:
            tasks_asked = "any task" if any_task else " or ".join(wanted_tasks)
            sizes_asked = "any number of" if sizes is None else " or ".join(map(str, sizes))
            raise InputError(
                f"no policy is installed for {tasks_asked} with {sizes_asked} agents: "
                f"see `xmarl-bench list policies`, or give the folder of a policy bundle."
            )
        sizes = None
    else:
        chosen = {name: partial(open_policy, name, trust_code=trust_code) for name in names}
    selected: list[tuple[Policy, PolicyCard, tuple[Cell, ...]]] = []
    for name, open_it in chosen.items():
        policy, card = open_it()
        open_task(card.task, trust_code=trust_code)
        # Names of policies are unique in a run, because files of entries are named by them.
        if any(card.name == other.name for _, other, _ in selected):
            raise InputError(
                f"two policies are named {card.name!r} ({name} is one): rename one, or leave it out."
            )
        cells = tuple(Cell(card.task, n) for n in (dict.fromkeys(teams) or sizes or [card.n_agents]))
        if not any_task and card.task not in wanted_tasks:
            check_fit(card, Cell(wanted_tasks[0], cells[0].n_agents))  # raises the reason
        for cell in cells:
            check_fit(card, cell)
        selected.append((policy, card, cells))
    return selected


def _meant(names: Sequence[str], trust_code: bool) -> dict[str, Installed] | None:
    """The policies meant by `all`, `finished`, `default` or a family, by name; None without such a word."""
    installed, failures = registered_policies()
    if not set(names) - set(installed):
        return None
    found: dict[str, Installed] = {}
    for name, place in installed.items():
        if isinstance(place, Path):
            try:
                card = load_card(place)
            except InputError as error:
                failures.append(error)
            else:
                found[name] = Installed(card, partial(load_policy, place, card))
    words = {ALL, FINISHED, DEFAULT, *(each.card.family for each in found.values())} & set(names)
    if not words:
        return None
    if failures:  # the policy that failed may be meant
        raise failures[0]
    if trust_code:
        for name, place in installed.items():
            if not isinstance(place, Path):
                opened = place.open(name)
                found[name] = Installed(opened[1], partial(_already, opened))
    if ALL in words:
        return found
    finished = {name: each for name, each in found.items() if not is_checkpoint(each.card)}
    cards_of_them = [each.card for each in finished.values()]
    best = {card.name for card in default_policies(cards_of_them)} if DEFAULT in words else set()
    return {
        name: each
        for name, each in finished.items()
        if FINISHED in words or each.card.family in words or each.card.name in best
    }


def _already(opened: Opened) -> Opened:
    return opened


def select_explainers(names: Sequence[str]) -> list[Explainer]:
    """Explainers by name; `all` omits controls, because every entry contains them."""
    everything = [name for name in explainer_names() if name not in CONTROLS]
    return [find_explainer(name) for name in (everything if ALL in names else dict.fromkeys(names))]


def plan(
    policies: Sequence[tuple[Policy, PolicyCard, tuple[Cell, ...]]],
    explainers: Sequence[Explainer],
    sampling: Sampling,
    slow: Sampling | None = None,
    *,
    behaviour_episodes: int | None = None,
    no_behaviour: Sequence[str] = (),
) -> list[Request]:
    """One request per policy and explainer.

    slow: the sampling of explainers that declare themselves slow. If the run has one, the others are scored
    on it as well as on `sampling`, because entries are compared on the same states only.
    behaviour_episodes: see `Request.behaviour_episodes`. no_behaviour: names of explainers with none of
    these, or ALL. Raises InputError if such a name is not an explainer of the run.
    """
    names = [explainer.name for explainer in explainers]
    for name in no_behaviour:
        if name != ALL and name not in names:
            raise unknown("explainer", name, [*names, ALL], "the explainers of this run")
    any_slow = slow is not None and slow != sampling and any(explainer.slow for explainer in explainers)
    requests = []
    for policy, card, cells in policies:
        for explainer in explainers:
            samplings = [sampling]
            if any_slow and slow is not None:
                samplings = [slow] if explainer.slow else [sampling, slow]
            none = ALL in no_behaviour or explainer.name in no_behaviour
            played = 0 if none else behaviour_episodes
            requests += [Request(policy, card, explainer, cells, each, played) for each in samplings]
    return requests


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
