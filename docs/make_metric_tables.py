"""Writes the tables of docs/metrics.md that list every metric, from `xmarl_bench.metrics.table`.

    .venv/bin/python docs/make_metric_tables.py

Run it after a row of the table was changed; tests/docs/test_metrics_page.py fails until then.
"""

from __future__ import annotations

from pathlib import Path

from xmarl_bench.metrics.table import Direction, Group, metrics_of
from xmarl_bench.records.markdown import markdown_table, rewrite, with_part

PAGE = Path(__file__).with_name("metrics.md")
BEST = {Direction.HIGHER: "high", Direction.LOWER: "low", Direction.NONE: ""}


def page(text: str) -> str:
    """The page with its tables replaced."""
    return with_part(text, "metrics", "\n".join(map(section, Group)))


def section(group: Group) -> str:
    header = "name", "metric", "says", "range", "unit", "best", "needs"
    rows = [
        (f"`{each.name}`", each.title, each.meaning, each.range.text, each.unit, BEST[each.direction],
         ", ".join(each.needs))
        for each in metrics_of(group)
    ]  # fmt: skip
    return f"**{group.value[:1].upper()}{group.value[1:]}**\n\n{markdown_table(header, rows)}"


if __name__ == "__main__":
    rewrite(PAGE, page)
