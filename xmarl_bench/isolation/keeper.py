"""Keeps a stranger's processes: forked by xmarl_bench.isolation.fork_server for each of them.

The keeper starts the stranger's process on the pipes that the harness gave, and ends it with everything that
it started: when the harness ends, however it does; when the process ends; or at a limit, which holds for all
of them together. It runs none of their code, and tells the harness how they ended.
"""

from __future__ import annotations

import ctypes
import json
import os
import select
import shutil
import signal
import socket
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from importlib import import_module, invalidate_caches
from pathlib import Path
from typing import Any

import psutil

from xmarl_bench.isolation.limits import Limits

TICK, MEASURED = 0.1, 0.5  # seconds between looks at the processes, and at what they use
SUBREAPER, PARENT_DEATH = 36, 1  # options of prctl(2)
GRACE = 5.0  # seconds that killed processes have to be gone


def keep(config: dict[str, Any], questions: int, answers: int, harness: int) -> None:
    """Keep the process of a config of xmarl_bench.isolation.process until it ends."""
    for here, there in ((questions, 0), (answers, 1)):
        os.dup2(here, there)
        os.close(here)
    told = socket.socket(fileno=harness)
    limits, parent = Limits(**config["stranger"]["limits"]), os.getppid()
    prctl(SUBREAPER, 1)  # what the stranger's processes leave behind becomes ours
    os.chdir(config["folder"])
    os.environ.clear()
    os.environ.update(config["environment"])
    private = Path(tempfile.mkdtemp(prefix="xmarl-bench-stranger-"))
    if config["private"]:
        os.environ["TMPDIR"] = tempfile.tempdir = str(private)  # forks have the module and what it remembers
    if config["home"]:
        os.environ["HOME"] = str(private)
    try:
        process = _started(config)
        with Path(os.devnull).open("r+b") as nowhere:  # so that the pipes end with the process
            for descriptor in (0, 1):
                os.dup2(nowhere.fileno(), descriptor)
        limit = _wait(process, told, parent, limits)
        code = process.poll()
        _end_all(process)
    finally:
        shutil.rmtree(private, ignore_errors=True)
    with suppress(OSError):
        told.sendall(json.dumps({"code": code, "limit": limit}).encode())


def _started(config: dict[str, Any]) -> Forked:
    """The stranger's process: a command behind a wall of its own, or a fork that closes itself in."""
    process_id = os.fork()
    if process_id:
        return Forked(process_id)
    code = 1
    try:
        os.closerange(3, os.sysconf("SC_OPEN_MAX"))
        if config["command"] is not None:
            os.execvp(config["command"][0], config["command"])
        sys.path[:] = config["path"]
        invalidate_caches()
        if "numpy" in sys.modules:  # else all forks draw the same random numbers
            sys.modules["numpy"].random.seed()
        import_module(config["worker"]).serve(config["stranger"])
        code = 0
    finally:
        os._exit(code)


class Forked:
    """A fork of this process."""

    def __init__(self, process_id: int) -> None:
        self.pid = process_id
        self._code: int | None = None

    def poll(self) -> int | None:
        """The exit code, negative for a signal; None while the process runs."""
        if self._code is None:
            with suppress(ChildProcessError):
                found, status = os.waitpid(self.pid, os.WNOHANG)
                self._code = os.waitstatus_to_exitcode(status) if found else None
        return self._code


def prctl(option: int, value: int) -> None:
    """Set an option of this process where the system has it: Linux only."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(option, value, 0, 0, 0)


def _wait(process: Forked, harness: socket.socket, parent: int, limits: Limits) -> str | None:
    """Wait for the end of the process or of the harness, or for a limit: returns which."""
    used, measured = Used(), time.monotonic()
    while process.poll() is None and os.getppid() == parent:
        if select.select([harness], [], [], TICK)[0]:  # the harness writes nothing: it has closed its end
            return None
        if time.monotonic() - measured >= MEASURED:
            measured = time.monotonic()
            limit = used.limit(limits)
            if limit is not None:
                return limit
    return None


class Used:
    """What the stranger's processes use together. A process that lives less than MEASURED is not counted."""

    def __init__(self) -> None:
        self.seconds: dict[tuple[int, float], float] = {}  # CPU time by process, also of those that ended

    def limit(self, limits: Limits) -> str | None:
        """The limit that they have passed, as a clause; None if there is none."""
        if limits.cpu_seconds is limits.memory_bytes is limits.processes is None:
            return None
        processes = list(_descendants())
        for each in processes:
            with suppress(psutil.Error):
                times = each.cpu_times()
                self.seconds[each.pid, each.create_time()] = times.user + times.system
        if limits.processes is not None and len(processes) > limits.processes:
            return f"more than {limits.processes} processes"
        if limits.cpu_seconds is not None and sum(self.seconds.values()) > limits.cpu_seconds:
            return f"more than {limits.cpu_seconds} s of CPU time"
        memory = limits.memory_bytes
        if memory is None or _memory(processes, shared=True) <= memory:
            return None
        if _memory(processes, shared=False) <= memory:  # exact and slower
            return None
        return f"more than {memory / 2**30:g} GiB of memory"


def _memory(processes: list[psutil.Process], *, shared: bool) -> int:
    """Bytes in memory. shared: count what processes share in each of them."""
    total = 0
    for each in processes:
        with suppress(psutil.Error):
            found: Any = each.memory_info() if shared else each.memory_full_info()
            total += found.rss if shared else getattr(found, "pss", found.rss)
    return total


def _descendants() -> Iterator[psutil.Process]:
    with suppress(psutil.Error):
        yield from psutil.Process().children(recursive=True)


def _is_alive(process: psutil.Process) -> bool:
    """False also if it has ended since it was found."""
    try:
        return bool(process.status() != psutil.STATUS_ZOMBIE)
    except psutil.Error:
        return False


def _end_all(process: Forked) -> None:
    """End every process that descends from this one: stop them first, so that they start no others."""
    deadline = time.monotonic() + GRACE
    while time.monotonic() < deadline:
        alive = [each for each in _descendants() if _is_alive(each)]
        for number in (signal.SIGSTOP, signal.SIGKILL):
            for each in alive:
                with suppress(psutil.Error):
                    each.send_signal(number)
        process.poll()
        with suppress(ChildProcessError):  # those that others left behind
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        if not alive:
            return
        time.sleep(0.01)
