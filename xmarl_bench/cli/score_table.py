"""Tables of entries and of policies' performance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from xmarl_bench.board import ORDER, board_of
from xmarl_bench.cli.fitted_table import cell, print_tables
from xmarl_bench.cli.tables import Row
from xmarl_bench.counted import counted
from xmarl_bench.entry.schema import Entry
from xmarl_bench.metrics.table import OF_EXPLAINERS, Group, Metric, columns_of
from xmarl_bench.policy import PolicyCard

if TYPE_CHECKING:
    from xmarl_bench.explain.explainer import Explainer
    from xmarl_bench.rollout.evaluation import Performance

# Heading -> metric. The first is the order, and is shown with its interval.
SCORE_COLUMNS = {
    metric.short: metric.name for metric in columns_of(*OF_EXPLAINERS) if metric.short is not None
}


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
        cost, timesteps = entry.cost, counted(entry.cost.explained_timesteps, "timestep")
        print(
            f"{entry.policy.name}, {entry.explainer.name}: {timesteps} explained in "
            f"{cost.explain_seconds:.1f} s, rolled out in {cost.behaviour_seconds:.1f} s; "
            f"oracle and controls, once per policy, {cost.shared_seconds:.1f} s."
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
    by = metrics.get(ORDER["by"])
    interval = None if by is None else by["interval"]
    return {
        "explainer": row["explainer"] + (" (control)" if row["control"] else ""),
        order: _number(metrics.get(SCORE_COLUMNS[order])),
        "95 %": None if interval is None else "{:.2f} {:.2f}".format(*interval),
        **{heading: _number(metrics.get(SCORE_COLUMNS[heading])) for heading in others},
    }


def _number(summary: dict[str, Any] | None) -> str:
    if summary is None:
        return "-"
    text = "NaN" if summary["value"] is None else f"{summary['value']:.3f}"
    n_nan = summary.get("n_nan", 0)
    return text + (f" ({n_nan} NaN)" if n_nan and summary["value"] is not None else "")
