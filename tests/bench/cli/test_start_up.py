"""Commands and errors that need no network and no physics do not load their libraries."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.made_entries import made_board
from xmarl_bench.entry.file import write_entry

# `import xmarl_envs` registers its tasks with PettingZoo, which loads that package but not its environments.
SLOW = {"torch", "torch_geometric", "pymunk", "pygame", "scipy.stats", "matplotlib", "loky", "psutil"}
PROGRAM = f"""
import sys
from xmarl_bench.cli.main import main
code = 0
try:
    main()
except SystemExit as stop:
    code = stop.code
print(code, *sorted({SLOW} & sys.modules.keys()), file=sys.stderr)
"""
POLICY = ("--policy", "navigation-n3-residual-lambda0-seed0")


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("board")
    for entry in made_board(["a"], {"attention": 0.9, "occlusion": 0.5}):
        write_entry(folder / "entries", entry)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "code"),
    [
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
    ],
)
def test_a_command_that_needs_no_network_loads_no_slow_library(
    command: list[str], code: int, board: Path
) -> None:
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM, *command], cwd=board, capture_output=True, text=True, check=False
    )
    assert run.stderr.splitlines()[-1] == str(code), run.stderr
