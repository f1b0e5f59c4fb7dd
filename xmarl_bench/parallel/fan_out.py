"""The same function over many units of work, in one process or many, with a progress bar on stderr.

All fan-out goes through here, and through joblib from here. Neither a unit that raises nor a worker that dies
stops the others, and no result depends on which process computed it.
"""

from __future__ import annotations

import pickle
import traceback
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence, Sized
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain, islice
from typing import TypeVar

import cloudpickle
from joblib import Parallel, delayed, parallel_config
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
from xmarl_bench.parallel.joblib_backends import Backend, Died, connected
from xmarl_bench.parallel.workers import ONE_PROCESS, Workers

Unit = TypeVar("Unit")
Result = TypeVar("Result")

DIED_TWICE = (
    "its worker died twice, the second time with nothing else under way: it may need more memory than there "
    "is, or something kills it."
)


@dataclass(frozen=True)
class Failure:
    """A unit that failed: one sentence, and the traceback where there is one."""

    error: str
    traceback: str | None


@dataclass(frozen=True)
class _Raised:
    """What the function raised, on whichever worker."""

    error: Exception
    failure: Failure


class WorkerDiedError(RuntimeError):
    """A unit took its worker with it, twice."""


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
        total: how many units there are, for the bar; by default their length, where they have one.
        progress: the bar's title, None for none.

    A unit under way when a worker died is tried again at the end, with nothing else under way; if its worker
    dies again, it is a `Failure`. Raises InputError where the workers cannot be had.
    """
    with _bar(units, total, progress) as advance:
        for index, outcome in _outcomes(function, units, workers):
            advance()
            yield index, outcome.failure if isinstance(outcome, _Raised) else outcome


def in_order(
    function: Callable[[Unit], Result],
    units: Sequence[Unit],
    *,
    workers: Workers = ONE_PROCESS,
    progress: str | None = None,
) -> Iterator[Result]:
    """Results in the order of `units`, whatever finishes first; the first error is raised as it was."""
    waiting: dict[int, Result] = {}
    following = 0
    with _bar(units, None, progress) as advance:
        for index, outcome in _outcomes(function, units, workers):
            advance()
            if isinstance(outcome, _Raised):
                raise outcome.error
            waiting[index] = outcome
            while following in waiting:
                yield waiting.pop(following)
                following += 1


@contextmanager
def _bar(units: object, total: int | None, title: str | None) -> Iterator[Callable[[], None]]:
    console = Console(stderr=True)
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        disable=title is None or not console.is_terminal,
        transient=True,  # what stays on stderr is errors, one sentence each
    )
    if total is None and isinstance(units, Sized):
        total = len(units)
    with bar:
        task = bar.add_task(title or "", total=total)
        yield lambda: bar.advance(task)


def _outcomes(
    function: Callable[[Unit], Result], units: Iterable[Unit], workers: Workers
) -> Iterator[tuple[int, Result | _Raised]]:
    if workers.in_this_process:
        for index, unit in enumerate(units):
            yield index, _attempt(lambda unit=unit: function(unit))  # type: ignore[misc]
        return
    remaining = iter(units)
    first = list(islice(remaining, 1))
    if not first:  # nothing to start workers for
        return
    with connected(workers) as backend:
        sent = ((index, _pickled(function, unit)) for index, unit in enumerate(chain(first, remaining)))
        suspects = yield from _send(backend, sent, backend.ahead)
        for index in (yield from _send(backend, iter(suspects.items()), 1)):
            yield index, _Raised(WorkerDiedError(DIED_TWICE), Failure(DIED_TWICE, None))


def _send(
    backend: Backend, sent: Iterator[tuple[int, bytes]], ahead: int
) -> Generator[tuple[int, Result | _Raised], None, dict[int, bytes]]:
    """Outcomes of pickled calls, at most `ahead` of which are under way; returns those whose workers died."""
    under_way: dict[int, bytes] = {}
    died: dict[int, bytes] = {}

    def calls() -> Iterator[object]:
        for index, call in sent:
            under_way[index] = call
            yield delayed(_compute)(index, call)

    with parallel_config(backend=backend):
        parallel = Parallel(n_jobs=2, return_as="generator_unordered", batch_size=1, pre_dispatch=ahead)
        returned = parallel(calls())
    try:
        while under_way:
            backend.deliver()
            result = next(returned)
            if isinstance(result, Died):
                died[result.index] = under_way.pop(result.index)
                continue
            index, data = result
            del under_way[index]
            yield index, _attempt(lambda data=data: pickle.loads(data))  # type: ignore[misc]
        next(returned, None)  # lets joblib see that it is through, and keep its workers
    finally:
        with warnings.catch_warnings():  # joblib tells of units that were stopped: so they were to be
            warnings.simplefilter("ignore")
            returned.close()
    return died


def _attempt(compute: Callable[[], Result]) -> Result | _Raised:
    try:
        return compute()
    except Exception as error:
        return _raised(error)


def _raised(error: Exception) -> _Raised:
    kind = "" if isinstance(error, InputError) else f"{type(error).__name__}: "
    return _Raised(error, Failure(f"{kind}{error}", traceback.format_exc()))


def _pickled(function: Callable[[Unit], object], unit: Unit) -> bytes:
    """Pickled here and not by the backends, each of which does it in its own way, and fails in its own way:
    what cannot be pickled, or not be loaded over there, is an error of that unit alone."""
    try:
        return bytes(cloudpickle.dumps((function, unit)))
    except Exception as error:
        return bytes(cloudpickle.dumps((_same, _portable(_raised(error)))))


def _same(raised: _Raised) -> _Raised:
    return raised


def _compute(index: int, call: bytes) -> tuple[int, bytes]:
    """On a worker: the outcome of a pickled call, pickled."""

    def run() -> bytes:
        function, unit = pickle.loads(call)
        return bytes(cloudpickle.dumps(function(unit)))

    outcome = _attempt(run)
    return index, outcome if isinstance(outcome, bytes) else bytes(cloudpickle.dumps(_portable(outcome)))


def _portable(raised: _Raised) -> _Raised:
    """Errors of some libraries cannot be pickled, or not be loaded again."""
    try:
        pickle.loads(cloudpickle.dumps(raised.error))
    except Exception:
        return _Raised(RuntimeError(raised.failure.error), raised.failure)
    return raised
