"""`xmarl-bench status`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from xmarl_bench.cli.options import AsJson, CacheFolder
from xmarl_bench.scoring.cache import DEFAULT_FOLDER


def status(
    out: Annotated[
        Path | None, typer.Argument(help="Folder that the run writes to; by default, all runs in --cache.")
    ] = None,
    cache: CacheFolder = DEFAULT_FOLDER,
    as_json: AsJson = False,
) -> None:
    """Show the progress of score and study runs: what is done, what failed, and whether they still run."""
    from xmarl_bench.cli import tables
    from xmarl_bench.errors import InputError
    from xmarl_bench.scoring.cache import Cache
    from xmarl_bench.scoring.run_record import run_records

    known = Cache(cache)
    records = [record for record in run_records(known) if out is None or record.out == str(out.resolve())]
    if not records:
        which = "" if out is None else f" that writes to {out}"
        raise InputError(
            f"{cache} has no record of a run{which}: start one with `xmarl-bench score`, or give --cache."
        )
    rows = tables.run_rows([(record, record.progress(known)) for record in records])
    if as_json:
        tables.print_json(rows)
    else:
        tables.print_runs(rows)
