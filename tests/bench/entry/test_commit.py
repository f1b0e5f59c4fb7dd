"""Commit and command in an entry's provenance, and what counts as a change of the commit."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from xmarl_bench.entry.provenance import commit_of, provenance


def git(folder: Path, *arguments: str) -> str:
    identity = ["-c", "user.name=me", "-c", "user.email=me@example.org"]
    command = ["git", *identity, "-C", str(folder), *arguments]
    return subprocess.run(command, check=True, capture_output=True, encoding="utf-8").stdout.strip()


@pytest.mark.slow
def test_a_tree_is_dirty_if_sources_changed_and_not_if_entries_were_written(tmp_path: Path) -> None:
    source, entry = tmp_path / "xmarl_bench" / "a.py", tmp_path / "leaderboard" / "entries" / "a.json"
    for path in (source, entry, tmp_path / "README.md"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("1")
    git(tmp_path, "init", "--quiet")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "--quiet", "--message", "first")
    commit = git(tmp_path, "rev-parse", "HEAD")
    assert commit_of(source) == (commit, False)
    for path in (entry, tmp_path / "README.md", tmp_path / "new.py"):
        path.write_text("2")
        assert commit_of(source) == (commit, False)
    source.write_text("2")
    assert commit_of(source) == (commit, True)
    assert commit_of(tmp_path / "new.py") == (None, None)  # a file that the repository does not hold


def test_a_command_with_hundreds_of_files_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["/bin/xmarl-bench", "verify", "an entry.json"])
    assert provenance("", 1).command == "xmarl-bench verify 'an entry.json'"
    monkeypatch.setattr(sys, "argv", ["xmarl-bench", "verify", *(f"entries/{k}.json" for k in range(1000))])
    command = provenance("", 1).command
    assert len(command) == 10_000
    assert command.startswith("xmarl-bench verify entries/0.json entries/1.json ")
    assert command.endswith(" ...")
