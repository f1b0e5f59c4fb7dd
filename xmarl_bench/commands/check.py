"""`xmarl-bench check explainer|policy`: exit code 1 where a check fails."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from xmarl_bench.checks import Finding

check = typer.Typer(
    name="check", help="Check an explainer or a policy as a referee would.", no_args_is_help=True
)


def report(subject: str, findings: Iterable[Finding], *, as_json: bool) -> None:
    """Print the findings on `subject`; raises typer.Exit(1) where a check failed."""
    from rich.console import Console
    from rich.table import Table

    from xmarl_bench.report import print_json

    found = list(findings)
    failed = sum(finding.passed is False for finding in found)
    if as_json:
        print_json({"subject": subject, "passed": not failed, "findings": [each.record() for each in found]})
    else:
        table = Table("check", "", "", title=subject, title_justify="left", show_lines=False)
        words = {True: "[green]pass[/green]", False: "[red]FAIL[/red]", None: "[dim]n/a[/dim]"}
        for each in found:
            table.add_row(each.check, words[each.passed], each.said)
        console = Console()
        (console if console.is_terminal else Console(width=160)).print(table)
        print(f"{subject}: {failed} of {len(found)} checks failed." if failed else f"{subject}: all passed.")
    if failed:
        raise typer.Exit(1)
