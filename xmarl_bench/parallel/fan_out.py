"""Applies one function to many units of work, in one process or many, with a progress bar on stderr.

A unit that raises or a worker that dies does not stop the others. No result depends on the process that
computed it.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator, Sequence, Sized
from concurrent.futures import FIRST_COMPLETED, Future, wait
from itertools import chain, islice
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn, TimeRemainingColumn

from xmarl_bench.parallel.backends import Backend, connected
from xmarl_bench.parallel.calls import Answer, Failure, attempt, outcome, send
from xmarl_bench.parallel.workers import ONE_PROCESS, Workers

__all__ = ["Failure", "WorkerDiedError", "fan_out", "in_order"]

Unit = TypeVar("Unit")
Result = TypeVar("Result")

AHEAD = 2  # units under way per worker, so that no worker waits for its next one
DIED_TWICE = (
    "crashed its worker twice, the second time while it ran alone: it may need more memory than the machine "
    "has, or something kills it."
)


class WorkerDiedError(RuntimeError):
    """A unit crashed its worker twice."""


def fan_out(
    function: Callable[[Unit], Result],
    units: Iterable[Unit],
    *,
    workers: Workers = ONE_PROCESS,
    total: int | None = None,
    progress: str | None = None,
) -> Iterator[tuple[int, Result | Failure]]:
    """(index of the unit, its result) as each finishes, in any order.

    Args:
        function, units: a worker gets pickled copies. Units are taken lazily, in the thread of the caller and
            a few ahead of the results: neither all units nor all results are ever in memory.
        total: how many units there are, for the bar; by default their length, if they have one.
        progress: the bar's title; None: no bar.

    A unit that was under way when a worker died runs again at the end, alone. If its worker dies again, its
    result is a `Failure`. Raises InputError if the workers are not available.
    """
    console = Console(stderr=True)
    bar = Progress(
        "{task.description}",
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        disable=progress is None or not console.is_terminal,
        transient=True,  # only errors stay on stderr
    )
    if total is None and isinstance(units, Sized):
        total = len(units)
    with bar:
        task = bar.add_task(progress or "", total=total)
        for each in _outcomes(function, units, workers):
            bar.advance(task)
            yield each


def in_order(
    function: Callable[[Unit], Result],
    units: Sequence[Unit],
    *,
    workers: Workers = ONE_PROCESS,
    progress: str | None = None,
) -> Iterator[Result]:
    """Results in the order of `units`. Raises the exception of the first unit that fails."""

    def results() -> Iterator[tuple[int, Result]]:
        for index, result in fan_out(function, units, workers=workers, progress=progress):
            if isinstance(result, Failure):
                raise result.raised
            yield index, result

    return ordered(results())


def ordered(numbered: Iterable[tuple[int, Result]]) -> Iterator[Result]:
    """The results numbered 0, 1, 2 ..., each once it and all lower ones have come."""
    waiting: dict[int, Result] = {}
    following = 0
    for index, result in numbered:
        waiting[index] = result
        while following in waiting:
            yield waiting.pop(following)
            following += 1


def _outcomes(
    function: Callable[[Unit], Result], units: Iterable[Unit], workers: Workers
) -> Iterator[tuple[int, Result | Failure]]:
    if workers.in_this_process:
        for index, unit in enumerate(units):
            yield index, attempt(lambda unit=unit: function(unit))  # type: ignore[misc]
        return
    remaining = iter(units)
    for first in islice(remaining, 1):  # without units no workers are started
        with connected(workers) as backend:
            numbered = enumerate(chain([first], remaining))
            bound = workers.jobs if workers.address else None  # on a running cluster, jobs is the limit
            ahead = bound or AHEAD * max(1, backend.n_workers)
            suspects = yield from _send(backend, function, numbered, ahead)
            for index, _ in (yield from _send(backend, function, iter(suspects), 1)):
                yield index, Failure(DIED_TWICE, None, WorkerDiedError(DIED_TWICE))


def _send(
    backend: Backend, function: Callable[[Unit], Result], numbered: Iterator[tuple[int, Unit]], ahead: int
) -> Generator[tuple[int, Result | Failure], None, list[tuple[int, Unit]]]:
    """Outcomes of units, at most `ahead` of which are under way; returns the units whose workers died."""
    under_way: dict[Future[Answer], tuple[int, Unit]] = {}
    died: list[tuple[int, Unit]] = []
    try:
        while True:
            for index, unit in islice(numbered, ahead - len(under_way)):
                under_way[send(backend.submit, function, unit)] = index, unit
            if not under_way:
                return died
            wait(under_way, return_when=FIRST_COMPLETED)
            future = next(each for each in under_way if each.done())  # the oldest, so that none starves
            index, unit = under_way.pop(future)
            try:
                answer = future.result()
            except backend.deaths:
                died.append((index, unit))
            else:
                yield index, outcome(answer)
    finally:
        if under_way:
            backend.kill(under_way)
