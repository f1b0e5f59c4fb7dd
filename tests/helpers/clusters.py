"""Clusters on loopback for tests: a head and two workers in their own processes, all ended afterwards."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil

ROOT = Path(__file__).parents[2]
SECONDS = 300.0  # for a cluster to start, on a busy machine; only a hang takes so long


@contextmanager
def ray_cluster() -> Iterator[str]:
    """Yields the address of a head with two cores, on which Ray starts two workers.

    It listens on every network interface, and takes work only with the token of this process (see
    conftest.py).
    """
    port = free_port()
    # Not pytest's folder: paths of Ray's sockets may have at most 107 characters.
    with tempfile.TemporaryDirectory(prefix="ray", ignore_cleanup_errors=True) as folder:
        head = start(
            "ray.scripts.scripts", "start", "--head", "--block", f"--port={port}", "--num-cpus=2",
            "--include-dashboard=false", "--disable-usage-stats",
            "--object-store-memory=100000000", f"--temp-dir={folder}",
        )  # fmt: skip
        try:
            wait_for(port, head)
            yield f"127.0.0.1:{port}"
        finally:
            end(head)


@contextmanager
def dask_cluster() -> Iterator[str]:
    """Yields the address of a scheduler with two workers, each a process with one thread and a nanny."""
    from distributed import Client

    port = free_port()
    with tempfile.TemporaryDirectory(prefix="dask", ignore_cleanup_errors=True) as folder:
        address = f"tcp://127.0.0.1:{port}"
        scheduler = start(
            "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", str(port),
            "--dashboard-address", "127.0.0.1:0", "--no-dashboard",
        )  # fmt: skip
        processes = [scheduler]
        try:
            wait_for(port, scheduler)
            processes.append(
                start(
                    "distributed.cli.dask_worker", address, "--local-directory", folder,
                    "--no-dashboard", "--nworkers", "2", "--nthreads", "1",
                )
            )  # fmt: skip
            with Client(address, set_as_default=False) as client:
                client.wait_for_workers(2, timeout=SECONDS)
            yield address
        finally:
            for process in reversed(processes):
                end(process)


def free_port() -> int:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return int(taken.getsockname()[1])


def start(module: str, *arguments: str) -> subprocess.Popen[bytes]:
    """Start a module as a program whose processes can import the tests."""
    paths = [str(ROOT), *os.environ.get("PYTHONPATH", "").split(os.pathsep)]
    return subprocess.Popen(
        [sys.executable, "-m", module, *arguments],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths)), "OMP_NUM_THREADS": "1"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def wait_for(port: int, process: subprocess.Popen[bytes]) -> None:
    until = time.monotonic() + SECONDS
    while time.monotonic() < until:
        assert process.poll() is None, f"{process.args!r} ended with {process.returncode}"
        with socket.socket() as tried:
            if tried.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.1)
    raise AssertionError(f"nothing listens at port {port} after {SECONDS} s")


def end(process: subprocess.Popen[bytes]) -> None:
    """End a program and all processes that it started."""
    family = psutil.Process(process.pid).children(recursive=True) if process.poll() is None else []
    process.terminate()
    _, alive = psutil.wait_procs(family, timeout=3)
    for each in alive:
        each.kill()
    try:
        process.wait(timeout=5)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
