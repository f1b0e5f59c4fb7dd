"""`xmarl-bench status`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from xmarl_bench.cli.options import AsJson, Cells
from xmarl_bench.scoring.store import DEFAULT_FOLDER


def status(
    out: Annotated[
        Path | None, typer.Argument(help="Folder that a run writes to; by default every run in --cells.")
    ] = None,
    cells: Cells = DEFAULT_FOLDER,
    as_json: AsJson = False,
) -> None:
    """Say how far runs of score and study are: what is done, what failed, whether they still run."""
    from xmarl_bench.cli import tables
    from xmarl_bench.errors import InputError
    from xmarl_bench.scoring.run_record import run_records
    from xmarl_bench.scoring.store import Store

    store = Store(cells)
    records = [record for record in run_records(store) if out is None or record.out == str(out.resolve())]
    if not records:
        where = cells if out is None else f"{cells} that writes to {out}"
        raise InputError(f"no run is known in {where}: start one with `xmarl-bench score`, or give --cells.")
    rows = tables.run_rows([(record, record.progress(store)) for record in records])
    if as_json:
        tables.print_json(rows)
    else:
        tables.print_runs(rows)
