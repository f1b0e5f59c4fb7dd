"""What commands print besides tables: JSON, Markdown, progress and failures."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from xmarl_bench.cli.fitted_table import cell
from xmarl_bench.errors import InputError

if TYPE_CHECKING:
    from xmarl_bench.scoring.score import Failed

Row = dict[str, Any]
Outcome = TypeVar("Outcome")


def markdown(rows: Sequence[Row]) -> str:
    if not rows:
        return ""
    lines = [
        list(rows[0]),
        ["---"] * len(rows[0]),
        *([cell(value) for value in row.values()] for row in rows),
    ]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def print_json(value: Any) -> None:
    print(json.dumps(value, indent=2, allow_nan=False))


def log_progress(outcomes: Iterator[Outcome], total: int, every: float = 20.0) -> Iterator[Outcome]:
    """Yield the outcomes. Without a terminal, print a line on stderr about every so many seconds."""
    started = last = time.monotonic()
    for done, outcome in enumerate(outcomes, start=1):
        now = time.monotonic()
        if now - last > every and not sys.stderr.isatty():
            last, minutes = now, (now - started) / 60
            print(f"{done} of {total} scored after {minutes:.1f} min.", file=sys.stderr, flush=True)
        yield outcome


def exit_for_failures(failed: Sequence[Failed | InputError], total: int) -> None:
    """If something failed, print it on stderr and exit with code 1.

    Raises InputError with the first error if everything failed.
    """
    if not failed:
        return
    if len(failed) == total:
        first = failed[0]
        raise first if isinstance(first, InputError) else InputError(first.error)
    for each in failed:
        print(f"failed: {each}", file=sys.stderr)
    print(
        f"{len(failed)} of {total} failed; everything else is done. The same command tries them again.",
        file=sys.stderr,
    )
    raise SystemExit(1)
