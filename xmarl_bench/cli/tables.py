"""Tables for a terminal or a README. `--json` prints the same rows."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

from xmarl_envs import TASKS

from xmarl_bench.board import ORDER, board_of
from xmarl_bench.cli.fitted_table import cell, print_tables
from xmarl_bench.counted import counted
from xmarl_bench.entry.schema import Entry
from xmarl_bench.errors import InputError
from xmarl_bench.explain.adapters import origin_of_explainer
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.metrics.table import OF_EXPLAINERS, SUCCESS, Group, Metric, columns_of
from xmarl_bench.plugins.registry import explainer_names, find_explainer, registered_policies
from xmarl_bench.policy import PolicyCard
from xmarl_bench.policy.bundle import load_card
from xmarl_bench.rollout.evaluation import Performance
from xmarl_bench.scoring.run_record import Progress, RunRecord
from xmarl_bench.scoring.score import Failed
from xmarl_bench.tasks.sources import task_plugins

Row = dict[str, Any]
Outcome = TypeVar("Outcome")
_POLICY_COLUMNS = ("name", "task", "n_agents", "attention_entropy", "training_seed", "success", "code")
# Heading -> metric. The first is the order, and is shown with its interval.
SCORE_COLUMNS = {
    metric.short: metric.name for metric in columns_of(*OF_EXPLAINERS) if metric.short is not None
}


def tasks() -> list[Row]:
    """`code` is the entry point of another package's task. It is not run to be listed: the rest is None."""
    ours = [
        {
            "name": name,
            "max_agents": task.max_agents,
            "obs_dim": len(task.observation_names),
            "max_cycles": task.default_max_cycles,
            "code": None,
        }
        for name, task in TASKS.items()
    ]
    others = [
        {**dict.fromkeys(ours[0]), "name": name, "code": each.value} for name, each in task_plugins().items()
    ]
    return ours + others


def policies() -> tuple[list[Row], list[InputError]]:
    """Policies of the plugins that load, and the errors of the others.

    `success` is the success rate in the card, None without one. `code` is the entry point of a policy with
    its own code. Listing does not run the code, so its other columns are None.
    """
    found, failures = registered_policies()
    rows: list[Row] = []
    for name, place in found.items():
        if not isinstance(place, Path):
            rows.append({**dict.fromkeys(_POLICY_COLUMNS), "name": name, "code": str(place)})
            continue
        try:
            card = load_card(place)
        except InputError as error:
            failures.append(error)
            continue
        measured = card.performance.get("with_messages", {})
        rows.append(
            {
                "name": name,
                "task": card.task,
                "n_agents": card.n_agents,
                "attention_entropy": card.attention_entropy,
                "training_seed": card.training_seed,
                "success": measured.get(SUCCESS) if isinstance(measured, dict) else None,
                "code": None,
            }
        )
    return rows, failures


def explainers() -> tuple[list[Row], list[InputError]]:
    """Explainers that load, and the errors of the others."""
    rows: list[Row] = []
    failures = []
    for name in explainer_names():
        try:
            each = find_explainer(name)
        except InputError as error:
            failures.append(error)
            continue
        origin = origin_of_explainer(each)
        rows.append(
            {
                "name": each.name,
                "kind": "control" if each.control else "explainer",
                "stochastic": each.stochastic,
                "slow": each.slow,
                "absence": each.absence,
                "distribution": origin.distribution,
                "version": origin.version,
                "summary": each.summary,
            }
        )
    return rows, failures


def performance_rows(cards: Sequence[PolicyCard], performances: Sequence[Performance]) -> list[Row]:
    """One row per policy and cell; "a / b" is with messages between agents / without."""
    rows = []
    for card, each in zip(cards, performances, strict=True):

        def both(metric: Metric, each: Performance = each) -> str:
            values = (each.with_messages[metric.name], each.without_messages[metric.name])
            return " / ".join("-" if value is None else f"{value:.{metric.digits}f}" for value in values)

        rows.append(
            {
                "policy": card.name,
                "task": each.task,
                "agents": each.n_agents,
                "lambda": card.attention_entropy,
                **{metric.short or metric.title: both(metric) for metric in columns_of(Group.TASK)},
                "messages help": cell(each.messages_help),
                "attention entropy": "-"
                if each.attention_entropy is None
                else f"{each.attention_entropy:.2f}",
            }
        )
    return rows


