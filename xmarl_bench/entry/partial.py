"""Which scores are partial: valid, but of other states than the protocol asks for, and so not ranked."""

from __future__ import annotations

from xmarl_envs import TASKS

from xmarl_bench.entry.protocol import EPISODES, LARGER_TEAM, LARGER_TIMESTEPS
from xmarl_bench.entry.schema import CellResult, Protocol


def partial_reason(protocol: Protocol, cell: CellResult) -> str | None:
    """Why a cell's score is partial, a clause without a full stop; None if it is whole.

    Whole: EPISODES episodes of the task's own length and every timestep of each; in teams of LARGER_TEAM
    agents and more, where enumeration is expensive, at least LARGER_TIMESTEPS timesteps of each. The length
    of third-party tasks is not known here and not checked.
    """
    if protocol.episodes < EPISODES:
        return f"{protocol.episodes} of the protocol's {EPISODES} episodes"
    task = TASKS.get(cell.task)
    if task is not None and cell.max_cycles != task.default_max_cycles:
        return f"episodes of at most {cell.max_cycles} steps, the protocol's have {task.default_max_cycles}"
    least = LARGER_TIMESTEPS if cell.n_agents >= LARGER_TEAM else None
    if protocol.timesteps is not None and (least is None or protocol.timesteps < least):
        expected = "all" if least is None else f"at least {least}"
        return f"at most {protocol.timesteps} timesteps of each episode, the protocol takes {expected}"
    return None
