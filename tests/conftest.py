"""Fixtures for all tests: bundles of small random policies, and the command line run in this process."""

from __future__ import annotations

import functools
import gc
import os
import re
import secrets
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import pytest
import typer.main

from tests.helpers.light import missing

# Imports nothing that imports torch: the process that distributes tests reads this file too.

gc.disable()  # until all tests are imported: the collector would search what stays anyway

# Ray reads these once per process, at its first use. A head takes work only from processes that have its
# token. By default workers have a low priority, and on a busy machine would wait for minutes.
os.environ |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32), "RAY_worker_niceness": "0"}
os.environ.setdefault("NUMBA_DISABLE_JIT", "1")  # what shap compiles takes 10 s, and runs for milliseconds

MakeBundle = Callable[..., Path]


TESTS = Path(__file__).parent
MARKED = {
    "baselines/training": "training",
    "bench/board/page": "browser",
    "bench/parallel/test_clusters.py": "cluster",
    "benchmarks": "benchmark",
}
# Third-party code runs in processes of its own here; elsewhere in this process, which saves 0.2 s each, 4 s
# for each worker, and sees the plugins that a test registers.
IN_OWN_PROCESSES = (
    "bench/isolation", "bench/plugins", "bench/scoring/test_piece_keys.py",
    "bench/scoring/test_sweep.py", "bench/submission", "docs/test_readme.py", "test_places.py",
)  # fmt: skip
KILLS_WORKERS = TESTS / "bench/parallel/test_fan_out.py"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--light", action="store_true", help="skip tests that need a missing large package")


def pytest_configure(config: pytest.Config) -> None:
    sys.meta_path.append(missing(config.option.light))


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Does not import folders whose marker `-m "not ... and not ..."` excludes."""
    chosen: str = config.option.markexpr
    left_out = re.findall(r"not (\w+)", chosen) if re.fullmatch(r"(not \w+( and |$))+", chosen) else []
    marks = [mark for folder, mark in MARKED.items() if collection_path == TESTS / folder]
    return True if set(marks) & set(left_out) else None


def pytest_sessionstart(session: pytest.Session) -> None:
    """Hypothesis tries the same few examples on every run and machine, without a deadline."""
    if session.config.option.tx:  # this process distributes tests and runs none
        return
    from hypothesis import HealthCheck, settings

    settings.register_profile(
        "tests",
        max_examples=20,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
    )
    settings.load_profile("tests")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Marks folders, and runs files with slow tests first, so that no process waits long for another's last
    file.

    The file that kills workers runs before all others.
    """
    for item in items:
        for folder, mark in MARKED.items():
            # A second marker would hide the arguments of a module's own, as the timer of benchmarks.
            if item.path.is_relative_to(TESTS / folder) and item.get_closest_marker(mark) is None:
                item.add_marker(mark)
    slow = {item.path for item in items if any(map(item.get_closest_marker, {"slow", *MARKED.values()}))}
    items.sort(key=lambda item: (item.path != KILLS_WORKERS, item.path not in slow))
    gc.freeze()  # the collector need not scan imported objects again
    gc.enable()


@pytest.fixture
def short_episodes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 40 steps, where a test cannot say how long: in examples of documents, and after a training."""
    from xmarl_envs import TASKS

    for task in TASKS.values():
        monkeypatch.setattr(task, "default_max_cycles", 40)


@pytest.fixture
def needs_torch() -> None:
    """For tests whose new processes import torch."""
    import torch  # noqa: F401


class Ran(NamedTuple):
    code: int
    out: str
    err: str


RunCli = Callable[..., Ran]


def save_bundle(
    folder: Path, task: str = "blind_navigation_v0", n_agents: int = 3, name: str = "small", seed: int = 0
) -> Path:
    """The folder of a saved random policy, below `folder`."""
    from xmarl_envs import TASKS

    from tests.helpers.policies import small_policy
    from xmarl_bench.policy import save_policy

    policy = small_policy(len(TASKS[task].observation_names), seed)
    place = folder / "policies" / name
    save_policy(
        place, policy, name=name, task=task, n_agents=n_agents, attention_entropy=0.5, training_seed=seed
    )
    return place


@pytest.fixture
def make_bundle(tmp_path: Path) -> MakeBundle:
    """make_bundle(task, n_agents, name, seed) -> a bundle for one test."""
    return partial(save_bundle, tmp_path)


parser = functools.cache(typer.main.get_command)  # a program builds its parser once


@pytest.fixture(autouse=True)
def third_party_code_in_this_process(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if any(request.path.is_relative_to(TESTS / place) for place in IN_OWN_PROCESSES):
        return
    if "torch" not in sys.modules:  # a light installation, or a test that loads little
        return
    from xmarl_bench.plugins import registry
    from xmarl_bench.scoring import entry_records, score, selection

    monkeypatch.setattr(registry, "ask_explainer", lambda name, _=None: registry.find_explainer(name))
    for scoring in (score, selection):
        monkeypatch.setattr(scoring, "Isolation", lambda _: None)
    monkeypatch.setattr(entry_records, "is_shipped_code", lambda _: True)


@pytest.fixture
def as_a_program(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests that call a program's `main`: what it sets in the environment ends with the test."""
    monkeypatch.setenv("PYTHONSAFEPATH", "1")


@pytest.fixture
def run_cli(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path, as_a_program: None
) -> RunCli:
    """run_cli("score", "--task", ...) -> exit code and what was printed; an uncaught exception propagates."""
    from xmarl_bench.cli import main as cli
    from xmarl_bench.cli import program

    monkeypatch.setenv("XMARL_BENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(typer.main, "get_command", parser)
    # This process is the program, and it goes on: the next command's workers need not import torch again.
    monkeypatch.setattr(program, "end_workers", lambda: None)

    def run(*arguments: object) -> Ran:
        monkeypatch.setattr(sys, "argv", ["xmarl-bench", *map(str, arguments)])
        code: object = 0
        try:
            cli.main()
        except SystemExit as stop:
            code = stop.code
        printed = capsys.readouterr()
        return Ran(code if isinstance(code, int) else 0, printed.out, printed.err)

    return run
