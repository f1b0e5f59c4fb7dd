"""Times two programs that do the same work in turns, so that other load on the machine slows both."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from pytest_benchmark.fixture import BenchmarkFixture

from tests.benchmarks.conftest import Report

Run = Callable[[], object]


def side_by_side(
    benchmark: BenchmarkFixture,
    report: Report,
    what: str,
    ours: Run,
    theirs: Run,
    *,
    n_steps: int,
    bar: float | None,
    rounds: int = 7,
) -> None:
    """Fails if ours is less than `bar` times as fast as theirs, in the median over rounds.

    Each run takes `n_steps` steps of one environment (64 steps of a batch of 64 are 4096). A round is one run
    of theirs and one of ours. Times are CPU time of this process.
    """
    ours()
    theirs()
    peer: list[float] = []

    def time_theirs() -> None:
        started = time.process_time()
        theirs()
        peer.append(time.process_time() - started)

    benchmark.pedantic(ours, setup=time_theirs, rounds=rounds)  # type: ignore[no-untyped-call]
    if benchmark.stats is None:  # --benchmark-disable
        return
    mine = np.array(benchmark.stats.stats.data)
    ratios = np.array(peer) / mine
    ratio = float(np.median(ratios))
    ours_per_s, theirs_per_s = n_steps / np.median(mine), n_steps / np.median(peer)
    benchmark.extra_info |= {
        "ours_steps_per_s": round(ours_per_s),
        "theirs_steps_per_s": round(theirs_per_s),
        "ratio": round(ratio, 2),
        "bar": bar,
    }
    report(
        "environment steps per second: ours, theirs; ratio, its range over rounds, its bar",
        f"{what:<60}{ours_per_s:>11,.0f}{theirs_per_s:>11,.0f}{ratio:>8.2f}"
        f" ({ratios.min():.2f}-{ratios.max():.2f})" + (f" >= {bar:g}" if bar is not None else ""),
    )
    assert bar is None or ratio >= bar, f"{what}: {ratio:.2f} times as fast, should be {bar:g}"
