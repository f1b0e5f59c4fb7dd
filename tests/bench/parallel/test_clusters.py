"""Fan-out on real clusters of Ray and Dask: a head on loopback and two worker processes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import nullcontext
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import MakeBundle
from tests.helpers import units_of_work
from tests.helpers.clusters import dask_cluster, ray_cluster
from tests.helpers.units_of_work import entries, kill_worker_once
from xmarl_bench.errors import InputError
from xmarl_bench.parallel.fan_out import Failure, fan_out, in_order
from xmarl_bench.parallel.workers import BackendName, Workers

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def ray() -> Iterator[str]:
    with ray_cluster() as address:
        yield address


@pytest.fixture(scope="module")
def dask() -> Iterator[str]:
    with dask_cluster() as address:
        yield address


@pytest.fixture(params=["ray", "dask"])
def workers(request: pytest.FixtureRequest) -> Workers:
    backend: BackendName = request.param
    return Workers(None, backend, request.getfixturevalue(backend))


def test_two_processes_compute(workers: Workers, tmp_path: Path) -> None:
    units = [str(tmp_path)] * 30
    pids = {pid for _, pid in fan_out(units_of_work.process_beside_another, units, workers=workers)}
    assert len(pids) >= 2  # a cluster may replace one


def test_all_units_return_even_if_a_worker_is_killed(workers: Workers, tmp_path: Path) -> None:
    units = [(k, tmp_path / "killed" if k == 2 else None) for k in range(6)]
    assert list(in_order(kill_worker_once, units, workers=workers)) == [k * k for k in range(6)]
    assert (tmp_path / "killed").exists()


def test_entries_equal_those_of_one_process(workers: Workers, make_bundle: MakeBundle) -> None:
    """On an open connection to Ray: with one for each fan-out, new workers would import torch each time."""
    import ray

    bundle = make_bundle()
    of_ray = workers.backend == "ray"
    with ray.init(workers.address, log_to_driver=False) if of_ray else nullcontext():
        made = entries(bundle, workers)
        assert ray.is_initialized() == of_ray  # it is left open
    assert made == entries(bundle, Workers())


def test_a_failure_does_not_affect_other_units(workers: Workers) -> None:
    returned = dict(fan_out(units_of_work.fail, [0, 1, 2, 3, 4, 5], workers=workers))
    errors = {k: each.error for k, each in returned.items() if isinstance(each, Failure)}
    assert (returned[0], returned[5], sorted(errors)) == (0, 5, [1, 2, 3, 4])
    assert errors[1] == "a sentence of its own."


def test_jobs_bounds_the_units_under_way(workers: Workers) -> None:
    one = Workers(1, workers.backend, workers.address)
    times = sorted(in_order(units_of_work.started_and_ended, range(6), workers=one))
    assert all(ended <= started for (_, ended), (started, _) in pairwise(times))


@pytest.mark.parametrize("backend", ["ray", "dask"])
def test_a_unit_that_kills_its_workers_fails(backend: BackendName, request: pytest.FixtureRequest) -> None:
    """On local Dask workers, whose scheduler does not retry by itself."""
    workers = (
        Workers(2, "dask") if backend == "dask" else Workers(None, "ray", request.getfixturevalue("ray"))
    )
    returned = dict(fan_out(units_of_work.kill_worker, range(6), workers=workers))
    failure = returned.pop(3)
    assert isinstance(failure, Failure)
    assert failure.error.startswith("crashed its worker twice")
    assert returned == {k: k for k in range(6) if k != 3}


def test_dask_workers_with_several_threads_are_refused() -> None:
    from distributed import LocalCluster

    here: dict[str, Any] = {"host": "127.0.0.1", "processes": False, "protocol": "tcp"}
    with LocalCluster(n_workers=1, threads_per_worker=2, dashboard_address=None, **here) as cluster:
        workers = Workers(None, "dask", cluster.scheduler_address)
        with pytest.raises(InputError, match="has 2 threads, and each unit needs a process of its own"):
            list(fan_out(units_of_work.square, [1], workers=workers))
