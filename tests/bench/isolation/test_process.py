"""A stranger's processes end with the harness, at a limit, and when they neither take nor give an answer."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import psutil
import pytest

from xmarl_bench.errors import InputError
from xmarl_bench.isolation import keeper, process
from xmarl_bench.isolation.limits import UNLIMITED, Limits
from xmarl_bench.isolation.process import Stranger

pytestmark = [pytest.mark.slow, pytest.mark.skipif(os.name != "posix", reason="needs processes of Unix")]
WORKER = "tests.helpers.strange_worker"
PATIENCE = 60.0  # seconds; passes as soon as what it waits for has happened
Strange = Callable[..., Stranger]


@pytest.fixture
def strange(monkeypatch: pytest.MonkeyPatch) -> Strange:
    """strange("deaf", limits) -> a process that does so."""
    monkeypatch.setattr(process, "WORKER", WORKER)

    def start(what: str, limits: Limits = UNLIMITED) -> Stranger:
        monkeypatch.setenv("STRANGE", what)
        return Stranger("explainer strange", limits, "process", light=True)

    return start


def wait_until(happened: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not happened():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def gone(pid: int) -> bool:
    try:
        return bool(psutil.Process(pid).status() == psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return True


def test_a_process_that_stops_reading_or_answering_is_ended_at_the_deadline(strange: Strange) -> None:
    deaf = "deaf", bytes(2**22), "did not take its question within 1 s"  # more than a pipe holds
    for what, sent, said in (deaf, ("silent", b"", "did not answer within")):
        with strange(what, Limits(answer_seconds=1.0)) as stranger:
            with pytest.raises(InputError, match=rf"explainer strange.* {said}"):
                stranger.ask({"sent": sent})
            assert not stranger.running
            wait_until(partial(gone, stranger.keeper_id))
            with pytest.raises(InputError, match="has ended"):
                stranger.ask({})


def test_what_it_leaves_behind_ends_with_it(strange: Strange) -> None:
    stranger = strange("forks")
    found, _ = stranger.ask({})
    assert not gone(found["left"])
    stranger.close()
    assert gone(found["own"])
    assert gone(found["left"])
    stranger.close()  # again: nothing to do


def test_a_process_that_ended_after_it_was_found_does_not_keep_others_alive() -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as child:
        found = psutil.Process(child.pid)
        child.wait()
    assert not keeper._is_alive(found)
    assert keeper._is_alive(psutil.Process())


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ("crash", r"ended \(exit code 3\)"),
        ("nonsense", "returned too many bytes"),
        ("not json", "returned invalid JSON"),
    ],
)
def test_a_crash_and_nonsense_are_one_sentence_with_its_name(what: str, said: str, strange: Strange) -> None:
    with strange(what) as stranger, pytest.raises(InputError, match=f"explainer strange.*{said}") as caught:
        stranger.ask({})
    assert str(caught.value).isprintable()


@pytest.mark.skipif(sys.platform != "linux", reason="counts memory as Linux does")
@pytest.mark.parametrize(
    ("what", "limits", "said"),
    [
        ("many", Limits(processes=5), "used more than 5 processes"),
        ("large", Limits(memory_bytes=2**29), r"used more than 0\.5 GiB of memory"),
        ("busy", Limits(cpu_seconds=2), "used more than 2 s of CPU time"),
    ],
)
def test_limits_hold_for_all_its_processes_together(
    what: str, limits: Limits, said: str, strange: Strange
) -> None:
    """Four children hold 150 MiB each, two compute: none passes the limit alone."""
    with strange(what, limits) as stranger:
        with pytest.raises(InputError, match=said):
            stranger.ask({})
        wait_until(partial(gone, stranger.keeper_id))


def test_temporary_folders_are_private_and_deleted(strange: Strange) -> None:
    with strange("told") as one, strange("told") as other:
        folders = [Path(each.ask({})[0]["tmp"]) for each in (one, other)]
        assert folders[0] != folders[1]
        assert all(each.is_dir() and each.stat().st_mode & 0o777 == 0o700 for each in folders)
    assert not any(each.exists() for each in folders)


HARNESS = f"""
import os, signal, time
from xmarl_bench.isolation import process
from xmarl_bench.isolation.limits import UNLIMITED

signal.signal(signal.SIGHUP, signal.SIG_DFL)  # under nohup it is ignored
process.WORKER = {WORKER!r}
stranger = process.Stranger("strange", UNLIMITED, "process", light=True)
found, _ = stranger.ask({{}})
if os.fork() == 0:  # a fork holds the harness's end of every pipe
    time.sleep(3600)
print(stranger.keeper_id, found["own"], found["left"], flush=True)
time.sleep(3600)
"""


@pytest.mark.parametrize("name", ["SIGTERM", "SIGKILL", "SIGHUP"])
def test_nothing_outlives_the_harness(name: str) -> None:
    harness = subprocess.Popen(
        [sys.executable, "-c", HARNESS],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "STRANGE": "forks", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        start_new_session=True,
    )
    try:
        assert harness.stdout is not None
        ids = [int(each) for each in harness.stdout.readline().split()]
        assert len(ids) == 3
        assert not any(map(gone, ids))
        harness.send_signal(getattr(signal, name))
        wait_until(lambda: all(map(gone, ids)))
    finally:
        os.killpg(harness.pid, signal.SIGKILL)
        harness.wait()
