"""docs/metrics.md lists the metrics of the table, and explains every control."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

from xmarl_bench.explain.controls import CONTROLS, INITIAL_ATTENTION, INVERTED, NEAREST

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
