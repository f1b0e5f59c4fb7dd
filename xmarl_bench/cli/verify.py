"""`xmarl-bench verify`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from xmarl_bench.cli.options import Address, AnswerSeconds, AsJson, Backend, Jobs
from xmarl_bench.cli.validate import Paths


def verify(
    paths: Paths,
    tier: Annotated[
        str,
        typer.Option(
            help="recompute: aggregates from rows, runs nothing; spot: runs some episodes again; full: all; "
            "fresh: runs other episodes, see --fresh-from."
        ),
    ] = "recompute",
    episodes: Annotated[int, typer.Option(help="Episodes of each cell that spot plays again.")] = 10,
    seed: Annotated[
        int | None, typer.Option(help="Seed for the choice of these episodes; random by default.")
    ] = None,
    fresh_from: Annotated[
        str | None,
        typer.Option(
            help="For tier fresh: what its seeds are derived from, fixed after the submission, such as the "
            "hash of a later commit."
        ),
    ] = None,
    explainer: Annotated[
        str | None,
        typer.Option(help="Explainer to run if it is not installed: module:Name or path/to/file.py:Name."),
    ] = None,
    trust_code: Annotated[
        bool,
        typer.Option(
            "--trust-code", help="Run the code of third-party explainers, in a process with limits."
        ),
    ] = False,
    cpu_seconds: Annotated[int, typer.Option(help="CPU time of all such processes together.")] = 3600,
    memory: Annotated[float, typer.Option(help="Memory of all such processes together, in GiB.")] = 8.0,
    answer_seconds: AnswerSeconds = 900.0,
    by: Annotated[
        str | None, typer.Option(help="Sign entries that pass, with this name in their verification block.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for the signed entries; by default in place. Required for bundles."),
    ] = None,
    resume: Annotated[
        bool,
        typer.Option("--resume", help="Skip entries that --by has signed at this tier already."),
    ] = False,
    jobs: Jobs = None,
    backend: Backend = "loky",
    address: Address = None,
    as_json: AsJson = False,
) -> None:
    """Verify entries: validate them, then compute their numbers again.

    Numbers must be equal bit for bit on the platform and versions of the entry, and within the published
    tolerance elsewhere. Tier fresh measures how much better the entry is on the public episodes than on
    fresh ones: it records the difference and passes either way. Exit code 0: all passed; 1: something did
    not; 2: something could not be run. --by signs each entry as soon as it has passed: after an interruption,
    the same command with --resume goes on. Entries of one policy by our explainers are scored together.
    """
    import math
    import sys

    from xmarl_bench.cli import tables
    from xmarl_bench.entry.file import write_entry
    from xmarl_bench.errors import InputError, unknown
    from xmarl_bench.isolation.limits import Limits
    from xmarl_bench.parallel.fan_out import Failure
    from xmarl_bench.parallel.workers import Workers
    from xmarl_bench.records.strict_json import printable
    from xmarl_bench.submission.batch import Unit, verify_all
    from xmarl_bench.submission.checking import check
    from xmarl_bench.submission.verdict_lines import lines, place
    from xmarl_bench.submission.verification import Options, Tier, is_signed, signed

    if tier not in list(Tier):
        raise unknown("tier", tier, Tier)
    if resume and by is None:
        raise InputError("--resume skips the entries that --by has signed: give --by.")
    if not math.isfinite(memory):
        raise InputError(f"memory must be finite, got {memory}: give a number of GiB.")
    limits = Limits(cpu_seconds=cpu_seconds, memory_bytes=int(memory * 2**30), answer_seconds=answer_seconds)
    options = Options(Tier(tier), episodes, seed, explainer, trust_code, limits, fresh_from=fresh_from)
    workers = Workers(jobs, backend, address)
    code, places, units, n_skipped = 0, [], [], 0
    for path in paths:
        try:
            checked = check(path)
            if by is not None and out is None and checked.is_bundle:
                raise InputError(f"{path} is a bundle: give --out, a folder for its signed entries.")
        except InputError as error:
            print(f"xmarl-bench: {error}", file=sys.stderr)
            code = 2
            continue
        for sentence in (*checked.findings, *checked.remarks):
            print(f"{printable(path)}: {sentence}", file=sys.stderr if as_json else sys.stdout)
        if checked.findings:
            code = max(code, 1)
            continue
        folder = out or checked.folder
        for file, entry in checked.entries.items():
            if resume and by is not None and is_signed(entry, by, folder, options):
                n_skipped += 1
            else:
                places.append((path, folder))
                units.append(Unit(checked.part(file), file))
    if n_skipped:
        print(f"signed by {by} already: {n_skipped}; left: {len(units)}.", file=sys.stderr)
    verdicts = {}
    for k, verdict in verify_all(units, options, workers):
        (path, folder), file = places[k], units[k].file
        if isinstance(verdict, Failure):
            print(f"xmarl-bench: {place(path, file)}: {verdict.error}", file=sys.stderr)
            code = 2
            continue
        verdicts[k] = verdict.record(str(path), file)
        if verdict.findings:
            code = max(code, 1)
        elif by is not None:
            try:
                write_entry(folder, signed(verdict, by, folder))
            except InputError as error:
                print(f"xmarl-bench: {error}", file=sys.stderr)
                code = 2
        if not as_json:
            print("\n".join(lines(path, file, verdict)), flush=True)
    if as_json:
        tables.print_json([verdicts[k] for k in sorted(verdicts)])
    raise SystemExit(code)
