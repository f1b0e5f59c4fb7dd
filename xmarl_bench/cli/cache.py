"""`xmarl-bench cache` and `xmarl-bench cache clear`."""

from __future__ import annotations

import typer

from xmarl_bench.cli.options import AsJson, CacheFolder
from xmarl_bench.counted import counted
from xmarl_bench.scoring.cache import DEFAULT_FOLDER, Cache

cache = typer.Typer(help="Show the size of the cache, or empty it.", invoke_without_command=True)


@cache.callback()
def show(context: typer.Context, folder: CacheFolder = DEFAULT_FOLDER, as_json: AsJson = False) -> None:
    """Show the folder of the cache, the number and size of its pieces, and how many fit this version."""
    if context.invoked_subcommand is not None:
        return
    from dataclasses import asdict

    from xmarl_bench.cli.tables import print_json
    from xmarl_bench.scoring.piece_keys import version_key

    size = Cache(folder).size(version_key())
    if as_json:
        print_json({"folder": str(folder), **asdict(size)})
    else:
        pieces, megabytes = counted(size.pieces, "piece"), size.size / 1e6
        print(f"{folder}: {pieces}, {megabytes:.1f} MB, {size.of_version} of this version.")


@cache.command()
def clear(folder: CacheFolder = DEFAULT_FOLDER) -> None:
    """Delete all pieces and records of runs. Keeps other files in the folder."""
    known = Cache(folder)
    size = known.size("")
    known.clear()
    print(f"{folder}: {counted(size.pieces, 'piece')} deleted, {size.size / 1e6:.1f} MB.")
