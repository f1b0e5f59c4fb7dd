"""A third-party explainer gives the same masks in a process of its own, and does no harm there."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from tests.conftest import MakeBundle
from tests.helpers.policies import random_observations, small_policy
from xmarl_bench.entry.schema import Entry
from xmarl_bench.errors import InputError
from xmarl_bench.explain.explainer import fit_explainer, on_device, run_explainer
from xmarl_bench.explain.sanity import mask_of_shuffled_weights
from xmarl_bench.explain.simulator import Simulator
from xmarl_bench.isolation import conversation, landlock, process
from xmarl_bench.isolation.conversation import Isolation, end_strangers
from xmarl_bench.isolation.limits import Limits
from xmarl_bench.isolation.walls import Wall, strongest
from xmarl_bench.plugins.registry import ask_explainer, find_explainer
from xmarl_bench.scoring.piece_keys import Keys
from xmarl_bench.scoring.score import score

# The first observed number chooses what it does.
CODE = """
import os, socket, time
import torch
from xmarl_bench import Explainer

def fit(policy, observations, generator):
    learned = torch.rand((), generator=generator)

    def explain(policy, observations, generator):
        what = int(observations[0, 0, 0])
        print("chatter", flush=True)
        n_steps, n_agents, _ = observations.shape
        mask = torch.rand(n_steps, n_agents, n_agents, generator=generator) * learned
        if what == 1:
            return mask * float("nan")
        if what == 2:
            raise RuntimeError("two\\\\nlines \\\\x1b[31m")
        if what == 3:
            assert "SECRET_TOKEN" not in os.environ
            assert "SECRET_TOKEN" not in open("/proc/self/environ").read()  # of the server that forked it
        if what == 4:
            socket.create_connection(("127.0.0.1", int(observations[0, 0, 1])), timeout=2).close()
        if what == 5:
            try:
                open(os.path.join(os.path.dirname(__file__), "secret.txt")).close()
            except OSError:
                return mask * 0
        if what == 6:
            open(__file__, "a").write("# more")
        if what == 11:
            raise KeyboardInterrupt("stop")
        if what == 7:
            torch.ones(2**40)
        if what == 8:
            return "not a mask"
        if what == 9:
            time.sleep(3600)
        if what == 10:
            os._exit(3)
        return mask

    return explain

stranger = Explainer("stranger", None, fit=fit, stochastic=True, hyperparameters={"more": 2})
"""
pytestmark = pytest.mark.slow
NOT_HERE = "bubblewrap and user namespaces, or Landlock of version 6, are not at hand"


def wall_or_skip(wall: Wall) -> Isolation:
    if (wall == "bubblewrap" and strongest() != wall) or (wall == "landlock" and not landlock.available()):
        pytest.skip(f"{wall}: {NOT_HERE}")
    return Isolation(Limits(), wall)


@pytest.fixture(autouse=True)
def end() -> Iterator[None]:
    yield
    end_strangers()


@pytest.fixture(scope="module")
def stranger(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("stranger") / "stranger.py"
    path.write_text(CODE)
    path.with_name("secret.txt").write_text("hunter2")
    return f"{path}:stranger"


ACTS: dict[Wall, dict[int, str]] = {
    "process": {3: "AssertionError"},  # the environment, the network and files are open, as documented
    "bubblewrap": {4: "Network is unreachable|Connection refused", 6: "Read-only file|Permission"},
    "landlock": {4: "Operation not permitted", 6: "Permission denied"},
}


@pytest.mark.parametrize("wall", list(ACTS))
def test_masks_are_the_same_and_harmful_acts_are_refused(
    wall: Wall, stranger: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    isolation = wall_or_skip(wall)
    monkeypatch.setenv("SECRET_TOKEN", "hunter2")
    policy, x = small_policy(6), random_observations(5, 3, 6) * 0.1
    own = fit_explainer(find_explainer(stranger), policy, x, 3)
    asked = ask_explainer(stranger, isolation)
    assert (asked.name, asked.stochastic, asked.fit is not None) == ("stranger", True, True)
    assert asked.origin == own.origin
    asked = fit_explainer(asked, policy, x, 3)

    def doing(what: int) -> torch.Tensor:
        observations = x.clone()
        observations[0, 0, 0], observations[0, 0, 1] = what, port
        return run_explainer(asked, policy, observations, 1)

    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        for seed in (0, 1):
            assert torch.equal(run_explainer(own, policy, x, seed), run_explainer(asked, policy, x, seed))
        shuffled = [mask_of_shuffled_weights(each, policy, x, 0) for each in (own, asked)]
        assert torch.equal(*shuffled)  # fitted anew
        refusals = {
            1: "returned NaN",
            2: "RuntimeError: two",
            7: "failed on observations",
            8: "returned a str",
            11: r"'stranger' failed \(KeyboardInterrupt: stop",
            **ACTS[wall],
        }
        for what, said in refusals.items():
            with pytest.raises(InputError, match=said) as caught:
                doing(what)
            assert str(caught.value).isprintable()
        for what in {3, 4} - refusals.keys():
            assert float(doing(what).max()) > 0
        assert bool(doing(5).any()) == (wall == "process")
        for what in (10, 0):  # it is not started again
            with pytest.raises(InputError, match=r"ended \(exit code 3\)"):
                doing(what)


SIMULATED = """
import torch

