"""`xmarl-bench list`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import typer

from xmarl_bench.cli.options import AsJson


def list_(
    kind: Annotated[Literal["tasks", "policies", "explainers"], typer.Argument(help="What to list.")],
    as_json: AsJson = False,
) -> None:
    """List tasks, policies or explainers."""
    from xmarl_bench.cli import listings, tables
    from xmarl_bench.cli.fitted_table import print_table
    from xmarl_bench.errors import InputError

    failures: Sequence[InputError] = ()
    if kind == "tasks":
        rows = listings.tasks()
    elif kind == "policies":
        rows, failures = listings.policies()
    else:
        rows = listings.explainers()
    if as_json:
        tables.print_json(rows)
    elif rows or not failures:
        print_table(rows, keep=("summary", "kind", "success"))
    if failures:  # after the rows: a plugin that fails to load does not hide others
        raise InputError(" And ".join(map(str, failures)))
