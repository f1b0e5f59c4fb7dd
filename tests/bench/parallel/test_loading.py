"""A worker loads what it needs without the garbage collector, and computes with it."""

from __future__ import annotations

import gc
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import pytest

from xmarl_bench.parallel.calls import outcome, send
from xmarl_bench.parallel.loading import without_collector


class Loaded:
    """Unpickled as whether the collector is on."""

    def __reduce__(self) -> tuple[Callable[[], bool], tuple[()]]:
        return gc.isenabled, ()


def states(when_loaded: object) -> tuple[object, bool]:
    return when_loaded, gc.isenabled()


def submit(function: Callable[..., Any], *args: object) -> Future[Any]:
    done: Future[Any] = Future()
    done.set_result(function(*args))
    return done


def test_a_call_is_loaded_without_the_collector_and_runs_with_it() -> None:
    assert outcome(send(submit, states, Loaded()).result()) == (False, True)


def test_the_collector_is_as_before_whatever_happens() -> None:
    with pytest.raises(ImportError), without_collector():
        raise ImportError
    assert gc.isenabled()
    with without_collector():
        with without_collector():
            pass
        assert not gc.isenabled()
    assert gc.isenabled()
