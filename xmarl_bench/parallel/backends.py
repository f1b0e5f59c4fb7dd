"""Where units of work run: loky processes on this machine, or a Ray or Dask cluster.

Each backend offers `submit(function, *args) -> concurrent.futures.Future`, and uses public interfaces only.
"""

from __future__ import annotations

import logging
import os
import shutil
import socket
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Future
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any
from weakref import WeakKeyDictionary

import psutil

from xmarl_bench.errors import InputError
from xmarl_bench.parallel.calls import kept_in
from xmarl_bench.parallel.program_end import pools
from xmarl_bench.parallel.workers import Workers

CONNECT_SECONDS = 20.0  # timeout for a cluster to answer
WORKER_SECONDS = 60.0  # timeout for a cluster's first worker
IDLE_SECONDS = 300.0  # idle loky processes end after this time
RAY_STORE_BYTES = 200 * 2**20  # shared memory of a Ray that we start; results pass through it
LIBRARIES = ("OMP_NUM", "MKL_NUM", "OPENBLAS_NUM", "BLIS_NUM", "VECLIB_MAXIMUM", "NUMBA_NUM", "NUMEXPR_NUM")
ONE_THREAD = {f"{library}_THREADS": "1" for library in LIBRARIES}  # workers do not compete for cores


@dataclass(frozen=True)
class Backend:
    """Connected workers."""

    submit: Callable[..., Future[Any]]
    kill: Callable[[Iterable[Future[Any]]], object]  # stops the units under way
    deaths: tuple[type[BaseException], ...]  # a future raises one of these if its worker died
    n_workers: int


@contextmanager
def connected(workers: Workers) -> Iterator[Backend]:
    """Connect to workers for the block. Raises InputError if they are not available."""
    name, address = workers.backend, workers.address
    start, needed = {"loky": (_loky, "loky"), "ray": (_ray, "ray"), "dask": (_dask, "distributed")}[name]
    if find_spec(needed) is None:
        raise InputError(f"backend {name} needs the package {needed}: pip install 'xmarl-bench[{name}]'.")
    if address is not None and address != "auto":  # Ray's name for the cluster of this machine
        host, _, port = address.rpartition("://")[2].rpartition(":")
        if not host or not port.isdigit():
            raise InputError(f"address {address} is invalid: give host:port of the {name} cluster.")
        with _answering(workers, OSError):  # fail early: the clients retry for minutes
            socket.create_connection((host, int(port)), CONNECT_SECONDS).close()
    with start(workers) as backend:
        yield backend


@contextmanager
def _answering(workers: Workers, *errors: type[Exception]) -> Iterator[None]:
    """Turn errors of a connection into an InputError that names the cluster."""
    try:
        yield
    except errors as error:
        raise InputError(
            f"no {workers.backend} cluster answers at {workers.address} ({' '.join(str(error).split())}): "
            f"start one, or correct the address."
        ) from error


@contextmanager
def _loky(workers: Workers) -> Iterator[Backend]:
    """Processes of this machine, kept between calls. Long answers come in files.

    All workers share one pipe for answers: if one is killed while it writes a long answer, the main process
    waits forever for the rest.
    """
    from loky import get_reusable_executor
    from loky.process_executor import ShutdownExecutorError

    n_workers = workers.jobs or os.cpu_count() or 1
    deaths = (BrokenExecutor, ShutdownExecutorError)

    def pool() -> Any:
        """The current pool. If a worker died, loky ends the others, and this is a new pool."""
        pools[os.getpid()] = get_reusable_executor(
            n_workers, timeout=IDLE_SECONDS, env=ONE_THREAD, initializer=_end_with, initargs=(os.getpid(),)
        )
        return pools[os.getpid()]

    def submit(function: Callable[..., Any], *args: object) -> Any:
        try:
            return pool().submit(_by_file, folder, function, *args)
        except deaths:  # the pool broke after we got it
            return pool().submit(_by_file, folder, function, *args)

    def kill(_: object) -> None:
        pool().shutdown(wait=True, kill_workers=True)

    with warnings.catch_warnings(), tempfile.TemporaryDirectory(prefix="xmarl-bench-") as folder:
        # Between two units, loky replaces a worker whose memory has grown by 300 MB: nothing is lost.
        warnings.filterwarnings("ignore", message="A worker (stopped|was restarted) while some jobs")
        yield Backend(submit, kill, deaths, n_workers)


