"""All benchmarks run on one thread of torch, as training and scoring do; tables are printed at the end."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from xmarl_bench.reproducible import one_thread

Report = Callable[[str, str], None]
TABLES = pytest.StashKey[dict[str, list[str]]]()


@pytest.fixture(autouse=True)
def on_one_thread() -> Iterator[None]:
    with one_thread():
        yield


@pytest.fixture
def report(request: pytest.FixtureRequest) -> Report:
    """`report(title, line)` prints a line under that title at the end of the run."""
    tables = request.config.stash.setdefault(TABLES, {})

    def add(title: str, line: str) -> None:
        tables.setdefault(title, []).append(line)

    return add


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    for title, lines in terminalreporter.config.stash.get(TABLES, {}).items():
        terminalreporter.section(title)
        for line in lines:
            terminalreporter.line(line)
