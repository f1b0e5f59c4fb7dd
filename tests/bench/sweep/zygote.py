"""Runs command lines of xmarl-bench in forks of one process that has imported everything: 0.1 s each, not 5.

    python -m tests.bench.sweep.zygote

reads a JSON object a line, {"arguments": [...], "kill_after": seconds or null, "victim": "main" or "worker"},
and writes {"code": exit code, "seconds": ..., "killed": bool} for each.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time

import psutil
import scipy.stats  # noqa: F401

from xmarl_bench import cli
from xmarl_bench.commands import board, score  # noqa: F401
from xmarl_bench.scoring import score_requests  # noqa: F401


def child(arguments: list[str]) -> None:
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    sys.argv = ["xmarl-bench", *arguments]
    code: object = 0
    try:
        cli.main()
    except SystemExit as stop:
        code = stop.code
    os._exit(code if isinstance(code, int) else 1)


def victims(pid: int, kind: str) -> list[psutil.Process]:
    """The run itself, or the processes that it has started to compute."""
    try:
        run = psutil.Process(pid)
        if kind == "main":
            return [run]
        return [each for each in run.children() if "LokyProcess" in " ".join(each.cmdline())]
    except psutil.NoSuchProcess:
        return []


def serve(request: dict[str, object]) -> dict[str, object]:
    started = time.monotonic()
    pid = os.fork()
    if pid == 0:
        child(list(request["arguments"]))  # type: ignore[call-overload]
    kill_after, killed = request["kill_after"], False
    while True:
        done, status = os.waitpid(pid, os.WNOHANG)
        seconds = time.monotonic() - started
        if done:
            return {"code": os.waitstatus_to_exitcode(status), "seconds": seconds, "killed": killed}
        if kill_after is not None and not killed and seconds >= float(kill_after):  # type: ignore[arg-type]
            for victim in victims(pid, str(request["victim"]))[:1]:
                victim.send_signal(signal.SIGKILL)
                killed = True
        time.sleep(0.002)


if __name__ == "__main__":
    for line in sys.stdin:
        print(json.dumps(serve(json.loads(line))), flush=True)
