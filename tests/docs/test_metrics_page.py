"""docs/metrics.md lists the metrics of the table, and explains every control."""

from __future__ import annotations

import json
import re
import runpy
from pathlib import Path

from tests.helpers.policies import small_policy
from xmarl_bench.board.agreement import scores_of_board
from xmarl_bench.explain.control_names import INITIAL_ATTENTION, INVERTED, NEAREST
from xmarl_bench.explain.controls import CONTROLS
from xmarl_bench.meta.curves import METRICS
from xmarl_bench.meta.degenerate import kinds_of
from xmarl_bench.metrics.table import by_name

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "metrics.md").read_text(encoding="utf-8")


def test_its_tables_equal_the_table_of_metrics() -> None:
    """If this fails, run docs/make_metric_tables.py."""
    assert runpy.run_path(str(DOCS / "make_metric_tables.py"))["page"](PAGE) == PAGE


def test_it_explains_every_control() -> None:
    named = set(re.findall(r"`([\w-]+)`", PAGE))
    assert {*CONTROLS, NEAREST, INITIAL_ATTENTION, INVERTED} <= named
    assert "(metrics.png)" in PAGE
    assert (DOCS / "metrics.png").is_file()


def test_its_tables_of_tested_metrics_are_whole() -> None:
    """Otherwise run docs/make_meta.py: a row for each metric of a mask, and each kind of explanation."""
    for name, rows in (("followed", METRICS), ("degenerate", [*kinds_of(small_policy(6))])):
        written = PAGE.split(f"<!-- {name}:begin -->\n")[1].split(f"<!-- {name}:end -->")[0]
        table = [line for line in written.splitlines() if line.startswith("|")]
        titles = [by_name()[each].title if each in by_name() else each for each in rows]
        assert [line.split(" | ")[0].removeprefix("| ") for line in table[2:]] == titles
    for picture in ("degradation.png", "agreement.png"):
        assert f"({picture})" in PAGE
        assert (DOCS / picture).is_file()


def test_the_board_has_the_metrics_whose_orders_are_compared() -> None:
    board = json.loads((DOCS.parent / "leaderboard" / "leaderboard.json").read_bytes())
    measured = {
        name
        for explainers in scores_of_board(board["tables"])
        for scores in explainers.values()
        for name, value in scores.items()
        if value is not None
    }
    assert measured >= set(runpy.run_path(str(DOCS / "make_meta.py"))["COMPARED"])
