"""Conversations with strangers' processes: each is started when it is first asked, and asked again later.

Every process of the harness that asks has its own. One that ended or did not answer is not started again in
the same run: it gives the same error at once.
"""

from __future__ import annotations

import atexit
import os
import secrets
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from xmarl_bench.errors import InputError
from xmarl_bench.isolation.limits import UNLIMITED, Limits
from xmarl_bench.isolation.process import Stranger
from xmarl_bench.isolation.walls import Wall
from xmarl_bench.origin.pickling import dumps
from xmarl_bench.records.strict_json import first_error, shown

PROCESSES_KEPT = 8  # in each process of the harness


@dataclass(frozen=True)
class Isolation:
    """How strangers' processes are kept apart."""

    limits: Limits = UNLIMITED
    wall: Wall = "process"


PLAIN = Isolation()


@dataclass(frozen=True)
class Source:
    """What a process is started for."""

    name: str  # for messages
    load: dict[str, Any] | None = field(compare=False)  # its first question: what code to load
    isolation: Isolation
    readable: tuple[Path, ...] = ()
    key: str | None = None  # of the code that was loaded first; None: not known
    token: str = field(default_factory=secrets.token_hex)  # another one in each run, which reads files anew

    def beside(self, other: Source) -> Source:
        """The same code in a process that the other's code may enter."""
        return replace(self, token=f"{self.token} {other.token}", readable=(*self.readable, *other.readable))


class Conversation:
    """A running process, and what it has been sent."""

    def __init__(self, source: Source) -> None:
        isolation = source.isolation
        self.source = source
        light = source.load is not None and source.load["what"] == "task"
        self.process = Stranger(source.name, isolation.limits, isolation.wall, source.readable, light=light)
        self.policies: OrderedDict[str, None] = OrderedDict()
        self.fits: OrderedDict[str, None] = OrderedDict()
        try:
            self.declared: dict[str, Any] = {} if source.load is None else self.ask(source.load)[0]
            if source.key not in (None, self.declared.get("key")):
                raise InputError(f"the code of {source.name} has changed since it was loaded: run again.")
        except BaseException:
            self.process.close()
            raise

    def ask(self, question: dict[str, Any]) -> tuple[dict[str, Any], bytes]:
        try:
            return self.process.ask(question)
        except InputError as error:
            if not self.process.running:
                _running()[self.source.token] = error
            raise


def sendable(what: str, thing: object) -> bytes:
    """Pickled for a process of its own. what: its kind and name. Raises InputError if it cannot be."""
    try:
        return dumps(thing)
    except Exception as error:
        remedy = "keep files, locks and connections out of it"
        if "parametrized modules" in str(error):
            remedy = "call torch.nn.utils.parametrize.remove_parametrizations"
        raise InputError(
            f"{what} cannot be sent to a process of its own ({type(error).__name__}: {error}): {remedy}, or "
            f"run it here (isolate=False)."
        ) from error


@contextmanager
def reading_answer(source: Source) -> Iterator[None]:
    """While an answer is parsed by pydantic: raises InputError, naming the source, if it is not valid."""
    try:
        yield
    except ValidationError as error:
        problem, where = first_error(error)
        raise InputError(
            f"{source.name} has no valid {shown(where)} ({shown(problem)}): correct it."
        ) from None


def forgotten(known: OrderedDict[str, None], kept: int) -> list[str]:
    """The oldest keys, dropped to make place for one more."""
    return [known.popitem(last=False)[0] for _ in range(len(known) - kept + 1)]


def is_running(source: Source) -> bool:
    """Whether the source's process was started here, and has not ended."""
    return isinstance(_running().get(source.token), Conversation)


def conversation(source: Source) -> Conversation:
    """The conversation with the source's process, which is started if there is none.

    Raises InputError if it has ended in this run.
    """
    running = _running()
    found = running.get(source.token)
    if isinstance(found, InputError):
        raise InputError(str(found))
    if found is None:
        alive = [key for key, each in running.items() if isinstance(each, Conversation)]
        for key in alive[: max(0, len(alive) - PROCESSES_KEPT + 1)]:
            ended = running.pop(key)
            if isinstance(ended, Conversation):
                ended.process.close()
        found = running[source.token] = Conversation(source)
    running.move_to_end(source.token)
    return found


def end_strangers() -> None:
    """End the processes of all strangers that this process has started."""
    for each in _running().values():
        if isinstance(each, Conversation):
            each.process.close()
    _running().clear()


_of_process: dict[int, OrderedDict[str, Conversation | InputError]] = {}  # by the harness's process id


def _running() -> OrderedDict[str, Conversation | InputError]:
    """Conversations by token, of this process: a fork has none. An error is of one that has ended."""
    return _of_process.setdefault(os.getpid(), OrderedDict())


atexit.register(end_strangers)
