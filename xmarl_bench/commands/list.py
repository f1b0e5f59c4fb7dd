"""`xmarl-bench list`."""

from __future__ import annotations

from collections.abc import Sequence
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
    from xmarl_bench.errors import InputError

    failures: Sequence[InputError] = ()
    if kind is Kind.tasks:
        rows = report.tasks()
    elif kind is Kind.policies:
        rows, failures = report.policies()
    else:
        rows, failures = report.explainers()
    if as_json:
        report.print_json(rows)
    elif rows or not failures:
        report.print_rows(rows)
    if failures:  # one plugin that does not load hides no other
        raise InputError(" And ".join(map(str, failures)))