def imagined(observations, policy, simulator):
    env = simulator.restart(policy, observations)
    for _ in range(3):
        env.step(policy.distribution(torch.from_numpy(env.observe())).action.detach().numpy())
    position = torch.from_numpy(env.state.position).float()
    return torch.exp(-torch.cdist(position, position))
"""


def test_strangers_play_on_in_their_process_too(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(SIMULATED)
    name, policy, x = f"{tmp_path / 'own.py'}:imagined", small_policy(6), random_observations(5, 3, 6)
    asked = ask_explainer(name)
    assert asked.simulates
    for seed in (1, 2):
        simulator = Simulator("blind_navigation_v0", 3, seed)
        own, theirs = (replace(each, simulator=simulator) for each in (find_explainer(name), asked))
        assert torch.equal(run_explainer(own, policy, x, 0), run_explainer(theirs, policy, x, 0))
    with pytest.raises(InputError, match="plays on in the world of an episode"):
        run_explainer(asked, policy, x, 0)


def test_the_device_is_that_of_the_run(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(
        "import torch\nfrom xmarl_bench import as_explainer\n\n@as_explainer(any_device=True)\n"
        "def mine(observations):\n"
        "    return torch.full((len(observations), 3, 3), float(observations.device.type == 'meta'))\n"
    )
    asked, x = ask_explainer(f"{tmp_path / 'own.py'}:mine"), random_observations(5, 3, 6)
    there = on_device(asked, "cpu:0")
    assert (there.device, there.elsewhere) == ("cpu:0", replace(asked.elsewhere, device="cpu:0"))  # type: ignore[type-var]
    assert Keys().explainer(asked) != Keys().explainer(there)
    assert asked.elsewhere is not None
    elsewhere = replace(asked, elsewhere=asked.elsewhere.on_device("meta"))  # where nothing is computed
    for explainer, seen in ((asked, 0.0), (elsewhere, 1.0)):
        assert torch.all(run_explainer(explainer, small_policy(6), x, 0) == seen)


@pytest.mark.parametrize(
    ("act", "said"),
    [
        ("while True: pass", ""),
        ("bytes(2**32)", "MemoryError"),
        ("open('large', 'wb').write(bytes(2**22))", "File too large"),
        ("Limits().apply(); bytes(2**32)", "MemoryError"),
    ],
)
def test_limits_hold_and_cannot_be_raised(act: str, said: str, tmp_path: Path) -> None:
    code = (
        "from xmarl_bench.isolation.limits import Limits\n"
        f"Limits(cpu_seconds=1, memory_bytes=2**31, file_bytes=2**20).apply()\n{act}"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert done.returncode != 0
    assert said in done.stderr


def test_the_process_of_code_that_does_not_load_is_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started = []

    class Watched(process.Stranger):
        def __init__(self, *args: Any, **kwargs: Any) -> None:
            super().__init__(*args, **kwargs)
            started.append(self)

    monkeypatch.setattr(conversation, "Stranger", Watched)
    (tmp_path / "broken.py").write_text("import no_such_library")
    with pytest.raises(InputError, match="no_such_library"):
        ask_explainer(f"{tmp_path}/broken.py:stranger", Isolation())
    assert [each.running for each in started] == [False]


def test_code_that_changes_during_a_run_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "own.py"
    file.write_text(CODE)
    found, states = ask_explainer(f"{file}:stranger", Isolation()), random_observations(2, 3, 6)
    states[0, 0, 0] = 0
    fitted = fit_explainer(found, small_policy(6), states, 0)
    end_strangers()  # a worker process starts its own
    run_explainer(fitted, small_policy(6), states, 0)
    end_strangers()
    file.write_text(CODE + "# more")
    with pytest.raises(InputError, match=r"the code of explainer own.py:stranger has changed since it was"):
        run_explainer(fitted, small_policy(6), states, 0)


def test_limits_must_be_above_zero_and_finite() -> None:
    with pytest.raises(InputError, match="cpu_seconds must be more than 0 and finite, got 0"):
        Limits(cpu_seconds=0)
    values: Any = (float("nan"), float("inf"), None)
    for value in values:
        with pytest.raises(InputError, match=f"answer_seconds must be more than 0 and finite, got {value}"):
            Limits(answer_seconds=value)


@pytest.mark.parametrize("wall", ["bubblewrap", "landlock"])
def test_a_wall_hides_the_harness_and_its_files(wall: Wall, tmp_path: Path) -> None:
    """Neither its processes, nor their memory, nor its temporary files; its own temporary folder works."""
    isolation = wall_or_skip(wall)
    (tmp_path / "own.py").write_text(SPY)
    (tmp_path / "piece").write_text("measured")
    pid, policy = os.getpid(), small_policy(6)
    asked = ask_explainer(f"{tmp_path / 'own.py'}:spy", isolation)
    x = torch.full((1, 3, 6), float(pid))
    with pytest.raises(InputError) as caught:
        run_explainer(asked, policy, x, 0)
    found = re.search(r"found (.*?)\)", str(caught.value))
    assert found is not None
    assert found[1] == "nothing"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["own.py", "piece"]


SPY = """
import glob, os, signal, socket, tempfile

