"""`xmarl-bench submit`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def submit(
    entries: Annotated[list[Path], typer.Argument(help="Entry files, as `xmarl-bench score` wrote them.")],
    submitter: Annotated[str, typer.Option(help="Name of the submitter, as the board shows it.")],
    licence: Annotated[Path, typer.Option(help="File with the licence of the bundle.")],
    out: Annotated[Path, typer.Option(help="Bundle to write: NAME.zip, or a folder.")],
    policy: Annotated[
        list[Path],
        typer.Option(help="Bundle of a policy that no package registers. Repeatable."),
    ] = [],  # noqa: B006
    code: Annotated[str | None, typer.Option(help="Link to the explainer's code.")] = None,
    paper: Annotated[str | None, typer.Option(help="Link to the explainer's paper.")] = None,
    contact: Annotated[str | None, typer.Option(help="Address for questions of the maintainers.")] = None,
    variants_tried: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Number of variants scored on these episodes, with this one. The board shows it.",
        ),
    ] = None,
) -> None:
    """Pack entries, their policies and rows into a bundle, and check it as the maintainers will.

    Exit code 1: the bundle is invalid, and nothing is written.
    """
    import tempfile

    from xmarl_bench.counted import counted
    from xmarl_bench.entry.file import read_entry
    from xmarl_bench.errors import InputError
    from xmarl_bench.policy.card import load_card
    from xmarl_bench.submission.checking import check
    from xmarl_bench.submission.packing import as_submitted, bundle_files, write_bundle

    if out.exists():
        raise InputError(f"{out} already exists: give another name, or remove it first.")
    given = {load_card(folder).name: folder for folder in policy}
    submitted = [as_submitted(read_entry(path), submitter, code, variants_tried, paper) for path in entries]
    names = dict.fromkeys(entry.policy.name for entry in submitted)
    for name in given.keys() - names.keys():
        raise InputError(f"none of the entries is of policy {name!r}: leave it out, or give its entries.")
    registered = [name for name in names if name not in given]
    if registered:
        from xmarl_bench.plugins.names import find_policy

        given |= {name: find_policy(name) for name in registered}
    try:
        terms = licence.read_bytes()
    except OSError as error:
        raise InputError(f"{licence} cannot be read ({error.strerror}): give a file of text.") from None
    files = bundle_files(submitted, given, submitter=submitter, licence=terms, contact=contact)
    with tempfile.TemporaryDirectory() as folder:
        draft = Path(folder) / out.name
        write_bundle(draft, files)
        checked = check(draft)
    for remark in checked.remarks:
        print(f"{out}: {remark}")
    if checked.findings:
        for finding in checked.findings:
            print(f"{out}: {finding}")
        raise SystemExit(1)
    write_bundle(out, files)
    print(f"{out}: valid, {counted(len(submitted), 'entry')}. How to submit it: leaderboard/README.md.")
