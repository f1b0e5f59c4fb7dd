"""Calls that are sent to workers, and what comes back.

Calls and results are pickled here, not by the backends, each of which fails in its own way: what cannot be
pickled, or cannot be loaded over there, is an error of that unit alone.
"""

from __future__ import annotations

import os
import pickle
import tempfile
import traceback
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import cloudpickle

from xmarl_bench.errors import InputError

Unit = TypeVar("Unit")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Failure:
    """A unit that failed: one sentence, the traceback if there is one, and what was raised."""

    error: str
    traceback: str | None
    raised: Exception = field(repr=False, compare=False)


Answer = bytes | Path | Failure  # a pickled outcome, the file it is in, or why there is none
SHORT_BYTES = 2048  # with what is around it, a pipe takes it whole or not at all (PIPE_BUF)


def attempt(compute: Callable[[], Result]) -> Result | Failure:
    try:
        return compute()
    except Exception as error:
        kind = "" if isinstance(error, InputError) else f"{type(error).__name__}: "
        return Failure(f"{kind}{error}", traceback.format_exc(), error)


def send(
    submit: Callable[..., Future[Any]], function: Callable[[Unit], object], unit: Unit
) -> Future[Answer]:
    """A worker's answer to the call `function(unit)`, for `outcome`."""
    call = attempt(lambda: bytes(cloudpickle.dumps((function, unit))))
    if isinstance(call, bytes):
        return submit(_answer, call)
    not_sent: Future[Answer] = Future()
    not_sent.set_result(call)
    return not_sent


def outcome(answer: Answer) -> Any:
    """What the call returned, or its Failure. Its file is removed."""
    if isinstance(answer, Failure):
        return answer
    if isinstance(answer, Path):
        pickled = answer.read_bytes()
        answer.unlink()
    else:
        pickled = answer
    return attempt(lambda: pickle.loads(pickled))


def kept_in(folder: str, answer: bytes) -> Answer:
    """On a worker: a long answer as a file in `folder`."""
    if len(answer) <= SHORT_BYTES:
        return answer

    def keep() -> Path:
        descriptor, name = tempfile.mkstemp(dir=folder)
        with os.fdopen(descriptor, "wb") as file:
            file.write(answer)
        return Path(name)

    return attempt(keep)


def _answer(call: bytes) -> bytes:
    """On a worker: the outcome of a pickled call, pickled."""

    def run() -> bytes:
        function, unit = pickle.loads(call)
        return bytes(cloudpickle.dumps(function(unit)))

    answer = attempt(run)
    return answer if isinstance(answer, bytes) else bytes(cloudpickle.dumps(_portable(answer)))


def _portable(failure: Failure) -> Failure:
    """Errors of some libraries cannot be pickled, or cannot be loaded again."""
    try:
        pickle.loads(cloudpickle.dumps(failure.raised))
    except Exception:
        return replace(failure, raised=RuntimeError(failure.error))
    return failure
