"""The command line: parses, calls, prints. Invalid input gives one message and exit code 2."""

from __future__ import annotations

import sys

import typer

from xmarl_bench.cli.board import board
from xmarl_bench.cli.cache import cache
from xmarl_bench.cli.check import check
from xmarl_bench.cli.compare import compare
from xmarl_bench.cli.convert import convert
from xmarl_bench.cli.evaluate import evaluate
from xmarl_bench.cli.list import list_
from xmarl_bench.cli.new import new
from xmarl_bench.cli.render import render
from xmarl_bench.cli.score import score
from xmarl_bench.cli.status import status
from xmarl_bench.cli.study import study
from xmarl_bench.cli.submit import submit
from xmarl_bench.cli.validate import validate
from xmarl_bench.cli.verify import verify
from xmarl_bench.errors import InputError
from xmarl_bench.parallel.program_end import end_workers

app = typer.Typer(
    name="xmarl-bench",
    help="Scores explainers of multi-agent graph-attention policies.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command()(score)
app.command("list")(list_)
app.command()(evaluate)
app.command()(render)
app.command()(compare)
app.command()(convert)
app.command()(new)
app.command()(study)
app.command()(status)
app.command()(submit)
app.command()(validate)
app.command()(verify)
app.add_typer(board, name="board")
app.add_typer(cache, name="cache")
app.add_typer(check)


def main() -> None:
    try:
        app()
    except InputError as error:
        print(f"xmarl-bench: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        print("xmarl-bench: stopped; the next run continues from what is finished.", file=sys.stderr)
        raise SystemExit(130) from None
    finally:
        end_workers()


if __name__ == "__main__":
    main()
