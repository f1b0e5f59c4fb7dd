"""Where joblib sends units of work: to loky's processes on this machine, or to Ray or Dask anywhere.

All three extend joblib as its documentation has it (`joblib.parallel.ParallelBackendBase`). The ready-made
backends lose units when a worker dies: loky's raises for all that are under way; Dask's waits for ever for a
unit that killed its worker (joblib 1.6 calls nothing back where a future of Dask ends in error); Ray's is a
pool that returns no generator.
"""

from __future__ import annotations

import contextlib
import logging
import os
import socket
import threading
import time
import warnings
from abc import abstractmethod
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from queue import Empty, SimpleQueue
from typing import Any

from joblib.executor import get_memmapping_executor
from joblib.externals.loky import BrokenProcessPool
from joblib.externals.loky.process_executor import ShutdownExecutorError
from joblib.parallel import BatchedCalls, ParallelBackendBase

from xmarl_bench.errors import InputError
from xmarl_bench.parallel.workers import Workers

CONNECT_SECONDS = 20.0  # for a cluster to answer
WORKER_SECONDS = 60.0  # for the first worker of a cluster to be there
AHEAD = 2  # units under way for each worker, so that none waits for the next
RAY_STORE_BYTES = 200 * 2**20  # shared memory of a Ray that is started here; results pass through it

Finished = Callable[[object], None]


class Died:
    """Instead of the result of a unit: the worker that computed it is gone."""

    def __init__(self, index: int) -> None:
        self.index = index


class Backend(ParallelBackendBase):  # type: ignore[misc]  # joblib has no types
    """What the three have in common. A call is one unit: its first argument is the unit's index.

    joblib is told of a finished unit when the caller asks for the next one (`deliver`), in the caller's own
    thread: so units are taken no faster than results are, and nothing piles up in this process.
    """

    supports_retrieve_callback = True

    def __init__(self, n_workers: int, ahead: int | None = None) -> None:
        super().__init__(nesting_level=0)
        self.n_workers = n_workers
        self.ahead = AHEAD * n_workers if ahead is None else ahead  # units under way
        self._finished: SimpleQueue[tuple[int, Any, Finished]] = SimpleQueue()

    def effective_n_jobs(self, n_jobs: int) -> int:
        """Not the number of workers: how many units joblib takes from the iterator at once. At 1 it would
        compute in this process."""
        return 2

    def submit(self, func: BatchedCalls, callback: Finished) -> Any:
        ((_, (index, *_), _),) = func.items
        future = self.send(func)
        future.add_done_callback(lambda done: self._finished.put((index, done, callback)))
        return future

    def deliver(self) -> None:
        """Wait for a unit to finish and hand it to joblib, which then sends the next one."""
        index, future, callback = self._finished.get()
        callback((index, future))

    def retrieve_result_callback(self, out: tuple[int, Any]) -> list[object]:
        index, future = out
        try:
            result: list[object] = future.result()
        except self.deaths():
            return [Died(index)]
        return result

    def abort_everything(self, ensure_ready: bool = True) -> None:
        self.kill()

    @abstractmethod
    def send(self, call: Callable[[], object]) -> Any:
        """A future of what `call` returns on some worker."""

    @abstractmethod
    def deaths(self) -> tuple[type[BaseException], ...]:
        """What a future raises where its worker died."""

    @abstractmethod
    def kill(self) -> None:
        """Stop what is under way."""


class LokyBackend(Backend):
    """Processes of this machine, kept between calls as joblib keeps them: idle ones end after 5 minutes."""

    def __init__(self, n_workers: int) -> None:
        super().__init__(n_workers)
        self._executor = self._start()

    def _start(self) -> Any:
        # Joblib's own, and not loky's: a process has but one, and joblib fails on another that it finds.
        return get_memmapping_executor(
            self.n_workers,
            timeout=300,
            env=dict.fromkeys(self.MAX_NUM_THREADS_VARS, "1"),  # workers do not fight for cores
            initializer=_end_with,
            initargs=(os.getpid(),),
        )

    def send(self, call: Callable[[], object]) -> Any:
        try:
            return self._executor.submit(call)
        except (BrokenProcessPool, ShutdownExecutorError):  # a worker died, and loky ended the others
            self._executor = self._start()
            return self._executor.submit(call)

    def deaths(self) -> tuple[type[BaseException], ...]:
        return BrokenProcessPool, ShutdownExecutorError

    def kill(self) -> None:
        work_ids = self._executor._work_ids  # loky's thread fails on those it has not handed out yet
        with contextlib.suppress(Empty):
            while True:
                work_ids.get_nowait()
        self._executor.shutdown(wait=True, kill_workers=True)


