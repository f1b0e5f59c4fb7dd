"""`xmarl-bench validate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Paths = Annotated[
    list[Path], typer.Argument(help="Entry files, folders of entries, or bundles (a zip or a folder).")
]


def validate(paths: Paths) -> None:
    """Check entries and submission bundles without running anything. Prints a line per finding.

    Exit code 0: all are valid; 1: something is invalid; 2: something could not be read.
    """
    import sys

    from xmarl_bench.counted import counted
    from xmarl_bench.errors import InputError
    from xmarl_bench.records.strict_json import printable
    from xmarl_bench.submission.checking import check

    code = 0
    for path in paths:
        try:
            checked = check(path)
        except InputError as error:
            print(f"xmarl-bench: {error}", file=sys.stderr)
            code = 2
            continue
        name = printable(path)
        for sentence in (*checked.findings, *checked.remarks):
            print(f"{name}: {sentence}")
        if checked.findings:
            code = max(code, 1)
        else:
            print(f"{name}: valid, {counted(len(checked.entries), 'entry')}.")
    raise SystemExit(code)
