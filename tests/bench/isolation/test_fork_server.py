"""Processes of others are forks of a server: what they share with one another, and what they do not."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
import pytest

from xmarl_bench.isolation import process
from xmarl_bench.isolation.limits import UNLIMITED
from xmarl_bench.isolation.process import Stranger

pytestmark = [pytest.mark.slow, pytest.mark.skipif(os.name != "posix", reason="needs processes of Unix")]
Told = Callable[..., dict[str, Any]]


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> Told:
    """told() -> what a new process says of itself."""
    monkeypatch.setattr(process, "WORKER", "tests.helpers.strange_worker")
    monkeypatch.setenv("STRANGE", "fork")

    def tell(*, light: bool = False) -> dict[str, Any]:
        with Stranger("strange", UNLIMITED, "process", light=light) as stranger:
            return stranger.ask({})[0]

    return tell


def test_forks_have_the_imports_of_one_server_and_nothing_else_in_common(
    told: Told, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "random.py").write_text("raise SystemExit(1)")  # hides no module of the server
    first = told()
    monkeypatch.syspath_prepend("")
    monkeypatch.syspath_prepend(str(tmp_path / "more"))
    second = told()
    assert first["shared"]
    assert second["shared"]
    assert first["server"] == second["server"] != os.getpid()
    assert first["random"] != second["random"]
    assert first["descriptor"] == second["descriptor"] == 3  # the first free one: no pipe of others is open
    assert first["folder"] == second["folder"] == str(tmp_path)
    more = {str(tmp_path), str(tmp_path / "more")}
    assert more <= set(second["path"])
    assert not more & set(first["path"])


def test_a_server_that_was_killed_is_replaced(told: Told) -> None:
    server = told(light=True)["server"]
    psutil.Process(server).send_signal(signal.SIGKILL)
    assert told(light=True)["server"] != server
