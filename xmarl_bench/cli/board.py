"""`xmarl-bench board build|check|explainers|serve`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

board = typer.Typer(help="Build, check or serve the leaderboard of a folder's entries.", no_args_is_help=True)
Folder = Annotated[Path, typer.Argument(help="The folder that holds entries/.", show_default=True)]


@board.command()
def build(
    folder: Folder = Path("leaderboard"),
    animations: Annotated[
        bool,
        typer.Option(
            "--animations",
            help="First draw missing animations, which plays policies and takes minutes.",
        ),
    ] = False,
) -> None:
    """Derive leaderboard.json, leaderboard.csv and the page from the entries."""
    import sys

    from xmarl_bench.board import build_board
    from xmarl_bench.entry.file import entry_files
    from xmarl_bench.errors import InputError
    from xmarl_bench.records.strict_json import printable

    if not (folder / "entries").is_dir():
        raise InputError(f"folder {folder / 'entries'} does not exist: give the folder of a leaderboard.")
    strays = entry_files(folder / "entries").strays
    for path in strays:
        print(f"xmarl-bench: {printable(path)} is not an entry, and is left out.", file=sys.stderr)
    if animations:
        from xmarl_bench.render.board_animations import draw_missing  # imports torch

        for line in draw_missing(folder):
            print(line, flush=True)
    print(f"{build_board(folder)} and {folder / 'index.html'} are up to date.")


@board.command()
def check(folder: Folder = Path("leaderboard")) -> None:
    """Check that the derived files fit the entries, else exit with 1. Does not draw animations again."""
    from xmarl_bench.board import check_board

    found = check_board(folder)
    for line in found:
        print(line)
    if found:
        print(f"Run: xmarl-bench board build {folder}")
        raise typer.Exit(1)
    print(f"{folder}: all derived files fit the entries.")


@board.command()
def explainers(folder: Folder = Path("leaderboard")) -> None:
    """Write explainers.json: question, paper and planted truth of each registered explainer, for the page."""
    from xmarl_bench.board.build import CARDS
    from xmarl_bench.isolation.limits import UNLIMITED
    from xmarl_bench.meta.explainer_cards import cards_of
    from xmarl_bench.records.files import write_json
    from xmarl_bench.scoring.selection import select_explainers

    found, failures = select_explainers(["all"], UNLIMITED)
    if failures:
        raise failures[0]
    cards = cards_of(found)
    write_json(folder / CARDS, cards)
    print(f"{folder / CARDS}: {len(cards)} explainers. Run: xmarl-bench board build {folder}")


@board.command()
def serve(
    folder: Folder = Path("leaderboard"),
    port: Annotated[int, typer.Option(help="Port; 0: a free one.", min=0, max=65535)] = 8000,
) -> None:
    """Serve the page on this machine only, until interrupted."""
    from contextlib import suppress
    from functools import partial
    from http.server import ThreadingHTTPServer

    from xmarl_bench.board.server import PlainFiles
    from xmarl_bench.errors import InputError

    if not (folder / "index.html").is_file():
        raise InputError(f"{folder / 'index.html'} does not exist: run xmarl-bench board build {folder}.")
    handler = partial(PlainFiles, directory=str(folder))
    try:
        server = ThreadingHTTPServer(("127.0.0.1", port), handler)
    except OSError as error:
        raise InputError(f"cannot serve on port {port} ({error.strerror}): choose another --port.") from None
    with server:
        print(f"http://127.0.0.1:{server.server_port}/index.html (Ctrl+C ends)", flush=True)
        with suppress(KeyboardInterrupt):
            server.serve_forever()
