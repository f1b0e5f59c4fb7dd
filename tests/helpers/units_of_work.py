"""Functions that tests run in workers, some of which fail."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import TYPE_CHECKING

from xmarl_bench.errors import InputError

if TYPE_CHECKING:  # torch takes a worker seconds to import, and few of these need it
    from xmarl_bench.parallel.workers import Workers
    from xmarl_bench.policy import Policy
    from xmarl_bench.scoring.measure import Unit
    from xmarl_bench.scoring.policy_payload import PolicyPayload


def square(number: int) -> int:
    return number * number


def process(number: int) -> int:
    return os.getpid()


def process_beside_another(folder: str) -> int:
    """Waits until another process uses the folder too; returns the id of this one."""
    (Path(folder) / str(os.getpid())).touch()
    until = time.monotonic() + 120
    while len(list(Path(folder).iterdir())) < 2:
        if time.monotonic() > until:
            (Path(folder) / "nobody").touch()  # no later unit waits again
            raise TimeoutError("no second process has computed a unit within 120 s")
        time.sleep(0.01)
    return os.getpid()


def loaded(payload: PolicyPayload[tuple[Policy, str]]) -> tuple[int, int]:
    """This process and its policy, once there are two of them."""
    policy, folder = payload.work
    return process_beside_another(folder), id(policy)


def zeros(n_bytes: int) -> bytes:
    return bytes(n_bytes)


def threads(number: int) -> dict[str, str | None]:
    return {name: os.environ.get(name) for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS")}


class AwkwardError(Exception):
    """Can be pickled but not unpickled."""

    def __init__(self, first: str, second: str) -> None:
        super().__init__(first)


def fail(number: object) -> object:
    if number == 1:
        raise InputError("a sentence of its own.")
    if number == 2:
        raise KeyError("missing")
    if number == 3:
        raise AwkwardError("one", "two")
    if number == 4:
        return (each for each in "cannot be pickled")
    return number


class Unpicklable:
    def __reduce__(self) -> str:
        raise TypeError("this cannot be sent")


class Unloadable:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return int, ("not a number",)


def kill_worker(number: int) -> int:
    """Every 5th unit kills its worker."""
    time.sleep(0.02)
    if number % 5 == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def kill_worker_once(unit: tuple[int, Path | None]) -> int:
    """The square; if a file is named, the worker dies at the first attempt."""
    number, mark = unit
    if mark is not None and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number


def square_behind(unit: tuple[int, Path]) -> int:
    """All numbers except 0 wait until the file exists."""
    number, gate = unit
    until = time.monotonic() + 120
    while number and not gate.exists():
        if time.monotonic() > until:
            raise TimeoutError(f"nobody made {gate} within 120 s")
        time.sleep(0.01)
    return number * number


def square_and_process(number: int) -> tuple[int, int]:
    return number * number, os.getpid()


def hold(fifo: str) -> None:
    """Writes this process's id as a line to a named pipe, which stays open until the process ends."""
    pipe = os.open(fifo, os.O_WRONLY)
    os.write(pipe, b"%d\n" % os.getpid())
    signal.pause()


def started_and_ended(number: int) -> tuple[float, float]:
    started = time.monotonic()  # the same clock for all processes of a machine
    time.sleep(0.05)
    return started, time.monotonic()


def twenty_kilobytes(number: int) -> bytes:
    return number.to_bytes(4, "big") * 5000


def memory(units: tuple[Unit, ...]) -> int:
    """Resident memory in bytes of this process after scoring."""
    import psutil

    for unit in units:
        unit.run()
    return int(psutil.Process().memory_info().rss)


def entries(bundle: Path, workers: Workers) -> list[str]:
    """Entries without times and machine, of attention and of an explainer that draws random numbers."""
    from xmarl_bench.entry.schema import Entry
    from xmarl_bench.plugins.registry import find_explainer
    from xmarl_bench.policy import load_policy
    from xmarl_bench.rollout.cell import Cell, Sampling
    from xmarl_bench.scoring.request import Request
    from xmarl_bench.scoring.score import score_requests

    policy, card = load_policy(bundle)
    sampling = Sampling(episodes=2, timesteps=1, max_cycles=4)
    requests = [
        Request(policy, card, find_explainer(name), (Cell(card.task, card.n_agents),), sampling, n)
        for name, n in (("attention", 2), ("gnn_explainer", 0))
    ]
    made = []
    for entry in score_requests(requests, workers=workers):
        assert isinstance(entry, Entry), entry
        made.append(entry.model_dump_json(exclude={"provenance", "cost"}))
    return made