def markdown(rows: Sequence[Row]) -> str:
    if not rows:
        return ""
    lines = [
        list(rows[0]),
        ["---"] * len(rows[0]),
        *([cell(value) for value in row.values()] for row in rows),
    ]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def print_scores(entries: Sequence[Entry], used: Sequence[Explainer]) -> None:
    """A table per policy, in the board's order, then costs and a note on slow explainers' fewer states."""
    board = board_of([(entry.file_name, entry) for entry in entries])
    shown: list[tuple[str | None, list[Row]]] = []
    for table in board["tables"]:
        protocol = board["protocols"][table["protocol"]]
        timesteps = protocol["timesteps"]
        steps = "every timestep" if timesteps is None else f"{counted(timesteps, 'timestep')} of each"
        episodes = counted(protocol["episodes"], "episode")
        states = f"{table['task']}, {counted(table['n_agents'], 'agent')}: {episodes}, {steps}"
        if table["oracle"] == "sampled":
            states += ", oracle sampled"
        for group in table["policies"]:
            trained = group["trained_n_agents"]
            zero_shot = "" if trained == table["n_agents"] else f", trained with {counted(trained, 'agent')}"
            gate = "" if group["gate"] is None else f"\nnot ranked: {group['gate']}"
            title = f"{group['name']}{zero_shot}\n{states}{gate}"
            shown.append((title, [_score_row(row) for row in group["rows"]]))
    print_tables(shown)
    print("index.html and the entries have all metrics.")
    for entry in entries:
        cost, timesteps = entry.cost, entry.cost.explained_timesteps
        print(
            f"{entry.policy.name}, {entry.explainer.name}: {counted(timesteps, 'timestep')} explained in "
            f"{cost.explain_seconds_per_timestep * timesteps:.1f} s, rolled out in "
            f"{cost.behaviour_seconds:.1f} s; oracle and controls, once per policy, "
            f"{cost.shared_seconds_per_timestep * timesteps:.1f} s."
        )
    slow = [explainer.name for explainer in used if explainer.slow]
    limited = [entry.protocol for entry in entries if entry.explainer.name in slow]
    if limited and any(entry.protocol != limited[0] for entry in entries):
        few = limited[0]
        steps = "" if few.timesteps is None else f", at most {counted(few.timesteps, 'timestep')} of each"
        print(
            f"Slow explainers ({', '.join(slow)}) had fewer states: "
            f"{counted(few.episodes, 'episode')}{steps}."
            f" The others were scored on these, for comparison, and on all states."
        )


def _score_row(row: dict[str, Any]) -> Row:
    order, *others = SCORE_COLUMNS
    metrics = row["metrics"]
    by = metrics[ORDER["by"]]
    interval = None if by is None else by["interval"]
    return {
        "explainer": row["explainer"] + (" (control)" if row["control"] else ""),
        order: _number(metrics[SCORE_COLUMNS[order]]),
        "95 %": None if interval is None else "{:.2f} {:.2f}".format(*interval),
        **{heading: _number(metrics[SCORE_COLUMNS[heading]]) for heading in others},
    }


def _number(summary: dict[str, Any] | None) -> str:
    if summary is None:
        return "-"
    text = "NaN" if summary["value"] is None else f"{summary['value']:.3f}"
    return text + (f" ({summary['n_nan']} NaN)" if summary["n_nan"] and summary["value"] is not None else "")


def print_json(value: Any) -> None:
    print(json.dumps(value, indent=2, allow_nan=False))


def log_progress(outcomes: Iterator[Outcome], total: int, every: float = 20.0) -> Iterator[Outcome]:
    """Yield the outcomes. Without a terminal, print a line on stderr about every so many seconds."""
    started = last = time.monotonic()
    for done, outcome in enumerate(outcomes, start=1):
        now = time.monotonic()
        if now - last > every and not sys.stderr.isatty():
            last, minutes = now, (now - started) / 60
            print(f"{done} of {total} scored after {minutes:.1f} min.", file=sys.stderr, flush=True)
        yield outcome


def exit_for_failures(failed: Sequence[Failed], total: int) -> None:
    """If something failed, print it on stderr and exit with code 1.

    Raises InputError with the first error if everything failed.
    """
    if not failed:
        return
    if len(failed) == total:
        raise InputError(failed[0].error)
    for each in failed:
        print(f"failed: {each}", file=sys.stderr)
    print(
        f"{len(failed)} of {total} failed; everything else is done. The same command tries them again.",
        file=sys.stderr,
    )
    raise SystemExit(1)


def run_rows(records: Sequence[tuple[RunRecord, Progress]]) -> list[Row]:
    """The progress of runs, for `xmarl-bench status`."""
    states = {True: "running", False: "stopped", None: "on another machine"}
    return [
        {
            "folder": record.out,
            "command": record.command,
            "started": record.started,
            "state": "finished" if progress.done == progress.pieces else states[progress.running],
            "pieces": [progress.done, progress.pieces],
            "entries": [progress.entries, len(record.asked)],
            "explainers": {name: list(counts) for name, counts in progress.explainers.items()},
            "failures": sorted(set(progress.failures.values())),
        }
        for record, progress in records
    ]


def print_runs(rows: Sequence[Row]) -> None:
    for row in rows:
        (done, pieces), (complete, entries) = row["pieces"], row["entries"]
        print(
            f"{row['folder']}: {row['state']}, {done} of {counted(pieces, 'piece')}, "
            f"{complete} of {counted(entries, 'entry')}."
        )
        print(f"  {row['command']} ({row['started']})")
        for name, (done, pieces) in row["explainers"].items():
            if done < pieces:
                print(f"  {name}: {done} of {pieces}")
        for failure in row["failures"]:
            print(f"  failed: {failure.splitlines()[0]}")
