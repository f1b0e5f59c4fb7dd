"""Checks that the numbers of an entry are consistent, without a policy, an explainer or a rerun.

Each finding is one sentence with its place. A measured entry has none. An edited entry, even with a fitting
id, has some, unless every number that depends on the edited one was edited too; then
`xmarl_bench.submission.rerun` finds it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from xmarl_envs import TASKS

from xmarl_bench.entry.aggregation import BEHAVIOUR, BEHAVIOUR_UNDER, SANITY, sampling_error
from xmarl_bench.entry.metric_records import BudgetRow, EpisodeRow, Metrics
from xmarl_bench.entry.protocol import ABSENCE_EPISODES, SAMPLED, SANITY_EPISODES, definitions
from xmarl_bench.entry.schema import CellResult, Entry
from xmarl_bench.explain.control_names import SUMMARIES
from xmarl_bench.metrics.budgeted_fidelity import SMALLEST, Floats, budgeted_fidelity, over_absences
from xmarl_bench.metrics.table import OPTIONAL, OTHER_ABSENCES, UNDER_ABSENCES
from xmarl_bench.plugins.names import OURS, is_shipped
from xmarl_bench.records.strict_json import shown
from xmarl_bench.reproducible import episode_seeds
from xmarl_bench.submission.control_consistency import control_findings
from xmarl_bench.submission.recompute import Difference
from xmarl_bench.submission.rounding import ALIKE, CLOSE, close
from xmarl_bench.submission.tolerance import agrees

TOLD = ("success_rate", "success_gain", "no_agent_collision")  # our tasks tell these
CONTROLS_AT = "xmarl_bench.explain."  # where the code of controls is
BEHAVIOURAL = ("behavioural_fidelity", "success_on_explanation", "success_on_complement")
PREFIXES = ("", *(f"{absence}_" for absence in OTHER_ABSENCES))


def entry_findings(entry: Entry) -> Iterator[str]:
    """A sentence per finding; none if the entry is consistent."""
    protocol, seed = entry.protocol, entry.explainer.seed
    if protocol.definitions != _definitions(entry):
        yield f"protocol.definitions disagree with those of {protocol.id}."
    if list(protocol.seeds) != episode_seeds(seed, protocol.episodes):
        yield f"protocol.seeds disagree with seed {seed} and {protocol.episodes} episodes."
    explained = sum(row.timesteps for cell in entry.results for row in cell.episodes)
    if entry.cost.explained_timesteps != explained:
        yield f"cost.explained_timesteps is {entry.cost.explained_timesteps}, but the rows have {explained}."
    explainer = entry.explainer
    control = explainer.name in SUMMARIES and explainer.entry_point.startswith(CONTROLS_AT)
    if is_shipped(explainer.name) and explainer.distribution != OURS and not control:
        yield f"explainer.name is {explainer.name}, the name of one that {OURS} ships: rename yours."
    elif explainer.control and not control:
        yield f"explainer.control is true, but {explainer.name} is not a control of {OURS}."
    cells = [(cell.task, cell.n_agents) for cell in entry.results]
    if len(set(cells)) != len(cells):
        yield "results hold a cell twice."
    for k, cell in enumerate(entry.results):
        for finding in _cell_findings(entry, cell):
            yield f"results.{k} ({cell.task}, {cell.n_agents} agents): {finding}"


def _definitions(entry: Entry) -> dict[str, str]:
    """Those of the protocol; an entry need not define optional metrics that it lacks."""
    lacking = {name for name in OPTIONAL if all(lacks(cell, name) for cell in entry.results)}
    return {
        name: text
        for name, text in definitions(entry.policy.architecture.distribution).items()
        if name in entry.protocol.definitions or name not in lacking
    }


def lacks(cell: CellResult, name: str) -> bool:
    """Whether a cell has neither a value of a metric nor the reason why there is none."""
    return getattr(cell.metrics, name) is None and name not in cell.not_measured


def _cell_findings(entry: Entry, cell: CellResult) -> Iterator[str]:
    task = TASKS.get(cell.task)
    if task is None:
        yield f"the task {shown(cell.task)} is unknown."
        return
    if not 1 <= cell.n_agents <= task.max_agents:
        yield f"the task takes 1 to {task.max_agents} agents, got {cell.n_agents}."
    if entry.policy.task != cell.task:
        yield f"the policy was trained for {entry.policy.task}."
    untold = sorted(set(TOLD) & set(cell.not_measured))
    if untold:
        yield f"not_measured names {untold[0]}, which the task tells."
    if [row.seed for row in cell.episodes] != list(entry.protocol.seeds):
        yield f"episodes are not one for each of the {entry.protocol.episodes} seeds, in their order."
        return
    unknown = set(cell.not_measured) - set(Metrics.model_fields)
    if unknown:
        yield f"not_measured names {shown(min(unknown))}, which is not a metric."
    if (cell.behaviour_episodes == 0) != (BEHAVIOUR[0] in cell.not_measured):
        yield f"behaviour_episodes is {cell.behaviour_episodes}, which not_measured contradicts."
    under = cell.absence_behaviour_episodes
    if (under == 0) != (BEHAVIOUR_UNDER[0] in cell.not_measured):
        yield f"absence_behaviour_episodes is {under}, which not_measured contradicts."
    if under and under != min(cell.behaviour_episodes, ABSENCE_EPISODES):
        yield f"absence_behaviour_episodes is {under}, of {cell.behaviour_episodes} behaviour_episodes."
    if cell.behaviour_episodes > len(cell.episodes):
        yield f"behaviour_episodes is {cell.behaviour_episodes}, but there are {len(cell.episodes)} episodes."
    for k, row in enumerate(cell.episodes):
        for finding in _row_findings(entry, cell, row, k):
            yield f"episode {k}: {finding}"
    yield from _oracle_findings(cell)
    yield from control_findings(cell)


def _oracle_findings(cell: CellResult) -> Iterator[str]:
    """What an entry says of a sampled oracle must follow from its rows."""
    found, stated = sampling_error(cell.episodes), None if cell.oracle is None else cell.oracle.error
    if not agrees(Difference("oracle.error", stated, found), CLOSE):
        yield f"oracle.error is {stated}, by the budgets of the rows it is {found}."
    sampled = cell.oracle_kind == "sampled"
    if sampled and cell.oracle is not None and cell.oracle.definition != SAMPLED:
        yield "oracle.definition is not that of a sampled oracle."
    for k, row in enumerate(cell.episodes):
        for name in type(row).model_fields:
            budget = getattr(row, name)
            if isinstance(budget, BudgetRow) and (budget.random_error is not None) != (
                sampled and budget.random is not None
            ):
                yield f"episode {k}: {name}.random_error contradicts an oracle that is {cell.oracle_kind}."
                return


def _row_findings(entry: Entry, cell: CellResult, row: EpisodeRow, k: int) -> Iterator[str]:
    n = cell.n_agents
    most = entry.protocol.timesteps
    if row.length > cell.max_cycles:
        yield f"length {row.length} is more than max_cycles {cell.max_cycles}."
    if row.timesteps != (row.length if most is None else min(row.length, most)):
        yield f"timesteps {row.timesteps} disagree with the protocol for an episode of length {row.length}."
    if row.makespan != row.length:
        yield f"makespan {row.makespan} differs from the length {row.length}."
    for name in ("no_agent_collision", "no_object_collision"):
        if getattr(row, name) not in (0.0, 1.0, None):
            yield f"{name} is {getattr(row, name)}, neither 0 nor 1."
    if row.success_rate is not None and abs(row.success_rate * n - round(row.success_rate * n)) > CLOSE * n:
        yield f"success_rate {row.success_rate} is not a fraction of {n} agents."
    if row.attention_entropy is not None and row.attention_entropy > math.log(n) + ALIKE:
        yield f"attention_entropy {row.attention_entropy} is more than log {n}."
    if row.attention_distance is not None and row.attention_distance > n * n + ALIKE:
        yield f"attention_distance {row.attention_distance} is more than {n * n}."
    yield from _differences(row)
    for name in type(row).model_fields:
        budget = getattr(row, name)
        if isinstance(budget, BudgetRow):
            prefix = name.removesuffix("budget")
            yield from _budget_findings(row, prefix, budget, n - 1 if prefix else n)
    yield from _over_absences(row)
    absent = [name for name in cell.not_measured if getattr(row, name, None) is not None]
    for names, episodes in (
        (BEHAVIOUR, cell.behaviour_episodes),
        (BEHAVIOUR_UNDER, cell.absence_behaviour_episodes or 0),
        (SANITY, SANITY_EPISODES),
    ):
        if k >= episodes:
            absent += [name for name in names if getattr(row, name) is not None]
    if absent:
        yield f"{absent[0]} has a value but was not measured."


def _differences(row: EpisodeRow) -> Iterator[str]:
    for difference, more, less in (
        ("fid_delta", "fid_plus", "fid_minus"),
        ("comm_fid_delta", "comm_fid_plus", "comm_fid_minus"),
        *(tuple(prefix + name for name in BEHAVIOURAL) for prefix in PREFIXES),
    ):
        values = [getattr(row, name) for name in (difference, more, less)]
        if None not in values and not close(values[0], values[1] - values[2]):
            yield f"{difference} {values[0]} is not {more} - {less}."


def _over_absences(row: EpisodeRow) -> Iterator[str]:
    derived = over_absences([getattr(row, name) for name in UNDER_ABSENCES])
    for name, expected in zip(("message_fidelity", "smallest_message_fidelity"), derived, strict=True):
        value = getattr(row, name)
        if (value is None) is not math.isnan(expected) or (value is not None and not close(value, expected)):
            yield f"{name} is {value}, but its absence models give {expected}."


def _budget_findings(row: EpisodeRow, prefix: str, budget: BudgetRow, senders: int) -> Iterator[str]:
    """Findings if curves do not fit the team size, or disagree with the two numbers computed from them."""
    curves = [budget.explained, budget.random, budget.oracle, budget.random_error]
    if any(curve is not None and len(curve) != max(senders - 1, 0) for curve in curves):
        yield f"{prefix}budget is not for 1 to {senders - 1} edges."
        return
    x = [np.array(curve or (), dtype=np.float64) for curve in curves]
    top = getattr(row, f"{prefix}topk_fid_delta", None)  # under the absence model zero only
    budgeted = getattr(row, f"{prefix}budgeted_fidelity")
    if top is not None and not close(top, float(x[0].mean())):
        yield f"{prefix}topk_fid_delta {top} is not the mean of {prefix}budget.explained."
    if budgeted is not None and budget.random is not None and budget.oracle is not None:
        derived = budgeted_fidelity(x[0], x[1], x[2])
        if not close(budgeted, derived, _steepness(x[0], x[1], x[2])):
            yield f"{prefix}budgeted_fidelity is {budgeted}, but {prefix}budget gives {derived}."


def _steepness(explained: Floats, random: Floats, oracle: Floats) -> float:
    """By how much budgeted fidelity moves at most, for one that each number of a curve moves."""
    room = oracle - random
    steep = (room + np.abs(explained - random))[room >= SMALLEST] / room[room >= SMALLEST] ** 2
    return float(steep.max(initial=1.0))