_folders: set[str] = set()  # folders that this worker writes answers to


def _by_file(folder: str, function: Callable[..., bytes], *args: object) -> object:
    _folders.add(folder)
    return kept_in(folder, function(*args))


def _end_with(parent: int) -> None:
    """End this process when its parent has ended: loky's workers would continue."""

    def watch() -> None:
        while os.getppid() == parent and psutil.pid_exists(parent):  # on Windows getppid never changes
            time.sleep(0.5)
        for folder in _folders:
            shutil.rmtree(folder, ignore_errors=True)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _ray(workers: Workers) -> Iterator[Backend]:
    """Ray tasks of one core each, which Ray does not retry. An existing connection is used and left open."""
    import ray
    from ray.exceptions import NodeDiedError, ObjectLostError, OutOfMemoryError, RayError, WorkerCrashedError

    remote = ray.remote(num_cpus=1, max_retries=0)(_call)
    references: WeakKeyDictionary[Future[Any], Any] = WeakKeyDictionary()

    def submit(function: Callable[..., Any], *args: object) -> Future[Any]:
        reference = remote.remote(function, *args)
        future: Future[Any] = reference.future()
        references[future] = reference
        return future

    def kill(under_way: Iterable[Future[Any]]) -> None:
        for future in under_way:
            if not future.done():
                ray.cancel(references[future], force=True)

    connect = not ray.is_initialized()
    if connect:
        here: dict[str, Any] = {"num_cpus": workers.jobs, "include_dashboard": False}
        here = {} if workers.address else {**here, "object_store_memory": RAY_STORE_BYTES}
        with _answering(workers, ConnectionError, RayError, RuntimeError, TimeoutError, ValueError):
            ray.init(workers.address or "local", logging_level=logging.ERROR, log_to_driver=False, **here)
    try:
        deaths = (WorkerCrashedError, OutOfMemoryError, NodeDiedError, ObjectLostError)
        yield Backend(submit, kill, deaths, int(ray.cluster_resources().get("CPU", 1)))
    finally:
        if connect:
            ray.shutdown()


def _call(function: Callable[..., Any], *args: object) -> object:
    return function(*args)


@contextmanager
def _dask(workers: Workers) -> Iterator[Backend]:
    """Dask tasks on workers of one thread each: a unit seeds its whole process."""
    import dask
    from distributed import Client, KilledWorker

    here: dict[str, Any] = {"n_workers": workers.jobs or os.cpu_count() or 1, "threads_per_worker": 1}
    here = {} if workers.address else {**here, "dashboard_address": None, "silence_logs": logging.CRITICAL}
    # We count retries ourselves; on a running cluster the scheduler's own setting applies.
    ours = {"distributed.scheduler.allowed-failures": 0, "scheduler-address": None}
    with dask.config.set(ours), _answering(workers, OSError, TimeoutError, ValueError):
        client = Client(workers.address, timeout=CONNECT_SECONDS, set_as_default=False, **here)
    with client:
        executor = client.get_executor(pure=False)
        n_workers = _count_dask(client, workers)
        yield Backend(executor.submit, lambda _: executor.shutdown(wait=False), (KilledWorker,), n_workers)


def _count_dask(client: Any, workers: Workers) -> int:
    """The number of workers. Raises InputError if none joins in time or if one has several threads."""
    try:
        client.wait_for_workers(1, timeout=WORKER_SECONDS)
    except TimeoutError:
        raise InputError(
            f"the Dask cluster at {workers.address} has no worker after {WORKER_SECONDS:.0f} s: "
            f"start some with `dask worker {workers.address} --nthreads 1`."
        ) from None
    threads: dict[str, int] = client.nthreads()
    for name, n_threads in threads.items():
        if n_threads != 1:
            raise InputError(
                f"the Dask worker {name} has {n_threads} threads, and each unit needs a process of its "
                f"own: start workers with --nthreads 1 --nworkers N."
            )
    return len(threads)
