"""`xmarl-bench validate` in its own process takes under 2 s of CPU time, start and imports included.

Entry and bundle are of the largest team on the board, with all 50 episodes. The refused bundle is the same
with one byte of its weights changed and valid checksums: the last fault that validation finds.
"""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from tests.bench.submission.edits import with_manifest
from xmarl_bench.entry.file import read_entry
from xmarl_bench.plugins.names import find_policy
from xmarl_bench.policy.untrusted import WEIGHTS
from xmarl_bench.submission.packing import as_submitted, bundle_files, write_bundle

SECONDS = 2.0
ENTRIES = Path(__file__).parents[2] / "leaderboard" / "entries"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, int]]:
    """Paths to validate, each with the expected exit code."""
    folder = tmp_path_factory.mktemp("made")
    path = max(ENTRIES.glob("*.json"), key=lambda path: path.stat().st_size)
    entry = as_submitted(read_entry(path), "somebody", None)
    name = entry.policy.name
    policy = find_policy(name)
    assert isinstance(policy, Path)
    files = bundle_files([entry], {name: policy}, submitter="somebody", licence=b"None.\n")
    weights = f"policies/{name}/{WEIGHTS}"
    broken = {**files, weights: files[weights][:-1] + bytes([files[weights][-1] ^ 1])}
    write_bundle(folder / "bundle.zip", files)
    write_bundle(folder / "broken.zip", with_manifest(broken))
    return {"entry": (path, 0), "bundle": (folder / "bundle.zip", 0), "refused": (folder / "broken.zip", 1)}


@pytest.mark.parametrize("what", ["entry", "bundle", "refused"])
def test_validate(benchmark: BenchmarkFixture, made: dict[str, tuple[Path, int]], what: str) -> None:
    path, code = made[what]
    seconds = []

    def validate() -> None:
        before = _cpu()
        command = [sys.executable, "-m", "xmarl_bench.cli.main", "validate", str(path)]
        assert subprocess.run(command, capture_output=True).returncode == code
        seconds.append(_cpu() - before)

    benchmark.pedantic(validate, rounds=3)  # type: ignore[no-untyped-call]
    benchmark.extra_info["cpu_seconds"] = [round(each, 2) for each in seconds]
    assert max(seconds) < SECONDS


def _cpu() -> float:
    """CPU seconds of child processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
