"""The command that reproduces an entry."""

from __future__ import annotations

import shlex

from xmarl_envs import TASKS

from xmarl_bench.entry.schema import Entry


def command_of(entry: Entry, out: str = "again") -> str:
    """`xmarl-bench score ...`, for a shell. With the same versions, the new entry has the same `entry_id`."""
    explainer, protocol = entry.explainer, entry.protocol
    named = explainer.entry_point if explainer.distribution is None else explainer.name  # not installed
    words = ["xmarl-bench", "score", "--policy", entry.policy.name, "--explainer", named]
    for cell in entry.results:
        words += ["--task", _task_of(entry, cell.task), "--agents", str(cell.n_agents)]
    words += ["--episodes", str(protocol.episodes), "--seed", str(explainer.seed)]
    if protocol.timesteps is not None:
        words += ["--timesteps", str(protocol.timesteps)]
    cycles = {cell.max_cycles for cell in entry.results}
    defaults = {TASKS[cell.task].default_max_cycles for cell in entry.results if cell.task in TASKS}
    if cycles != defaults:
        words += ["--max-cycles", str(entry.results[0].max_cycles)]
    played = {cell.behaviour_episodes for cell in entry.results}
    if played == {0}:
        words += ["--no-behaviour", explainer.name]
    else:
        words += ["--behaviour-episodes", str(max(played))]
    if entry.policy.trusted_code or protocol.tasks:
        words.append("--trust-code")
    of_tasks = (task.isolated for task in (protocol.tasks or {}).values())
    if False in (explainer.isolated, entry.policy.isolated, *of_tasks):
        words.append("--no-isolate")
    if entry.submitter is not None:
        words += ["--submitter", entry.submitter]
    return shlex.join([*words, "--out", out])


def _task_of(entry: Entry, task: str) -> str:
    """The name of a task; the reference of one that no entry point names."""
    record = (entry.protocol.tasks or {}).get(task)
    if record is None or (record.distribution is not None and record.entry_point.rpartition(":")[2] != task):
        return task
    return record.entry_point
