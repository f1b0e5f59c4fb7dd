"""The command on an entry's page reproduces the entry."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from tests.conftest import MakeBundle, RunCli
from tests.helpers.installed import install
from xmarl_bench.board.command import command_of
from xmarl_bench.entry.file import read_entries


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        ["--episodes", 2, "--max-cycles", 7],
        [
            "--episodes",
            1,
            "--timesteps",
            3,
            "--max-cycles",
            9,
            "--seed",
            5,
            "--submitter",
            "A. Nother, it's me",
        ],
        ["--episodes", 2, "--max-cycles", 8, "--behaviour-episodes", 1, "--agents", 4],
        ["--episodes", 1, "--max-cycles", 8, "--no-behaviour", "all"],
        ["--episodes", 1, "--max-cycles", 8, "--no-behaviour", "all", "--no-isolate"],
    ],
)
def test_the_command_reproduces_the_entry(
    tmp_path: Path,
    run_cli: RunCli,
    make_bundle: MakeBundle,
    monkeypatch: pytest.MonkeyPatch,
    options: list[object],
) -> None:
    monkeypatch.chdir(tmp_path)
    install(monkeypatch, small=make_bundle(name="small"))
    (tmp_path / "own.py").write_text(
        "import torch\n\ndef own(policy, observations):\n    return torch.ones(*observations.shape[:2], 3)\n"
    )
    explainer = "own.py:own" if "--no-isolate" in options else "random"
    given = ["score", "--policy", "small", "--explainer", explainer, "--out", tmp_path / "one", *options]
    assert run_cli(*given).code == 0
    ((_, entry),) = read_entries(tmp_path / "one" / "entries")
    program, *words = shlex.split(command_of(entry, str(tmp_path / "two")))
    assert program == "xmarl-bench"
    ran = run_cli(*words)
    assert ran.code == 0, ran.err
    ((_, again),) = read_entries(tmp_path / "two" / "entries")
    assert again.entry_id == entry.entry_id
    assert again.file_name == entry.file_name
