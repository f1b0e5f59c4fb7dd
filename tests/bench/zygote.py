"""Runs command lines in forks of one process that has imported everything: 0.1 s each, not 5.

    python -P tests/bench/zygote.py

reads a `Request` as a JSON object a line, and writes an `Answer` for each.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import IO, NoReturn, TypedDict

import psutil
import pytest
import scipy.stats  # noqa: F401

from xmarl_bench.cli import board, score  # noqa: F401
from xmarl_bench.cli import main as cli
from xmarl_bench.scoring.score import score_requests  # noqa: F401


class Request(TypedDict, total=False):
    command: list[str]  # "xmarl-bench" or "pytest", and its arguments
    folder: str  # where it runs
    site: str  # packages beside those that are installed
    victim: str  # "main" or "worker": whom to kill, once
    kill_after: float  # seconds
    kill_at: tuple[str, int]  # when so many results are in this folder


class Answer(TypedDict):
    code: int
    out: str
    err: str
    seconds: float
    killed: bool


def child(request: Request, out: IO[bytes], err: IO[bytes]) -> NoReturn:
    """Ends as a program does, with all that it has started: SystemExit goes through."""
    os.dup2(out.fileno(), 1)
    os.dup2(err.fileno(), 2)
    os.chdir(request.get("folder", "."))
    sys.path[:0] = [request["site"]] if "site" in request else []
    sys.argv = request["command"]
    sys.exit({"xmarl-bench": cli.main, "pytest": pytest.console_main}[sys.argv[0]]())


def is_time_to_kill(request: Request, seconds: float) -> bool:
    if "kill_at" in request:
        cells, n_results = request["kill_at"]
        return len(list(Path(cells).glob("??/[!.]*"))) >= n_results
    return "kill_after" in request and seconds >= request["kill_after"]


def kill(pid: int, victim: str) -> bool:
    """Kill the run itself, or the first process that it has started to compute; False where there is none."""
    with contextlib.suppress(psutil.NoSuchProcess):  # it has ended, and may not have been waited for
        run = psutil.Process(pid)
        workers = [run] if victim == "main" else run.children()
        for each in workers:
            if victim == "main" or "LokyProcess" in " ".join(each.cmdline()):
                each.send_signal(signal.SIGKILL)
                return True
    return False


def serve(request: Request) -> Answer:
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        started, killed, done = time.monotonic(), False, 0
        pid = os.fork()
        if pid == 0:
            child(request, out, err)
        while not done:
            time.sleep(0.002)
            done, status = os.waitpid(pid, os.WNOHANG)
            seconds = time.monotonic() - started
            if not done and not killed and is_time_to_kill(request, seconds):
                killed = kill(pid, request.get("victim", "main"))
        out.seek(0)
        err.seek(0)
        return {
            "code": os.waitstatus_to_exitcode(status), "out": out.read().decode(), "err": err.read().decode(),
            "seconds": seconds, "killed": killed,
        }  # fmt: skip


if __name__ == "__main__":
    for line in sys.stdin:
        print(json.dumps(serve(json.loads(line))), flush=True)
