"""`xmarl-bench list`."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from xmarl_bench.commands.options import AsJson


class Kind(StrEnum):
    tasks = "tasks"
    policies = "policies"
    explainers = "explainers"


def list_(kind: Annotated[Kind, typer.Argument(help="What to list.")], as_json: AsJson = False) -> None:
    """List tasks, policies or explainers."""
    from xmarl_bench import report

    rows = {Kind.tasks: report.tasks, Kind.policies: report.policies, Kind.explainers: report.explainers}[
        kind
    ]()
    if as_json:
        report.print_json(rows)
    else:
        report.print_rows(rows)