def able(act):
    try:
        return act() is not False
    except OSError:
        return False

def spy(observations, policy):
    pid = int(observations[0, 0, 0])
    beside = os.path.join(os.path.dirname(__file__), "piece")
    able(lambda: open(beside + "2", "w").close())
    with tempfile.TemporaryFile() as file:
        file.write(b"works")
    acts = {
        "signal": lambda: os.kill(pid, 0),
        "memory": lambda: open(f"/proc/{pid}/mem", "rb").close(),
        "environment": lambda: open(f"/proc/{pid}/environ", "rb").read(1),
        "piece": lambda: open(beside).read(),
        "internet": lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM).sendto(b"x", ("192.0.2.1", 9)),
    }
    found = ", ".join(name for name, act in acts.items() if able(act)) or "nothing"
    raise RuntimeError(f"found {found}")
"""


def test_systems_without_such_processes_are_refused_in_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process, "UNIX", False)
    with pytest.raises(InputError, match=r"which \w+ does not offer: run this on Linux or macOS, or"):
        ask_explainer("tests.helpers.example_plugins:slow")


@pytest.mark.slow
def test_scores_in_threads_do_not_end_one_another(make_bundle: MakeBundle) -> None:
    def own(seconds: float) -> Entry:
        def explain(observations: torch.Tensor) -> torch.Tensor:
            time.sleep(seconds)
            return torch.full((len(observations), 3, 3), seconds)

        return score(folder, explain, episodes=1, max_cycles=4, behaviour_episodes=0)

    folder = make_bundle()
    with ThreadPoolExecutor(2) as pool:
        masses = [each.results[0].metrics.mask_mass for each in pool.map(own, (0.5, 0.0))]
    assert [each and each.value for each in masses] == [0.5, 0.0]
