"""What commands print besides tables: JSON, Markdown, progress and failures."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from xmarl_bench.cli.fitted_table import cell
from xmarl_bench.counted import NAMED, first_of
from xmarl_bench.errors import InputError
from xmarl_bench.records.markdown import markdown_table

if TYPE_CHECKING:
    from xmarl_bench.scoring.score import Failed

Row = dict[str, Any]
Outcome = TypeVar("Outcome")


def markdown(rows: Sequence[Row]) -> str:
    return markdown_table([*rows[0]], [[*map(cell, row.values())] for row in rows]).rstrip() if rows else ""


def print_json(value: Any) -> None:
    print(json.dumps(value, indent=2, allow_nan=False))


def log_progress(outcomes: Iterator[Outcome], total: int) -> Iterator[Outcome]:
    """Yield the outcomes. Without a terminal, print a line on stderr about every 20 seconds."""
    started = last = time.monotonic()
    for done, outcome in enumerate(outcomes, start=1):
        now = time.monotonic()
        if now - last > 20.0 and not sys.stderr.isatty():
            last, minutes = now, (now - started) / 60
            print(f"{done} of {total} scored after {minutes:.1f} min.", file=sys.stderr, flush=True)
        yield outcome


@contextmanager
def says_if_stopped(kept: Callable[[], str], cache: Path | None) -> Iterator[None]:
    """After Ctrl+C, say on stderr what is kept and how to go on.

    kept: besides pieces, such as "a in b, ". cache: where pieces are kept, if they are.
    """
    try:
        yield
    except KeyboardInterrupt:
        pieces = "no pieces" if cache is None else f"finished pieces in {cache}"
        how = "" if cache is None else " The same command, without --no-resume, goes on from there."
        print(f"Kept: {kept()}{pieces}.{how}", file=sys.stderr, flush=True)
        raise


def exit_for_failures(failed: Sequence[Failed | InputError], total: int) -> None:
    """If something failed, print it on stderr and exit with code 1: one line for all that failed alike.

    Raises InputError with the first error if everything failed.
    """
    if not failed:
        return
    if len(failed) == total:
        first = failed[0]
        raise first if isinstance(first, InputError) else InputError(first.error)
    alike: dict[str, list[str]] = {}
    for each in failed:
        if isinstance(each, InputError):
            print(f"failed: {each}", file=sys.stderr)
        else:
            alike.setdefault(each.error, []).append(each.name)
    for error, names in alike.items():
        print(f"failed: {first_of(names, NAMED)}: {error}", file=sys.stderr)
    print(
        f"{len(failed)} of {total} failed; everything else is done. The same command tries them again.",
        file=sys.stderr,
    )
    raise SystemExit(1)
