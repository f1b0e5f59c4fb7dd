"""The record of a run's pieces, written when it begins. `xmarl-bench status` shows progress from it."""

from __future__ import annotations

import hashlib
import os
import shlex
import socket
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import TypeAdapter, ValidationError

from xmarl_bench.records.files import is_running, pretty_json, write_atomically
from xmarl_bench.scoring.cache import RUNS, Cache

if TYPE_CHECKING:
    from xmarl_bench.scoring.pieces import Plan


@dataclass(frozen=True)
class Asked:
    """One entry of a run."""

    policy: str
    explainer: str
    own: list[str]  # keys of the pieces of this explainer only
    shared: list[str]

    @property
    def pieces(self) -> list[str]:
        return self.own + self.shared


@dataclass(frozen=True)
class RunRecord:
    """The latest run that writes to a folder."""

    out: str
    command: str
    started: str  # ISO 8601, UTC
    host: str
    pid: int
    asked: list[Asked]

    @classmethod
    def of(cls, plans: Sequence[Plan], out: Path, started: str) -> RunRecord:
        return cls(
            str(out.resolve()),
            shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
            started,
            socket.gethostname(),
            os.getpid(),
            [
                Asked(
                    plan.request.card.name,
                    plan.request.explainer.name,
                    [piece.key for piece in plan if piece.explainer is not None],
                    [piece.key for piece in plan if piece.explainer is None],
                )
                for plan in plans
            ],
        )

    def write(self, cache: Cache) -> None:
        name = hashlib.sha256(self.out.encode()).hexdigest()[:16]
        write_atomically(cache.folder / RUNS / f"{name}.json", pretty_json(ADAPTER.dump_python(self)))

    def progress(self, cache: Cache) -> Progress:
        keys = {key for each in self.asked for key in each.pieces}
        done = {key for key in keys if cache.has(key)}
        failures = {key: text for key in sorted(keys - done) if (text := cache.failure(key)) is not None}
        explainers: dict[str, tuple[int, int]] = {}
        for each in self.asked:
            ready, needed = explainers.get(each.explainer, (0, 0))
            explainers[each.explainer] = ready + len(done.intersection(each.own)), needed + len(each.own)
        running = None
        if self.host == socket.gethostname():
            running = done != keys and is_running(self.pid)
        return Progress(
            running=running,
            done=len(done),
            pieces=len(keys),
            entries=sum(all(key in done for key in each.pieces) for each in self.asked),
            failures=failures,
            explainers=explainers,
        )


@dataclass(frozen=True)
class Progress:
    """How far a run is."""

    running: bool | None  # None: unknown, because it runs on another machine
    done: int
    pieces: int
    entries: int  # complete
    failures: dict[str, str]  # by key of the piece
    explainers: dict[str, tuple[int, int]]  # pieces done and needed


ADAPTER = TypeAdapter(RunRecord)


def run_records(cache: Cache) -> Iterator[RunRecord]:
    """Records of all runs, without finished ones whose folder was deleted. Skips invalid files.

    A run that ended before its first entry leaves no folder.
    """
    for path in sorted((cache.folder / RUNS).glob("*.json")):
        try:
            record = ADAPTER.validate_json(path.read_bytes())
        except (OSError, ValidationError):
            continue
        keys = (key for each in record.asked for key in each.pieces)
        if Path(record.out).is_dir() or not all(map(cache.has, keys)):
            yield record
