"""docs/scaling.md states the cost of the leaderboard's entries, and its options exist."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest
import typer

from xmarl_bench.cli.main import app

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "scaling.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_costs_are_those_of_the_entries() -> None:
    """If this fails, run docs/make_scaling.py."""
    made = runpy.run_path(str(ROOT / "docs" / "make_scaling.py"))
    assert made["page"](PAGE, made["measured"]()) == PAGE


def test_the_sum_is_that_of_the_table() -> None:
    summands, total = re.findall(r"the sum of the means, ([\d. +]+) = (\d+) s", PAGE)[0]
    assert sum(float(each) for each in summands.split("+")) == pytest.approx(float(total), abs=1)
    hours = float(re.findall(r"/ 3600 = ([\d,]+) core-hours", PAGE)[0].replace(",", ""))
    assert hours == pytest.approx(10_000 * float(total) / 3600, rel=0.02)


def test_every_option_it_names_exists() -> None:
    named = {
        (command, option)
        for command, line in re.findall(r"^(?:srun .*)?xmarl-bench (\w+)((?:.*\\\n)*.*)$", PAGE, re.MULTILINE)
        for option in re.findall(r"--[a-z-]+", line)
    }
    assert len(named) >= 5
    group = typer.main.get_command(app)
    for command, option in named:
        options = {each for parameter in group.commands[command].params for each in parameter.opts}  # type: ignore[attr-defined]
        assert option in options, (command, option)
