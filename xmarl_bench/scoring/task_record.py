"""The record of a task that is not of xmarl_envs, for entries and for the keys of pieces."""

from __future__ import annotations

from dataclasses import asdict

from xmarl_bench.entry.schema import TaskRecord
from xmarl_bench.isolation.tasks import AskedSource
from xmarl_bench.rollout.cell import Cell


def task_record(cell: Cell) -> TaskRecord | None:
    """Where the task's code came from; None for a task of xmarl_envs."""
    origin = cell.source.origin
    if origin is None:
        return None
    environment = cell.source.environment(cell.n_agents)
    return TaskRecord(
        **asdict(origin),
        environment=environment.entry_point,
        environment_distribution=environment.distribution,
        environment_version=environment.version,
        isolated=None if isinstance(cell.source, AskedSource) else False,
    )
