"""`xmarl-bench status`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from xmarl_bench.cli.options import AsJson, CacheFolder
from xmarl_bench.counted import counted
from xmarl_bench.scoring.cache import DEFAULT_FOLDER

if TYPE_CHECKING:
    from xmarl_bench.scoring.run_record import Progress, RunRecord


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
    rows = _rows([(record, record.progress(known)) for record in records])
    if as_json:
        tables.print_json(rows)
    else:
        _print(rows)


def _rows(records: Sequence[tuple[RunRecord, Progress]]) -> list[dict[str, Any]]:
    states = {True: "running", False: "stopped", None: "on another machine"}
    return [
        {
            "folder": record.out,
            "command": record.command,
            "started": record.started,
            "state": "finished" if progress.done == progress.pieces else states[progress.running],
            "pieces": [progress.done, progress.pieces],
            "entries": [progress.entries, len(record.asked)],
            "explainers": {name: list(counts) for name, counts in progress.explainers.items()},
            "failures": sorted(set(progress.failures.values())),
        }
        for record, progress in records
    ]


def _print(rows: Sequence[dict[str, Any]]) -> None:
    for row in rows:
        (done, pieces), (complete, entries) = row["pieces"], row["entries"]
        print(
            f"{row['folder']}: {row['state']}, {done} of {counted(pieces, 'piece')}, "
            f"{complete} of {counted(entries, 'entry')}."
        )
        print(f"  {row['command']} ({row['started']})")
        for name, (done, pieces) in row["explainers"].items():
            if done < pieces:
                print(f"  {name}: {done} of {pieces}")
        for failure in row["failures"]:
            print(f"  failed: {failure.splitlines()[0]}")
