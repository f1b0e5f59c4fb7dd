"""Writes the tables of docs/metrics.md that list every metric, from `xmarl_bench.metrics.table`.

    .venv/bin/python docs/make_metric_tables.py

Run it after a row of the table was changed; tests/docs/test_metrics_page.py fails until then.
"""

from __future__ import annotations

from pathlib import Path

from xmarl_bench.metrics import table
from xmarl_bench.metrics.table import Direction, Group, Metric

PAGE = Path(__file__).with_name("metrics.md")
BEGIN, END = "<!-- metrics:begin -->\n", "<!-- metrics:end -->"
BEST = {Direction.HIGHER: "high", Direction.LOWER: "low", Direction.NONE: ""}


def page(text: str) -> str:
    """The page with its tables replaced."""
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    return before + BEGIN + "\n".join(map(section, Group)) + END + after


def section(group: Group) -> str:
    lines = [
        f"**{group.value[:1].upper()}{group.value[1:]}**",
        "",
        "| name | metric | says | range | unit | best | needs |",
        "|---|---|---|---|---|---|---|",
        *map(row, table.metrics_of(group)),
    ]
    return "\n".join(lines) + "\n"


def row(metric: Metric) -> str:
    cells = (f"`{metric.name}`", metric.title, metric.meaning, metric.range.text, metric.unit)
    return "| " + " | ".join((*cells, BEST[metric.direction], ", ".join(metric.needs))) + " |"


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8", newline="\n")
