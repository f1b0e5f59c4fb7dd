"""The workflow for submissions has no permissions, and treats names of files as data."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

from tests.bench.submission.conftest import LICENCE, Pack
from xmarl_bench.entry.file import write_entry
from xmarl_bench.entry.schema import Entry
from xmarl_bench.records.files import write_atomically
from xmarl_bench.submission.packing import bundle_files

WORKFLOW = Path(__file__).parents[3] / ".github" / "workflows" / "submission.yml"


def git(folder: Path, *arguments: str) -> str:
    identity = ("-c", "user.email=a@example.org", "-c", "user.name=a", "-c", "commit.gpgsign=false")
    done = subprocess.run(
        ["git", "-C", folder, *identity, *arguments], check=True, capture_output=True, text=True
    )
    return done.stdout.strip()


def script(name: str) -> str:
    """The shell script of a step in the workflow."""
    step = WORKFLOW.read_text().split(f"- name: {name}", 1)[1]
    found = re.search(r"run: \|\n((?: {10}.*\n)+)", step)
    assert found is not None
    return "".join(line[10:] + "\n" for line in found[1].splitlines())


def test_the_workflow_has_only_read_permission() -> None:
    text = re.sub(r"#.*", "", WORKFLOW.read_text())
    assert re.search(r"^permissions:\n  contents: read\n(?! )", text, re.MULTILINE)
    assert re.findall(r"^on:\n  (\w+):", text, re.MULTILINE) == ["pull_request"]
    for forbidden in ("pull_request_target", "secrets", "write", "workflow_run", "trust-code"):
        assert forbidden not in text
    runs = text.split("run: |")[1:]
    assert all("${{" not in re.split(r"\n {6}- ", run)[0] for run in runs)  # nothing is pasted into a shell


@pytest.mark.parametrize("path", sorted(WORKFLOW.parent.glob("*.yml")), ids=lambda path: path.stem)
def test_actions_are_pinned_and_checkouts_keep_no_credentials(path: Path) -> None:
    text = path.read_text()
    used = re.findall(r"uses: (\S+)", text)
    assert used
    for action in used:
        assert re.fullmatch(r"[\w/-]+@[0-9a-f]{40}", action), f"{action} is not pinned by a commit"
    checkouts = re.findall(r"uses: actions/checkout@.*\n((?: +(?:with|[a-z-]+):.*\n)+)", text)
    assert len(checkouts) == sum(action.startswith("actions/checkout@") for action in used)
    assert all("persist-credentials: false" in each for each in checkouts)


@pytest.mark.slow
def test_bundles_of_a_pull_request_are_found(tmp_path: Path, files: Mapping[str, bytes]) -> None:
    base, head = tmp_path / "base", tmp_path / "head"
    base.mkdir()
    git(base, "init", "-q")
    write_atomically(base / "leaderboard" / "entries" / "a.json", b"{}")
    git(base, "add", ".")
    git(base, "commit", "-qm", "base")
    commit = git(base, "rev-parse", "HEAD")
    git(tmp_path, "clone", "-q", str(base), str(head))
    strange = "$(touch pwned) x"
    for folder in ("mine", strange):
        for name, data in files.items():
            write_atomically(head / "leaderboard" / "submissions" / folder / name, data)
    git(head, "add", ".")
    git(head, "commit", "-qm", "head")
    find = script("Which bundles does the pull request bring?")

    def run(fork: str) -> int:
        environment = {"BASE": commit, "FORK": fork, "PATH": "/usr/local/bin:/usr/bin:/bin"}
        return subprocess.run(
            ["bash", "-c", find], cwd=tmp_path, env=environment, capture_output=True
        ).returncode

    assert run("true") == 0
    listed = (tmp_path / "bundles").read_bytes().split(b"\0")[:-1]
    assert sorted(listed) == [f"head/leaderboard/submissions/{name}".encode() for name in (strange, "mine")]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["base", "bundles", "head"]
    write_atomically(head / "leaderboard" / "entries" / "a.json", b"[]")
    git(head, "commit", "-qam", "an entry")
    assert (run("true"), run("false")) == (1, 0)


@pytest.mark.slow
def test_the_summary_compares_each_bundle_with_the_references(
    tmp_path: Path, entries: Sequence[Entry], policy_folder: Path, pack: Pack
) -> None:
    reference, other = entries  # of attention and of occlusion
    write_entry(tmp_path / "base" / "leaderboard" / "entries", reference)
    files = bundle_files([other], {"small": policy_folder}, submitter="somebody", licence=LICENCE)
    strange = "$(touch pwned) `x`.zip"
    pack(files, "folder")
    pack({**files, "manifest.json": b"{}"}, strange)
    (tmp_path / "bundles").write_bytes(f"folder\0{strange}\0".encode())
    environment = {**os.environ, "REFERENCES": "attention", "GITHUB_STEP_SUMMARY": "summary.md"}
    environment["PATH"] = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    compare = script("Compare with the reference explainers, in the summary of the run")
    subprocess.run(["bash", "-ec", compare], cwd=tmp_path, env=environment, check=True)
    _, table, _, refused, _ = (tmp_path / "summary.md").read_text().split("```")
    assert table.startswith("text\nmessage_fidelity, higher is better, on 1 policy and cell")
    assert re.search(r"attention +.*\n", table)
    assert re.search(r"occlusion - attention|attention - occlusion", table)
    assert refused.strip().endswith("is invalid: run xmarl-bench validate on it.")
    assert not (tmp_path / "pwned").exists()
