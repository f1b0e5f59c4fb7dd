"""Compares two programs that do the same work, timed in turns, so that other load on the machine slows both.

`docs/make_performance.py` makes the tables of docs/performance.md from what `record` keeps.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pytest_benchmark.fixture import BenchmarkFixture

from tests.benchmarks.conftest import Report

Run = Callable[[], object]
Seconds = Sequence[float] | NDArray[np.float64]
Unit = Literal["steps/s", "us", "ms", "s"]
IN_UNIT: dict[Unit, Callable[[float], float]] = {
    "steps/s": lambda seconds: 1.0 / seconds,
    "us": lambda seconds: 1e6 * seconds,
    "ms": lambda seconds: 1e3 * seconds,
    "s": lambda seconds: seconds,
}


def record(
    benchmark: BenchmarkFixture,
    report: Report,
    what: str,
    peer: str,
    *,
    ours: Seconds,
    theirs: Seconds,
    unit: Unit,
    bar: float | None = None,
    remark: str = "",
) -> None:
    """Keep a comparison with the benchmark and print it. Fails if the median ratio is below `bar`.

    ours, theirs: CPU seconds of one piece of work in each round, (rounds,) each. remark: what a reader has to
    know to compare the two.
    """
    ratios = np.array(theirs) / np.array(ours)
    ratio = float(np.median(ratios))
    shown = IN_UNIT[unit]
    row = {
        "what": what,
        "peer": peer,
        "unit": unit,
        "ours": shown(float(np.median(ours))),
        "theirs": shown(float(np.median(theirs))),
        "ratio": ratio,
        "low": float(ratios.min()),
        "high": float(ratios.max()),
        "bar": bar,
        "remark": remark,
    }
    benchmark.extra_info.setdefault("comparisons", []).append(row)
    report(
        "ours, theirs; times as fast, its range over rounds, its bar",
        f"{what} / {peer}".ljust(76) + f"{row['ours']:>12,.4g}{row['theirs']:>12,.4g} {unit}{ratio:>8.2f}"
        f" ({ratios.min():.2f}-{ratios.max():.2f})" + (f" >= {bar:g}" if bar is not None else ""),
    )
    assert bar is None or ratio >= bar, f"{what}: {ratio:.2f} times as fast as {peer}, should be {bar:g}"


def side_by_side(
    benchmark: BenchmarkFixture,
    report: Report,
    what: str,
    peer: str,
    ours: Run,
    theirs: Callable[[], float],
    *,
    pieces: int,
    their_pieces: int | None = None,
    unit: Unit = "steps/s",
    bar: float | None = None,
    rounds: int = 7,
    remark: str = "",
) -> None:
    """A round is one run of theirs and one of ours; see `record`.

    theirs: runs theirs and returns its CPU seconds, see `clocked`. pieces: of work in a run of ours (64 steps
    of a batch of 64 are 4096), and in one of theirs if it does fewer. The benchmark's timer has to be
    `time.process_time`.
    """
    ours()
    theirs()
    seconds: list[float] = []
    benchmark.pedantic(  # type: ignore[no-untyped-call]
        ours, setup=lambda: seconds.append(theirs()), rounds=rounds
    )
    if benchmark.stats is None:  # --benchmark-disable
        return
    record(
        benchmark,
        report,
        what,
        peer,
        ours=np.array(benchmark.stats.stats.data) / pieces,
        theirs=np.array(seconds) / (their_pieces or pieces),
        unit=unit,
        bar=bar,
        remark=remark,
    )


def clocked(run: Run) -> Callable[[], float]:
    """Calls `run` and returns the CPU seconds of this process that it took."""

    def seconds() -> float:
        started = time.process_time()
        run()
        return time.process_time() - started

    return seconds
