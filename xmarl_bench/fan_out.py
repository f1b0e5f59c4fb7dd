"""The same function over many units of work, in one process or several, with a progress bar on stderr."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from joblib import Parallel, delayed
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from xmarl_bench.errors import InputError

Unit = TypeVar("Unit")
Result = TypeVar("Result")


def fan_out(
    function: Callable[[Unit], Result], units: Sequence[Unit], *, jobs: int = 1, progress: str | None = None
) -> Iterator[Result]:
    """Results in the order of `units`, whatever finishes first; `progress` is the bar's title, None for none.

    A worker gets pickled copies, so results must not depend on which process computes them.
    """
    console = Console(stderr=True)
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        disable=progress is None or not console.is_terminal,
        transient=True,  # what stays on stderr is errors, one sentence each
    )
    with bar:
        task = bar.add_task(progress or "", total=len(units))
        if jobs == 1 or len(units) < 2:
            results: Iterator[Result] = map(function, units)
        else:
            results = Parallel(n_jobs=jobs, return_as="generator")(delayed(function)(unit) for unit in units)
        for result in results:
            bar.advance(task)
            yield result


def check_parallel(jobs: int, parallel_episodes: int) -> None:
    """Raises InputError for numbers of processes or episodes that are none."""
    if jobs < 1:
        raise InputError(f"jobs must be at least 1, got {jobs}: give the number of processes to use.")
    if parallel_episodes < 1:
        raise InputError(
            f"parallel_episodes must be at least 1, got {parallel_episodes}: "
            f"give the number of episodes to step side by side."
        )
