"""Selects the team to draw: a policy, or a team without one."""

from __future__ import annotations

from xmarl_bench.errors import InputError
from xmarl_bench.policy import Policy
from xmarl_bench.render.recording import TEAMS
from xmarl_bench.rollout.cell import Cell
from xmarl_bench.scoring.arguments import ALL
from xmarl_bench.scoring.selection import select_policies
from xmarl_bench.tasks.sources import open_task, task_names

MOST_NAMED = 3


def select_team(
    policy: str, task: str | None, agents: int | None, *, trust_code: bool = False
) -> tuple[Policy | None, str, Cell]:
    """A policy (None for teams without one), its name and its cell. task, agents: None: the policy's own.

    Raises InputError if the task is not known, for unknown names and for cells that do not fit.
    """
    if policy in TEAMS:
        if task is None:
            raise InputError(
                f"the team {policy!r} plays any task: choose one of {', '.join(task_names())}, or choose a "
                f"policy."
            )
        return (
            None,
            policy,
            Cell(open_task(task, trust_code=trust_code).name, 3 if agents is None else agents),
        )
    sizes = [ALL if agents is None else str(agents)]
    found = select_policies([policy], [task or ALL], sizes, trust_code=trust_code)
    chosen = [(network, card.name, cell) for network, card, cells in found for cell in cells]
    if len(chosen) != 1:
        names = ", ".join(name for _, name, _ in chosen[:MOST_NAMED])
        raise InputError(f"{policy!r} is {len(chosen)} policies ({names}, ...): choose one of them by name.")
    return chosen[0]
