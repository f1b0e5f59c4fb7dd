"""`xmarl-bench status`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from xmarl_bench.cli.options import AsJson, CacheFolder
from xmarl_bench.scoring.cache import DEFAULT_FOLDER


def status(
    out: Annotated[
        Path | None, typer.Argument(help="Folder that a run writes to; by default every run in --cache.")
    ] = None,
    cache: CacheFolder = DEFAULT_FOLDER,
    as_json: AsJson = False,
) -> None:
    """Say how far runs of score and study are: what is done, what failed, whether they still run."""
    from xmarl_bench.cli import tables
    from xmarl_bench.errors import InputError
    from xmarl_bench.scoring.cache import Cache
    from xmarl_bench.scoring.run_record import run_records

    known = Cache(cache)
    records = [record for record in run_records(known) if out is None or record.out == str(out.resolve())]
    if not records:
        where = cache if out is None else f"{cache} that writes to {out}"
        raise InputError(f"no run is known in {where}: start one with `xmarl-bench score`, or give --cache.")
    rows = tables.run_rows([(record, record.progress(known)) for record in records])
    if as_json:
        tables.print_json(rows)
    else:
        tables.print_runs(rows)
