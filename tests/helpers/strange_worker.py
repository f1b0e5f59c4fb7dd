"""Stands in for a stranger's process: what it does is in the environment variable STRANGE."""

from __future__ import annotations

import json
import os
import signal
import struct
import sys
import time
from pathlib import Path

import numpy
import psutil


def answer(**header: object) -> None:
    data = json.dumps(header).encode()
    sys.stdout.buffer.write(struct.pack("<IQ", len(data), 0) + data)
    sys.stdout.flush()


def question() -> None:
    (length,) = struct.unpack("<Q", sys.stdin.buffer.read(8))
    sys.stdin.buffer.read(length)


def leave_behind() -> int:
    """The process id of a child that has left the process group and the session, and ignores signals."""
    there, here = os.pipe()
    if os.fork() == 0:
        os.setsid()
        if os.fork() == 0:
            for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
                signal.signal(number, signal.SIG_IGN)
            os.write(here, str(os.getpid()).encode())
            time.sleep(3600)
        os._exit(0)
    return int(os.read(there, 20))


def fork(n: int, size: int, *, busy: bool) -> None:
    """n children that hold `size` bytes each and sleep or count."""
    for _ in range(n):
        if os.fork() == 0:
            held = bytearray(os.urandom(1)) * size
            while busy or held:
                if not busy:
                    time.sleep(1)


def serve(_: object) -> None:
    what = os.environ["STRANGE"]
    if what == "deaf":
        answer()
        time.sleep(3600)
    question()
    if what == "silent":
        time.sleep(3600)
    if what == "forks":
        left = leave_behind()
        answer(own=os.getpid(), left=left)
    if what == "crash":
        leave_behind()
        os._exit(3)
    if what == "nonsense":
        sys.stdout.buffer.write(b"\xff" * 100)
        sys.stdout.flush()
    if what == "not json":
        sys.stdout.buffer.write(struct.pack("<IQ", 3, 0) + b"NaN")
        sys.stdout.flush()
    if what == "many":
        fork(9, 1, busy=False)
    if what == "large":
        fork(4, 150 * 2**20, busy=False)
    if what == "busy":
        fork(2, 1, busy=True)
    if what == "told":
        answer(tmp=os.environ.get("TMPDIR"), home=os.environ.get("HOME"))
    if what == "fork":
        first = os.open(os.devnull, os.O_RDONLY)  # the lowest number that is free
        answer(
            server=psutil.Process().parent().ppid(),
            folder=str(Path.cwd()),
            path=sys.path,
            descriptor=first,
            random=numpy.random.random(),  # noqa: NPY002
            shared="torch_geometric" in sys.modules,
        )
    time.sleep(3600)
