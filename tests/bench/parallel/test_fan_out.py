"""Fan-out on this machine: results, processes, and failures of units or workers."""

from __future__ import annotations

import os
import pickle
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from loky import get_reusable_executor

from tests.helpers import units_of_work
from xmarl_bench.errors import InputError
from xmarl_bench.parallel.backends import connected
from xmarl_bench.parallel.calls import kept_in, outcome, send
from xmarl_bench.parallel.fan_out import AHEAD, Failure, WorkerDiedError, fan_out, in_order
from xmarl_bench.parallel.workers import BackendName, Workers

TWO = Workers(2)
BOTH = pytest.mark.parametrize(
    "workers", [pytest.param(Workers(), id="here"), pytest.param(TWO, id="two", marks=pytest.mark.slow)]
)


@BOTH
def test_every_unit_returns_once_with_its_index(workers: Workers) -> None:
    returned = list(fan_out(units_of_work.square, range(2, 30), workers=workers))
    assert sorted(returned) == [(k, (k + 2) ** 2) for k in range(28)]
    assert list(fan_out(units_of_work.square, [], workers=workers)) == []
    assert list(in_order(units_of_work.square, range(28), workers=workers)) == [k * k for k in range(28)]


@pytest.mark.slow
def test_one_job_runs_in_this_process_and_two_in_two_others(tmp_path: Path) -> None:
    assert {pid for _, pid in fan_out(units_of_work.process, range(3))} == {os.getpid()}
    units = [str(tmp_path)] * 20
    pids = {pid for _, pid in fan_out(units_of_work.process_beside_another, units, workers=TWO)}
    assert len(pids) >= 2  # loky may replace one
    assert os.getpid() not in pids