def _end_with(parent: int) -> None:
    """Let this process end when its parent is gone, however it went: workers of loky would go on."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


class RayBackend(Backend):
    """Tasks of Ray, one core each, never repeated by Ray itself."""

    def __init__(self, n_workers: int, ahead: int | None) -> None:
        import ray

        super().__init__(n_workers, ahead)
        self._remote = ray.remote(num_cpus=1, max_retries=0)(_call)
        self._running: dict[Any, Any] = {}  # reference by future

    def send(self, call: Callable[[], object]) -> Any:
        reference = self._remote.remote(call)
        future = reference.future()
        self._running[future] = reference
        future.add_done_callback(lambda done: self._running.pop(done, None))
        return future

    def deaths(self) -> tuple[type[BaseException], ...]:
        from ray.exceptions import NodeDiedError, ObjectLostError, OutOfMemoryError, WorkerCrashedError

        return WorkerCrashedError, OutOfMemoryError, NodeDiedError, ObjectLostError

    def kill(self) -> None:
        import ray

        for reference in list(self._running.values()):
            ray.cancel(reference, force=True)


def _call(call: Callable[[], object]) -> object:
    return call()


class DaskBackend(Backend):
    """Tasks of Dask, on workers of one thread: units set the seeds of their whole process."""

    def __init__(self, client: Any, n_workers: int, ahead: int | None) -> None:
        super().__init__(n_workers, ahead)
        self._client = client
        self._running: set[Any] = set()

    def send(self, call: Callable[[], object]) -> Any:
        future = self._client.submit(call, pure=False)
        self._running.add(future)
        future.add_done_callback(self._running.discard)
        return future

    def deaths(self) -> tuple[type[BaseException], ...]:
        from distributed import KilledWorker

        return (KilledWorker,)

    def kill(self) -> None:
        self._client.cancel(list(self._running), force=True)


@contextlib.contextmanager
def connected(workers: Workers) -> Iterator[Backend]:
    """The workers, until the end of the block. Raises InputError where they cannot be had."""
    if workers.backend == "loky":
        with warnings.catch_warnings():
            # Loky replaces a worker whose memory has grown by 300 MB, between two units: that loses nothing.
            warnings.filterwarnings("ignore", message="A worker stopped while some jobs were given")
            yield LokyBackend(workers.jobs or os.cpu_count() or 1)
        return
    needed = {"ray": "ray", "dask": "distributed"}[workers.backend]
    if find_spec(needed) is None:
        raise InputError(
            f"backend {workers.backend} needs the package {needed}: "
            f"pip install 'xmarl-bench[{workers.backend}]'."
        )
    if workers.address is not None:
        _check_reachable(workers.backend, workers.address)
    with (_ray if workers.backend == "ray" else _dask)(workers) as backend:
        yield backend


@contextlib.contextmanager
def _ray(workers: Workers) -> Iterator[RayBackend]:
    """A process that is connected already stays so, to where it is."""
    import ray
    from ray.exceptions import RayError

    connect = not ray.is_initialized()
    if connect:
        here: dict[str, Any] = {
            "num_cpus": workers.jobs,
            "include_dashboard": False,
            "object_store_memory": RAY_STORE_BYTES,
        }
        try:
            ray.init(
                workers.address or "local",
                logging_level=logging.ERROR,
                log_to_driver=False,
                **(here if workers.address is None else {}),
            )
        except (ConnectionError, RayError, RuntimeError, TimeoutError, ValueError) as error:
            raise _unreachable("ray", str(workers.address), error) from error
    try:
        has = int(ray.cluster_resources().get("CPU", 0))
        yield RayBackend(max(1, has), _ahead(workers))
    finally:
        if connect:
            ray.shutdown()


@contextlib.contextmanager
def _dask(workers: Workers) -> Iterator[DaskBackend]:
    import dask
    from distributed import Client, LocalCluster

    # Locally a worker that died is this package's to count; elsewhere the scheduler's own setting holds.
    with dask.config.set({"distributed.scheduler.allowed-failures": 0}):
        cluster = None
        if workers.address is None:
            n_workers = workers.jobs or os.cpu_count() or 1
            cluster = LocalCluster(
                n_workers=n_workers,
                threads_per_worker=1,
                processes=True,
                dashboard_address=None,
                silence_logs=logging.CRITICAL,
            )
    try:
        try:
            client = Client(cluster or workers.address, timeout=CONNECT_SECONDS, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise _unreachable("dask", str(workers.address), error) from error
        with client:
            yield DaskBackend(client, _count_dask(client, workers), _ahead(workers))
    finally:
        if cluster is not None:
            cluster.close()


def _count_dask(client: Any, workers: Workers) -> int:
    """Workers of the cluster. Raises InputError where there is none in time, or one with several threads."""
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


def _ahead(workers: Workers) -> int | None:
    """Of a cluster's workers no more than `jobs` are used at a time; one started here has no more."""
    return None if workers.address is None else workers.jobs


def _check_reachable(backend: str, address: str) -> None:
    """Raises InputError where nothing listens at host:port, before clients that try for minutes do."""
    if address == "auto":  # Ray's word for the cluster that this machine is part of
        return
    host, _, port = address.rpartition("://")[2].rpartition(":")
    if not host or not port.isdigit():
        raise InputError(f"address {address} is none: give host:port of the {backend} cluster.")
    try:
        socket.create_connection((host, int(port)), CONNECT_SECONDS).close()
    except OSError as error:
        raise _unreachable(backend, address, error) from error


def _unreachable(backend: str, address: str, error: BaseException) -> InputError:
    reason = " ".join(str(error).split())
    return InputError(f"no {backend} cluster answers at {address} ({reason}): start one, or correct that.")
