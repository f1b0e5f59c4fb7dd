"""The command line: parses, calls, prints. Invalid input gives one message and exit code 2."""

from __future__ import annotations

import typer

from xmarl_bench.cli.board import board
from xmarl_bench.cli.cache import cache
from xmarl_bench.cli.check import check
from xmarl_bench.cli.compare import compare
from xmarl_bench.cli.convert import convert
from xmarl_bench.cli.evaluate import evaluate
from xmarl_bench.cli.export import export
from xmarl_bench.cli.list import list_
from xmarl_bench.cli.new import new
from xmarl_bench.cli.program import Version, run
from xmarl_bench.cli.render import render
from xmarl_bench.cli.score import score
from xmarl_bench.cli.status import status
from xmarl_bench.cli.study import study
from xmarl_bench.cli.submit import submit
from xmarl_bench.cli.validate import validate
from xmarl_bench.cli.verify import verify

app = typer.Typer(
    name="xmarl-bench",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",  # paragraphs of help wrap
)
app.command()(score)
app.command("list")(list_)
for command in (evaluate, render, compare, convert, export, new, study, status, submit, validate, verify):
    app.command()(command)
app.add_typer(board, name="board")
app.add_typer(cache, name="cache")
app.add_typer(check)


@app.callback()
def options(version: Version = False) -> None:
    """Scores explainers of multi-agent graph-attention policies."""


def main() -> None:
    run("xmarl-bench", app, "stopped; the next run continues from what is finished.")


if __name__ == "__main__":
    main()
