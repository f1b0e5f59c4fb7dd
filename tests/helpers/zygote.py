"""Runs command lines in forks of one process that has imported everything: 0.1 s each instead of 5 s.

    python -P tests/helpers/zygote.py

reads a `Request` as one JSON object per line, and writes an `Answer` for each.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import sys
import tempfile
from typing import IO, NoReturn, TypedDict

import pytest

from xmarl_bench.cli import board, score  # noqa: F401
from xmarl_bench.cli import main as cli
from xmarl_bench.scoring.score import score_requests  # noqa: F401


class Request(TypedDict, total=False):
    command: list[str]  # "xmarl-bench" or "pytest", and its arguments
    folder: str  # where it runs
    touched: str  # count accesses to files in this folder, by the main process
    victim: str  # "main" or "worker": which process to kill
    kill_at: int  # before this access, counted from 0


class Answer(TypedDict):
    code: int
    out: str
    err: str
    touches: int  # accesses to files in the folder
    killed: bool


def child(request: Request, out: IO[bytes], err: IO[bytes], log: IO[bytes]) -> NoReturn:
    """Run the command in this fork and exit like a program: SystemExit propagates."""
    os.dup2(out.fileno(), 1)
    os.dup2(err.fileno(), 2)
    os.chdir(request.get("folder", "."))
    sys.argv = request["command"]
    if "touched" in request:
        watch(request, log)
    sys.exit({"xmarl-bench": cli.main, "pytest": pytest.console_main}[sys.argv[0]]())


def watch(request: Request, log: IO[bytes]) -> None:
    """Log each access of this process to the folder as a dot, and kill the victim once, at the requested
    access.

    The kill is logged as `K`. A worker is killed at a later access if there is none yet.
    """
    process, touches, killed = os.getpid(), 0, False

    def seen(event: str, arguments: tuple[object, ...]) -> None:
        nonlocal touches, killed
        touching = event == "open" or event.startswith(("os.", "shutil."))
        if not touching or os.getpid() != process or not str(arguments[:1]).count(request["touched"]):
            return
        if not killed and touches >= request.get("kill_at", sys.maxsize):
            victims = [process] if request["victim"] == "main" else worker_processes()
            killed = bool(victims)
            for victim in victims[:1]:
                os.write(log.fileno(), b"K")
                os.kill(victim, signal.SIGKILL)
        touches += 1
        os.write(log.fileno(), b".")

    sys.addaudithook(seen)


def worker_processes() -> list[int]:
    return [each.pid for each in multiprocessing.active_children() if each.pid is not None]


def serve(request: Request) -> Answer:
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err, tempfile.TemporaryFile() as log:
        pid = os.fork()
        if pid == 0:
            child(request, out, err, log)
        _, status = os.waitpid(pid, 0)
        for file in (out, err, log):
            file.seek(0)
        seen = log.read()
        return {
            "code": os.waitstatus_to_exitcode(status), "out": out.read().decode(), "err": err.read().decode(),
            "touches": seen.count(b"."), "killed": b"K" in seen,
        }  # fmt: skip


if __name__ == "__main__":
    for line in sys.stdin:
        print(json.dumps(serve(json.loads(line))), flush=True)
