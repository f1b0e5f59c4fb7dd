"""A stranger's process, behind a wall and with limits, that answers questions over a pipe.

The harness sends policy and observations, receives masks, and measures them itself on its own policy. So the
stranger's code can return bad masks but cannot change scores. Its answers are numbers and JSON: the harness
unpickles none of them.
"""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import platform
import select
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from xmarl_bench.errors import InputError
from xmarl_bench.isolation.limits import UNIX, Limits
from xmarl_bench.isolation.walls import Wall, environment, python_folders, walled
from xmarl_bench.records.strict_json import parse_json, shown

MAX_HEADER, MAX_MASKS = 1024 * 1024, 1 << 30
KEEPER, WORKER = "xmarl_bench.isolation.keeper", "xmarl_bench.plugins.stranger"
END_SECONDS = 10.0  # for the keeper to end the stranger's processes
PIPE_BYTES = 1 << 20


class Stranger:
    """A running process. End it with `close`, or use a `with` statement.

    name: for messages. readable: files in hidden folders that it needs. Raises InputError on systems whose
    pipes have no deadlines.
    """

    def __init__(self, name: str, limits: Limits, wall: Wall, readable: Sequence[Path] = ()) -> None:
        if not UNIX:
            raise InputError(
                f"{shown(name)} is third-party code and runs in a process of its own, which "
                f"{platform.system()} does not offer: run this on Linux or macOS, or run the code in this "
                f"process (--no-isolate, isolate=False)."
            )
        self.name, self.limits = shown(name, 200)[1:-1], limits
        folders = [*python_folders(), *readable]
        worker = {
            "name": self.name,
            "limits": vars(limits),
            "wall": wall,
            "readable": [str(each) for each in folders],
        }
        ours, theirs = socket.socketpair()
        with theirs:
            config = {
                "command": walled(wall, [sys.executable, "-m", WORKER, json.dumps(worker)], folders),
                "limits": vars(limits),
                "harness": theirs.fileno(),
                "private": wall != "bubblewrap",  # which has a folder /tmp of its own
                "home": wall == "landlock",
            }
            self._process = subprocess.Popen(
                [sys.executable, "-m", KEEPER, json.dumps(config)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env=environment(wall),
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )
        self._keeper: socket.socket | None = ours
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._questions, self._answers = self._process.stdin.fileno(), self._process.stdout.fileno()
        os.set_blocking(self._questions, False)

    @property
    def running(self) -> bool:
        return self._keeper is not None

    @property
    def keeper_id(self) -> int:
        """The process id of the keeper, parent of the stranger's process."""
        return self._process.pid

    def ask(self, question: dict[str, Any]) -> tuple[dict[str, Any], bytes]:
        """Ask, and wait for the answer: JSON and bytes.

        Raises InputError with the stranger's own error; and if it does not take the question or answer it in
        time, answers nonsense, or ends, which ends the process.
        """
        if not self.running:
            raise InputError(f"the process of {self.name} has ended: start it again.")
        deadline = time.monotonic() + self.limits.answer_seconds
        data = pickle.dumps(question)
        self._write(struct.pack("<Q", len(data)) + data, deadline)
        header_bytes, payload_bytes = struct.unpack("<IQ", self._read(12, deadline))
        if header_bytes > MAX_HEADER or payload_bytes > MAX_MASKS:
            raise self._wrong("returned too many bytes")
        try:
            header = parse_json(self._read(header_bytes, deadline))
        except ValueError:
            header = None
        payload = self._read(payload_bytes, deadline)
        if not isinstance(header, dict):
            raise self._wrong("returned invalid JSON")
        if "error" in header:
            said = shown(header["error"], 500)[1:-1]
            named = said.startswith(("explainer ", "policy ", "task ")) or self.name in said
            raise InputError(said if named else f"{self.name}: {said}")
        return header, payload

    def close(self) -> None:
        """End the process and everything that it started."""
        if self._keeper is None:
            return
        with contextlib.suppress(OSError):
            self._keeper.shutdown(socket.SHUT_RDWR)  # also for copies of the socket in forks of this process
        self._keeper.close()
        self._keeper = None
        try:
            self._process.wait(END_SECONDS)
        except subprocess.TimeoutExpired:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()

    def __enter__(self) -> Stranger:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _write(self, data: bytes, deadline: float) -> None:
        left = memoryview(data)
        while left:
            if not select.select([], [self._questions], [], max(0.0, deadline - time.monotonic()))[1]:
                raise self._late("take its question")
            try:
                left = left[os.write(self._questions, left[:PIPE_BYTES]) :]
            except BlockingIOError:
                continue
            except OSError:
                raise self._ended() from None

    def _read(self, n_bytes: int, deadline: float) -> bytes:
        parts = bytearray()
        while len(parts) < n_bytes:
            if not select.select([self._answers], [], [], max(0.0, deadline - time.monotonic()))[0]:
                raise self._late("answer")
            part = os.read(self._answers, min(n_bytes - len(parts), PIPE_BYTES))
            if not part:
                raise self._ended()
            parts += part
        return bytes(parts)

    def _late(self, what: str) -> InputError:
        self.close()
        return InputError(
            f"{self.name} did not {what} within {self.limits.answer_seconds:g} s: give it more time "
            f"(--answer-seconds), or leave it out."
        )

    def _wrong(self, what: str) -> InputError:
        self.close()
        return InputError(f"{self.name} {what}: correct it, or leave it out.")

    def _ended(self) -> InputError:
        found: dict[str, Any] = {}
        if self._keeper is not None:
            self._keeper.settimeout(END_SECONDS)
            with contextlib.suppress(OSError, ValueError):
                found = json.loads(self._keeper.recv(4096))
        self.close()
        if found.get("limit") is not None:
            return InputError(
                f"the process of {self.name} used {found['limit']}: raise the limit, or leave it out."
            )
        return InputError(
            f"the process of {self.name} ended (exit code {found.get('code')}): correct it, or leave it out."
        )
