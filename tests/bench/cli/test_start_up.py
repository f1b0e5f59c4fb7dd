"""Commands and errors that need no network and no physics do not load their libraries."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.made_entries import made_board
from xmarl_bench.entry.file import write_entry

# `import xmarl_envs` registers its tasks with PettingZoo, which loads that package but not its environments.
SLOW = {"torch", "torch_geometric", "pymunk", "pygame", "scipy.stats", "matplotlib", "loky", "psutil"}
PROGRAM = f"""
import json, sys
from pathlib import Path
from xmarl_bench.cli.main import main
ran = []
for command in json.loads(sys.argv[1]):
    sys.argv = ["xmarl-bench", *command]
    try:
        main()
        code = 0
    except SystemExit as stop:
        code = stop.code
    ran.append([code, sorted({SLOW} & sys.modules.keys())])
Path("ran.json").write_text(json.dumps(ran))
"""
POLICY = ("--policy", "navigation-n3-residual-lambda0-seed0")


COMMANDS: list[tuple[list[str], int]] = [
    (["list", "tasks"], 0),
    (["list", "policies"], 0),
    (["list", "explainers"], 0),
    (["validate", "entries"], 1),  # made up, so their numbers disagree
    (["compare", "entries"], 0),
    (["board", "build", "."], 0),
    (["board", "check", "."], 0),
    (["status", "--cache", "cache"], 2),
    (["score", "--policy", "nobody"], 2),
    (["score", "--explainer", "nobody"], 2),
    (["score", "--explainer", "missing.py:x"], 2),
    (["score", "--task", "nothing"], 2),
    (["score", *POLICY, "--task", "blind_passage_v0"], 2),
    (["score", *POLICY, "--agents", "65"], 2),
    (["score", *POLICY, "--no-behaviour", "nobody"], 2),
    (["score", "--episodes", "0"], 2),
    (["score", "--parallel-episodes", "0"], 2),
    (["score", "--behaviour-episodes", "-1"], 2),
    (["score", "--jobs", "0"], 2),
]


@pytest.mark.slow
def test_commands_that_need_no_network_load_no_slow_library(tmp_path: Path) -> None:
    """One after the other in a fresh process: the first that loads one is the first in which it shows."""
    for entry in made_board(["a"], {"attention": 0.9, "occlusion": 0.5}):
        write_entry(tmp_path / "entries", entry)
    commands = json.dumps([command for command, _ in COMMANDS])
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM, commands], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    ran = json.loads((tmp_path / "ran.json").read_bytes())
    for (command, code), found in zip(COMMANDS, ran, strict=True):
        assert found == [code, []], command
