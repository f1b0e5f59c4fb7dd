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
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from xmarl_bench.errors import InputError
from xmarl_bench.isolation.fork_server import fork_keeper
from xmarl_bench.isolation.limits import UNIX, Limits
from xmarl_bench.isolation.walls import STRANGER, Wall, environment, in_bubblewrap, python_folders
from xmarl_bench.records.strict_json import parse_json, shown

MAX_HEADER, MAX_MASKS = 1024 * 1024, 1 << 30
WORKER = "xmarl_bench.plugins.stranger"
# What explainers and policies need, imported once for all forks.
PRELOADED = (WORKER, "xmarl_bench.plugins.registry", "xmarl_bench.plugins.stranger_policies")
END_SECONDS = 10.0  # for the keeper to end the stranger's processes
PIPE_BYTES = 1 << 20


class Stranger:
    """A running process. End it with `close`, or use a `with` statement.

    name: for messages. readable: files in hidden folders that it needs. light: it needs no torch. Raises
    InputError on systems whose pipes have no deadlines.
    """

    def __init__(
        self, name: str, limits: Limits, wall: Wall, readable: Sequence[Path] = (), *, light: bool = False
    ) -> None:
        if not UNIX:
            raise InputError(
                f"{shown(name)} is third-party code and runs in a process of its own, which "
                f"{platform.system()} does not offer: run this on Linux or macOS, or run the code in this "
                f"process (--no-isolate, isolate=False)."
            )
        self.name, self.limits = shown(name, 200)[1:-1], limits
        if STRANGER in os.environ:  # its process would load the same code, and so on without end
            raise InputError(
                f"the code of {self.name} scores while it is loaded: put what runs it under "
                f'`if __name__ == "__main__":`.'
            )
        folders = [*python_folders(), *readable]
        stranger = {
            "name": self.name,
            "limits": vars(limits),
            "wall": wall,
            "readable": [str(each) for each in folders],
        }
        command = None
        if wall == "bubblewrap":
            command = in_bubblewrap([sys.executable, "-m", WORKER, json.dumps(stranger)], folders)
        config = {
            "command": command,  # None: a fork, which closes itself in
            "preloaded": () if light or command is not None else PRELOADED,
            "worker": WORKER,
            "stranger": stranger,
            "environment": environment(wall),
            "folder": str(Path.cwd()),
            # As here, where "" is the working directory: its files hide no modules unless they do so here.
            "path": [str(Path(entry).absolute()) for entry in sys.path],
            "private": wall != "bubblewrap",  # which has a folder /tmp of its own
            "home": wall == "landlock",
        }
        keeper, theirs = socket.socketpair()
        read, questions = os.pipe()
        answers, write = os.pipe()
        self._keeper: socket.socket | None = keeper
        self._questions, self._answers = os.fdopen(questions, "wb", 0), os.fdopen(answers, "rb", 0)
        os.set_blocking(questions, False)
        try:
            # The process id of the keeper, parent of the stranger's process.
            self.keeper_id = fork_keeper(wall, config, (read, write, theirs.fileno()))
        except BaseException:
            self._close_ends()
            raise
        finally:
            theirs.close()
            os.close(read)
            os.close(write)

    @property
    def running(self) -> bool:
        return self._keeper is not None

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
        try:
            self._keeper.shutdown(socket.SHUT_WR)  # also for copies of the socket in forks of this process
            self._keeper.settimeout(END_SECONDS)
            while self._keeper.recv(4096):  # how it ended; then its end of the socket closes with it
                pass
        except TimeoutError:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.keeper_id, signal.SIGKILL)
        except OSError:
            pass
        self._close_ends()

    def __enter__(self) -> Stranger:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _close_ends(self) -> None:
        for end in (self._keeper, self._questions, self._answers):
            if end is not None:
                with contextlib.suppress(OSError):
                    end.close()
        self._keeper = None

    def _write(self, data: bytes, deadline: float) -> None:
        left = memoryview(data)
        while left:
            if not select.select([], [self._questions], [], max(0.0, deadline - time.monotonic()))[1]:
                raise self._late("take its question")
            try:
                left = left[os.write(self._questions.fileno(), left[:PIPE_BYTES]) :]
            except BlockingIOError:
                continue
            except OSError:
                raise self._ended() from None

    def _read(self, n_bytes: int, deadline: float) -> bytes:
        parts = bytearray()
        while len(parts) < n_bytes:
            if not select.select([self._answers], [], [], max(0.0, deadline - time.monotonic()))[0]:
                raise self._late("answer")
            part = os.read(self._answers.fileno(), min(n_bytes - len(parts), PIPE_BYTES))
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
