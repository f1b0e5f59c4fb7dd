"""`xmarl-train` as a user types it: what it writes and prints, and what it refuses."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from xmarl_bench.policy import load_policy


def xmarl_train(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "xmarl_baselines.train", "--out", str(folder), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=120)


def test_a_run_ends_with_a_policy_that_loads(tmp_path: Path) -> None:
    tiny = ("--task", "blind_discovery_v0", "--frames", "1", "--episodes", "1")
    done = xmarl_train(tmp_path, *tiny)
    assert done.returncode == 0, done.stderr
    _, card = load_policy(tmp_path / "discovery-n3-lambda0-seed0" / "policy")
    assert card.name == "discovery-n3-lambda0-seed0"
    assert card.training["command"].startswith("xmarl-train --task blind_discovery_v0 --agents 3")
    assert str(tmp_path) not in card.training["command"]
    assert card.performance["episodes"] == 1
    assert "xmarl-bench score --policy" in done.stdout
    again = xmarl_train(tmp_path, *tiny)
    assert (again.returncode, again.stderr.count("\n")) == (2, 1)
    assert "--resume" in again.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--task", "chess"), "choose one of"),
        (("--task", "blind_passage_v0", "--agents", "6"), "1 to 5 agents"),
        (("--task", "blind_passage_v0", "--start-from", "nowhere"), "checkpoint"),
        (("--task", "blind_passage_v0", "--attention-entropy", "-1"), "equal to 0"),
        (("--task", "blind_passage_v0", "--frames", "0"), "equal to 1"),
    ],
)
def test_bad_input_is_refused(tmp_path: Path, arguments: tuple[str, ...], said: str) -> None:
    refused = xmarl_train(tmp_path / "runs", *arguments)
    assert refused.returncode == 2
    assert said in refused.stderr
    assert "Traceback" not in refused.stderr
    assert not (tmp_path / "runs").exists()
