"""A third-party explainer gives the same masks in the sandbox, and does no harm."""

from __future__ import annotations

import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from tests.helpers.policies import random_observations, small_policy
from xmarl_bench.errors import InputError
from xmarl_bench.explain.explainer import Explainer, fit_explainer, run_explainer
from xmarl_bench.plugins.registry import find_explainer
from xmarl_bench.rollout.simulator import Simulator
from xmarl_bench.submission import sandbox
from xmarl_bench.submission.limits import Limits, Wall, strongest
from xmarl_bench.submission.sandbox import Sandbox

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
        if what == 4:
            socket.create_connection(("127.0.0.1", int(observations[0, 0, 1])), timeout=2).close()
        if what == 5:
            return mask * os.path.exists(os.path.join(os.path.dirname(__file__), "secret.txt"))
        if what == 6:
            open(__file__, "a").write("# more")
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
WALLS: list[Wall] = ["rlimits"] if strongest() == "rlimits" else [strongest(), "rlimits"]


@pytest.fixture(scope="module")
def stranger(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("stranger") / "stranger.py"
    path.write_text(CODE)
    path.with_name("secret.txt").write_text("hunter2")
    return f"{path}:stranger"


@pytest.mark.parametrize("wall", WALLS)
def test_masks_are_the_same_and_harmful_acts_are_refused(
    wall: Wall, stranger: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SECRET_TOKEN", "hunter2")
    policy, x = small_policy(6), random_observations(5, 3, 6) * 0.1
    own = fit_explainer(find_explainer(stranger), policy, x, 3)

    def doing(what: int) -> torch.Tensor:
        observations = x.clone()
        observations[0, 0, 0], observations[0, 0, 1] = what, port
        return run_explainer(proxy, policy, observations, 1)

    with socket.create_server(("127.0.0.1", 0)) as server, Sandbox(stranger, wall=wall) as sandbox:
        port = server.getsockname()[1]
        declared = sandbox.start()
        assert [declared[name] for name in ("name", "stochastic", "needs_fit")] == ["stranger", True, True]
        assert declared["entry_point"] == "stranger.py:stranger"
        proxy = fit_explainer(Explainer("stranger", sandbox.explains(), fit=sandbox.fit), policy, x, 3)
        for seed in (0, 1):
            assert torch.equal(run_explainer(own, policy, x, seed), run_explainer(proxy, policy, x, seed))
        refusals = {
            1: "returned NaN",
            2: "RuntimeError: two",
            7: "failed on observations",
            8: "returned a str",
        }
        if wall != "rlimits":
            refusals[4] = "Network is unreachable|Connection refused"
        if wall == "bubblewrap":
            refusals[6] = "Read-only file system|Permission denied"
        for what, said in refusals.items():
            with pytest.raises(InputError, match=said) as caught:
                doing(what)
            assert str(caught.value).isprintable()
        if wall == "rlimits":
            assert float(doing(4).max()) > 0  # the network is open, as documented
        assert float(doing(3).max()) > 0
        assert bool(doing(5).any()) == (wall != "bubblewrap")
        if wall == "rlimits":
            with pytest.raises(InputError, match=r"ended \(exit code 3\)"):
                doing(10)
        else:
            sandbox.limits = replace(sandbox.limits, answer_seconds=1.0)
            with pytest.raises(InputError, match="did not answer within 1 s"):
                doing(9)  # it sleeps for an hour
        assert sandbox.process is None
        with pytest.raises(InputError, match="ended"):
            doing(0)


SIMULATED = """
import torch

def imagined(observations, policy, simulator):
    env = simulator.restart(policy, observations)
    for _ in range(3):
        env.step(policy.distribution(torch.from_numpy(env.observe())).action.detach().numpy())
    position = torch.from_numpy(env.state.position).float()
    return torch.exp(-torch.cdist(position, position))
"""


def test_strangers_play_on_behind_the_wall_too(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(SIMULATED)
    name, policy, x = f"{tmp_path / 'own.py'}:imagined", small_policy(6), random_observations(5, 3, 6)
    with Sandbox(name) as sandbox:
        assert sandbox.start()["accesses"] == "simulator"
        proxy = Explainer("imagined", sandbox.explains())
        for seed in (1, 2):
            simulator = Simulator("blind_navigation_v0", 3, seed)
            own, theirs = (replace(each, simulator=simulator) for each in (find_explainer(name), proxy))
            assert torch.equal(run_explainer(own, policy, x, 0), run_explainer(theirs, policy, x, 0))
        with pytest.raises(InputError, match="plays on in the world of an episode"):
            run_explainer(proxy, policy, x, 0)


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
        "from xmarl_bench.submission.limits import Limits\n"
        f"Limits(cpu_seconds=1, memory_bytes=2**31, file_bytes=2**20).apply()\n{act}"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert done.returncode != 0
    assert said in done.stderr


def test_limits_must_be_above_zero() -> None:
    with pytest.raises(InputError, match="cpu_seconds must be more than 0, got 0"):
        Limits(cpu_seconds=0)


def test_systems_without_process_limits_are_refused_in_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sandbox, "UNIX", False)
    with (
        pytest.raises(InputError, match=r"isolated, which \w+ does not offer: run this on Linux"),
        Sandbox("attention") as started,
    ):
        started.start()
