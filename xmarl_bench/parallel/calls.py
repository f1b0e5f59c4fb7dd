"""Calls that are sent to workers, and their answers.

We pickle calls and results ourselves, because each backend fails in its own way. Here, a call or result that
cannot be pickled or loaded is an error of that unit alone.
"""

from __future__ import annotations

import pickle
import tempfile
import traceback
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from xmarl_bench.errors import InputError
from xmarl_bench.origin.pickling import dumps
from xmarl_bench.parallel.loading import without_collector

Unit = TypeVar("Unit")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Failure:
    """A unit that failed: its error in one sentence, the traceback if there is one, and the exception."""

    error: str
    traceback: str | None
    raised: Exception = field(repr=False, compare=False)


Answer = bytes | Path | Failure  # a pickled outcome, the file that holds it, or why there is none
SHORT_BYTES = 2048  # with its envelope less than PIPE_BUF, so that a pipe takes it atomically


def attempt(compute: Callable[[], Result]) -> Result | Failure:
    """The result, or a Failure if the call raises an exception."""
    try:
        return compute()
    except Exception as error:
        kind = "" if isinstance(error, InputError) else f"{type(error).__name__}: "
        return Failure(f"{kind}{error}", traceback.format_exc(), error)


def send(
    submit: Callable[..., Future[Any]], function: Callable[[Unit], object], unit: Unit
) -> Future[Answer]:
    """Submit the call `function(unit)`. `outcome` reads the answer that the future gives."""
    call = attempt(lambda: dumps((function, unit)))
    if isinstance(call, bytes):
        return submit(_answer, call)
    not_sent: Future[Answer] = Future()
    not_sent.set_result(call)
    return not_sent


def outcome(answer: Answer) -> Any:
    """What the call returned, or its Failure. Deletes the file of the answer."""
    if isinstance(answer, Failure):
        return answer
    if isinstance(answer, Path):
        pickled = answer.read_bytes()
        answer.unlink()
    else:
        pickled = answer
    return attempt(lambda: pickle.loads(pickled))


def kept_in(folder: str, answer: bytes) -> Answer:
    """On a worker: write a long answer to a file in `folder`."""
    if len(answer) <= SHORT_BYTES:
        return answer

    def keep() -> Path:
        with tempfile.NamedTemporaryFile(dir=folder, delete=False) as file:
            file.write(answer)
        return Path(file.name)

    return attempt(keep)


def _answer(call: bytes) -> bytes:
    """On a worker: the outcome of a pickled call, pickled."""

    def run() -> bytes:
        with without_collector():  # a worker's first call imports all that it needs
            function, unit = pickle.loads(call)
        return dumps(function(unit))

    answer = attempt(run)
    return answer if isinstance(answer, bytes) else dumps(_portable(answer))


def _portable(failure: Failure) -> Failure:
    """Replaces an exception that cannot be pickled or loaded again, as those of some libraries."""
    try:
        pickle.loads(dumps(failure.raised))
    except Exception:
        return replace(failure, raised=RuntimeError(failure.error))
    return failure