@pytest.mark.slow
def test_a_worker_computes_with_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    for _, seen in fan_out(units_of_work.threads, range(4), workers=TWO):
        assert seen == {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


@pytest.mark.slow
def test_other_code_can_use_loky_before_and_after() -> None:
    """All users in a thread share loky's pool of processes."""
    for k in (3, 4):
        assert get_reusable_executor(3).submit(units_of_work.square, k).result() == k * k
        assert dict(fan_out(units_of_work.square, [k, k], workers=TWO)) == {0: k * k, 1: k * k}


@pytest.mark.slow
def test_a_fan_out_that_ends_early_does_not_affect_another(tmp_path: Path) -> None:
    """Both use the same workers, which the end of one kills; units of the other are retried."""

    def broken() -> Iterator[int]:
        yield 1
        raise InputError("no more of them.")

    gate = tmp_path / "gate"
    other = fan_out(units_of_work.square_behind, [(k, gate) for k in range(9)], workers=TWO)
    returned = [next(other)]  # the first unit returns; all others wait
    with pytest.raises(InputError, match="no more of them"):
        next(fan_out(units_of_work.square, broken(), workers=TWO))
    gate.touch()
    returned += other
    assert sorted(returned) == [(k, k * k) for k in range(9)]


@pytest.mark.slow
def test_long_answers_do_not_go_through_the_shared_pipe() -> None:
    """If a worker is killed while writing one, the main process would wait for the rest for ever."""
    with connected(TWO) as backend:
        sent = [send(backend.submit, units_of_work.zeros, n_bytes) for n_bytes in (10, 10**7)]
        answers = [future.result() for future in sent]
        assert all(len(pickle.dumps(answer)) <= select.PIPE_BUF for answer in answers)
        assert [outcome(answer) for answer in answers] == [bytes(10), bytes(10**7)]
        long = answers[1]
        assert isinstance(long, Path)
        assert list(long.parent.iterdir()) == []
    assert not long.parent.exists()


def test_an_answer_that_cannot_be_stored_fails_its_unit(tmp_path: Path) -> None:
    failure = kept_in(str(tmp_path / "gone"), bytes(10**6))
    assert isinstance(failure, Failure)
    assert failure.error.startswith("FileNotFoundError")


@BOTH
def test_units_are_taken_no_faster_than_results_are_read(workers: Workers) -> None:
    taken = 0

    def count() -> Iterator[int]:
        nonlocal taken
        for k in range(10**9):  # too many for a list
            taken += 1
            yield k

    returned = fan_out(units_of_work.square, count(), workers=workers)
    ahead = 0 if workers.in_this_process else 2 * AHEAD - 1
    for received in range(1, 41):
        next(returned)
        assert taken == received + ahead
    returned.close()  # type: ignore[attr-defined]


@BOTH
def test_a_unit_that_raises_does_not_stop_the_others(workers: Workers) -> None:
    returned = dict(fan_out(units_of_work.fail, [0, 1, 2, 3, 5], workers=workers))
    failures = {k: each for k, each in returned.items() if isinstance(each, Failure)}
    assert (returned[0], returned[4]) == (0, 5)
    assert [failures[k].error for k in (1, 2, 3)] == [
        "a sentence of its own.",
        "KeyError: 'missing'",
        "AwkwardError: one",
    ]
    for failure in failures.values():
        assert failure.traceback is not None
        assert "units_of_work.py" in failure.traceback  # the traceback of the worker


@pytest.mark.slow
def test_a_unit_that_cannot_be_sent_fails_alone() -> None:
    units = [units_of_work.Unpicklable(), units_of_work.Unloadable(), 4, 6]
    returned = dict(fan_out(units_of_work.fail, units, workers=TWO))
    errors = [each.error for _, each in sorted(returned.items()) if isinstance(each, Failure)]
    assert errors[0] == "TypeError: this cannot be sent"
    assert errors[1].startswith("ValueError: invalid literal for int()")
    assert errors[2].startswith("TypeError: cannot pickle 'generator' object")
    assert returned[3] == 6


@BOTH
def test_in_order_raises_the_first_error_unchanged(workers: Workers) -> None:
    with pytest.raises(InputError, match=r"^a sentence of its own\.$"):
        list(in_order(units_of_work.fail, [0, 1, 5], workers=workers))
    with pytest.raises(KeyError, match="missing"):
        list(in_order(units_of_work.fail, [0, 2, 5], workers=workers))


@pytest.mark.slow
@BOTH
def test_an_error_of_the_iterator_of_units_is_raised(workers: Workers) -> None:
    def units() -> Iterator[int]:
        yield from range(12)
        raise InputError("no more of them.")

    returned = []
    with pytest.raises(InputError, match="no more of them"):
        for each in fan_out(units_of_work.square, units(), workers=workers):
            returned.append(each)
    assert list(in_order(units_of_work.square, range(5), workers=workers)) == [0, 1, 4, 9, 16]


@pytest.mark.slow
def test_only_the_unit_that_kills_its_worker_fails() -> None:
    returned = dict(fan_out(units_of_work.kill_worker, range(10), workers=TWO))
    killers = [3, 8]
    assert sorted(returned) == list(range(10))
    for k in range(10):
        if k in killers:
            failure = returned[k]
            assert isinstance(failure, Failure)
            assert failure.error.startswith("crashed its worker twice")
            assert failure.traceback is None
        else:
            assert returned[k] == k
    with pytest.raises(WorkerDiedError):
        list(in_order(units_of_work.kill_worker, range(5), workers=TWO))


@pytest.mark.slow
def test_after_a_worker_is_killed_from_outside_all_units_return() -> None:
    expected = [(k, k * k) for k in range(200)]
    returned = []
    for k, each in fan_out(units_of_work.square_and_process, range(200), workers=TWO):
        assert not isinstance(each, Failure)
        square, pid = each
        returned.append((k, square))
        if len(returned) in (20, 90):
            os.kill(pid, signal.SIGKILL)
    assert sorted(returned) == expected


SCRIPT = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # it is ignored if the tests run in the background
from tests.helpers import units_of_work
from xmarl_bench.parallel.fan_out import fan_out
from xmarl_bench.parallel.workers import Workers
list(fan_out(units_of_work.hold, [sys.argv[1]] * 8, workers=Workers(2)))
"""
DEADLINE = 120  # seconds; only a hang takes so long


@pytest.mark.slow
@pytest.mark.parametrize("kill", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_workers_end_with_the_main_process(kill: signal.Signals, tmp_path: Path) -> None:
    """Only the workers hold a pipe open while they live, so it closes when the last one ends."""
    fifo = tmp_path / "held"
    os.mkfifo(fifo)
    pipe = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)
    main = subprocess.Popen([sys.executable, "-c", SCRIPT, str(fifo)], stderr=subprocess.PIPE, text=True)
    workers: list[int] = []
    try:
        while len(workers) < 2:
            begun = _read(pipe, f"{len(workers)} of 2 workers have begun").split()
            assert begun, f"the worker {workers} ended by itself"
            workers += map(int, begun)
        main.send_signal(kill)
        left_over = _read(pipe, f"a worker of {workers} still runs after {kill.name}")
        assert left_over == b"", f"a third worker has begun after {kill.name}"
        _, said = main.communicate(timeout=DEADLINE)
    finally:
        for pid in (main.pid, *workers):
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        os.close(pipe)
    assert main.returncode != 0
    assert "ExecutorManagerThread" not in said  # no errors of other threads
    if kill == signal.SIGINT:
        assert said.rstrip().endswith("KeyboardInterrupt")


STOP = """
import os, signal
from tests.helpers import units_of_work
from xmarl_bench.parallel.program_end import end_workers
from xmarl_bench.parallel.fan_out import fan_out
from xmarl_bench.parallel.workers import Workers
for pid in {pid for _, pid in fan_out(units_of_work.process, range(8), workers=Workers(2))}:
    os.kill(pid, signal.SIGSTOP)
end_workers()
"""


@pytest.mark.slow
def test_a_program_ends_even_if_a_worker_hangs() -> None:
    """Like a worker that waits for a lock of a killed one."""
    assert subprocess.run([sys.executable, "-c", STOP], timeout=DEADLINE, check=False).returncode == 0


def _read(pipe: int, otherwise: str) -> bytes:
    """The next bytes written to the pipe; empty once all its writers have ended."""
    readable, _, _ = select.select([pipe], [], [], DEADLINE)
    assert readable, f"{otherwise}, {DEADLINE} s later"
    return os.read(pipe, 1000)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((0,), "jobs must be at least 1, got 0"),
        ((100_000,), "jobs must be at most .*, 16 for each core, got 100000"),
        ((2, "threads"), "unknown backend 'threads': choose one of loky, ray, dask"),
        ((2, "loky", "10.0.0.1:8786"), "address 10.0.0.1:8786 has no effect with the backend loky"),
    ],
)
def test_invalid_workers_are_refused(arguments: tuple[object, ...], said: str) -> None:
    with pytest.raises(InputError, match=said):
        Workers(*arguments)  # type: ignore[arg-type]


def test_jobs_may_be_a_number_of_numpy() -> None:
    assert type(Workers(np.int64(1)).jobs) is int  # type: ignore[arg-type]


@pytest.mark.parametrize(("backend", "package"), [("ray", "ray"), ("dask", "distributed")])
def test_the_error_for_a_missing_backend_says_what_to_install(
    backend: BackendName, package: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("xmarl_bench.parallel.backends.find_spec", lambda name: None)
    with pytest.raises(
        InputError, match=rf"needs the package {package}: pip install 'xmarl-bench\[{backend}\]'"
    ):
        list(fan_out(units_of_work.square, [1], workers=Workers(2, backend)))


@pytest.mark.slow
@pytest.mark.parametrize(("backend", "client"), [("ray", "ray.init"), ("dask", "distributed.Client")])
@pytest.mark.parametrize(
    ("address", "said"), [("127.0.0.1:9", "no {} cluster answers at"), ("head", "is invalid")]
)
def test_a_cluster_that_does_not_answer_is_refused_without_a_long_wait(
    backend: BackendName, client: str, address: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client, lambda *_, **__: pytest.fail(f"{client} was called"))
    with pytest.raises(InputError, match=said.format(backend)):
        list(fan_out(units_of_work.square, [1], workers=Workers(2, backend, address)))


def test_without_units_no_worker_starts(tmp_path: Path) -> None:
    nowhere = Workers(2, "dask", "127.0.0.1:9")
    assert list(fan_out(units_of_work.square, [], workers=nowhere)) == []
