"""All benchmarks run on one thread of torch, as training and scoring do."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from xmarl_bench.reproducible import one_thread


@pytest.fixture(autouse=True)
def on_one_thread() -> Iterator[None]:
    with one_thread():
        yield
