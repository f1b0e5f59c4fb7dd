"""The commands work where a user may not write and has no git and no network, in paths with spaces."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import xmarl_baselines
import xmarl_envs

import xmarl_bench

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("needs_torch")]

# Every connection but those within this machine fails, as offline.
OFFLINE = """
import sys

def refuse(event, arguments):
    if event == "socket.connect" and not str(arguments[1]).startswith(("('127.", "('::1", "/", "b'")):
        raise OSError("offline")
    if event == "socket.getaddrinfo" and arguments[0] not in (None, "localhost", "127.0.0.1"):
        raise OSError("offline")

sys.addaudithook(refuse)
"""
OWN = """
import torch

def closest(policy, observations, generator):
    return torch.exp(-torch.cdist(observations[..., :2], observations[..., :2]))
"""
# Root may write everywhere; without its capabilities it is a user like any other.
WITHOUT_CAPABILITIES = ("--bounding-set=-all", "--inh-caps=-all")
Run = Callable[..., str]


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the packages below a folder with spaces, in which nothing can be written."""
    folder = tmp_path_factory.mktemp("place") / "a path with spaces and ü"
    folder.mkdir()
    for package in (xmarl_bench, xmarl_envs, xmarl_baselines):
        source = Path(str(package.__file__)).parent
        # With compiled modules, which each command would otherwise compile again.
        shutil.copytree(source, folder / package.__name__, ignore=shutil.ignore_patterns("*-at*"))
    (folder / "sitecustomize.py").write_text(OFFLINE, encoding="utf-8")
    for path in (folder, *folder.rglob("*")):
        path.chmod(0o555 if path.is_dir() else 0o444)
    return folder


@pytest.fixture(scope="module")
def as_user() -> list[str]:
    """The beginning of a command that runs as a user whom the permissions of files bind."""
    if os.name == "nt":
        pytest.skip("needs the permissions of POSIX")
    if os.geteuid() != 0:
        return []
    setpriv = shutil.which("setpriv")
    if setpriv is None:
        pytest.skip("runs as root, and setpriv is missing")
    return [setpriv, *WITHOUT_CAPABILITIES]


@pytest.fixture
def run(checkout: Path, tmp_path: Path, as_user: list[str]) -> Run:
    """run("list", "tasks") -> what the command prints, run by a user in another folder with spaces."""
    working = tmp_path / "my work"
    working.mkdir()

    def command(*arguments: object) -> str:
        done = subprocess.run(
            [*as_user, sys.executable, "-m", "xmarl_bench.cli.main", *map(str, arguments)],
            cwd=working,
            capture_output=True,
            encoding="utf-8",
            env={"PYTHONPATH": str(checkout), "PATH": "", "HOME": str(checkout), "OMP_NUM_THREADS": "1"},
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    return command


def test_the_user_cannot_write_into_the_checkout(checkout: Path, as_user: list[str]) -> None:
    code = f"open({str(checkout / 'x')!r}, 'w')"
    done = subprocess.run([*as_user, sys.executable, "-c", code], capture_output=True, encoding="utf-8")
    assert "PermissionError" in done.stderr


def test_a_user_lists_scores_an_explainer_of_their_own_and_has_the_page(
    run: Run, checkout: Path, tmp_path: Path
) -> None:
    policy = next(row["name"] for row in json.loads(run("list", "policies", "--json")))
    own = tmp_path / "my work" / "own explainer.py"
    own.write_text(OWN, encoding="utf-8")
    quick = ("--episodes", 1, "--timesteps", 2, "--no-behaviour", "all", "--jobs", 2)
    explainers = ("--explainer", f"{own}:closest", "--explainer", "attention")
    printed = run("score", "--policy", policy, *explainers, *quick, "--out", "my results")
    assert "2 entries in my results" in printed
    results = tmp_path / "my work" / "my results"
    assert "closest" in (results / "leaderboard.json").read_text(encoding="utf-8")
    assert (results / "index.html").is_file()
    entry = json.loads(next((results / "entries").glob("*closest*")).read_bytes())
    assert entry["provenance"]["commit"] is None
    assert run("validate", "my results").count("valid") >= 1
    run(
        "render", "--policy", policy, "--explainer", "attention", "--max-cycles", 3, "--out", "an episode.gif"
    )
    assert (tmp_path / "my work" / "an episode.gif").is_file()
