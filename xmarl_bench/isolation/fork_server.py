"""Forks keepers from a process that has imported the harness once.

The imports take 4 s of CPU time, torch and torch_geometric most of it, and a fork 0.02 s. The server,
`python -m xmarl_bench.isolation.fork_server FD`, runs no code of others: its forks do, behind their wall. One
server serves one process of the harness and one wall, and ends with that process.
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import json
import os
import select
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any

from xmarl_bench.errors import InputError
from xmarl_bench.isolation.walls import Wall, environment
from xmarl_bench.parallel.loading import without_collector

SERVER = "xmarl_bench.isolation.fork_server"
NUMBER = struct.Struct("<Q")
TICK = 0.1  # seconds between looks at the harness
DESCRIPTORS = 3  # of a keeper: its questions, its answers, and its socket to the harness


class ForkServer:
    """A running server, as the harness sees it."""

    def __init__(self, wall: Wall) -> None:
        self._socket, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", SERVER, str(theirs.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env=environment(wall),
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )

    def fork(self, config: dict[str, Any], descriptors: Sequence[int]) -> int:
        """Fork a keeper; returns its process id. Raises OSError if the server has ended."""
        data = json.dumps(config).encode()
        socket.send_fds(self._socket, [NUMBER.pack(len(data))], descriptors)
        self._socket.sendall(data)
        return int(NUMBER.unpack(_receive(self._socket, NUMBER.size))[0])

    def end(self) -> None:
        """End the server, and with it what it has forked."""
        self._socket.close()
        self._process.kill()
        self._process.wait()


_servers: dict[tuple[int, Wall], ForkServer] = {}  # by the harness's process id: a fork of it has none


def fork_keeper(wall: Wall, config: dict[str, Any], descriptors: Sequence[int]) -> int:
    """Fork a keeper from the wall's server, which is started if there is none; returns its process id.

    A server that has ended is replaced once. Raises InputError if the new one ends as well.
    """
    place = os.getpid(), wall
    for _ in range(2):
        server = _servers.pop(place, None) or ForkServer(wall)
        try:
            process_id = server.fork(config, descriptors)
        except OSError:
            server.end()
        else:
            _servers[place] = server  # not after an interruption: its answer would be read later
            return process_id
    raise InputError("no process of its own can be started for third-party code: is there enough memory?")


@atexit.register
def end_servers() -> None:
    """End the servers of this process, after the conversations with what they forked."""
    for place in [each for each in _servers if each[0] == os.getpid()]:
        _servers.pop(place).end()


def main() -> None:
    """Answer requests until the harness ends, of which forks may hold copies of its end of the socket."""
    harness, parent = socket.socket(fileno=int(sys.argv[1])), os.getppid()
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # the system forgets keepers that have ended
    with contextlib.suppress(OSError):
        while os.getppid() == parent:
            if not select.select([harness], [], [], TICK)[0]:
                continue
            header, descriptors, _, _ = socket.recv_fds(harness, NUMBER.size, DESCRIPTORS)
            if len(header) < NUMBER.size:
                return
            config = json.loads(_receive(harness, NUMBER.unpack(header)[0]))
            with without_collector():
                for module in config["preloaded"]:
                    import_module(module)
            gc.freeze()  # a collection would copy every page that forks share
            harness.sendall(NUMBER.pack(_fork(config, harness, descriptors)))
            for each in descriptors:
                os.close(each)


def _fork(config: dict[str, Any], harness: socket.socket, descriptors: Sequence[int]) -> int:
    from xmarl_bench.isolation.keeper import keep  # imported lazily: the harness needs no psutil

    process_id = os.fork()
    if process_id == 0:
        try:
            harness.close()
            os.setsid()
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            keep(config, *descriptors)
        finally:
            os._exit(0)
    return process_id


def _receive(end: socket.socket, n_bytes: int) -> bytes:
    """Raises OSError if the other end is closed before."""
    data = bytearray()
    while len(data) < n_bytes:
        part = end.recv(n_bytes - len(data))
        if not part:
            raise ConnectionResetError
        data += part
    return bytes(data)


if __name__ == "__main__":
    main()
