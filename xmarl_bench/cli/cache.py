"""`xmarl-bench cache` and `xmarl-bench cache clear`."""

from __future__ import annotations

import typer

from xmarl_bench.cli.options import AsJson, CacheFolder
from xmarl_bench.scoring.cache import DEFAULT_FOLDER, Cache

cache = typer.Typer(help="See what the cache holds, or empty it.", invoke_without_command=True)


@cache.callback()
def show(context: typer.Context, folder: CacheFolder = DEFAULT_FOLDER, as_json: AsJson = False) -> None:
    """See its folder, how many pieces it holds, their size, and how many are of the installed version."""
    if context.invoked_subcommand is not None:
        return
    from dataclasses import asdict

    from xmarl_bench.cli.tables import print_json
    from xmarl_bench.scoring.piece_keys import version_key

    size = Cache(folder).size(version_key())
    if as_json:
        print_json({"folder": str(folder), **asdict(size)})
    else:
        print(f"{folder}: {size.pieces} pieces, {size.size / 1e6:.1f} MB, {size.of_version} of this version.")


@cache.command()
def clear(folder: CacheFolder = DEFAULT_FOLDER) -> None:
    """Delete every piece and the records of runs; nothing else that lies in the folder."""
    known = Cache(folder)
    size = known.size("")
    known.clear()
    print(f"{folder}: {size.pieces} pieces deleted, {size.size / 1e6:.1f} MB.")
