"""On a full or read-only disk `score` and `board build` say so in a sentence and leave no half of a file."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.bench.scoring.test_cache_commands import assert_refused, score
from tests.conftest import MakeBundle, RunCli
from tests.helpers.full_disk import small_disk
from tests.helpers.measured_times import board_without_times
from xmarl_bench.entry.file import read_entries

pytestmark = pytest.mark.slow
MEGABYTES = 1


def files(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_full_and_a_read_only_disk_are_told_in_a_sentence(
    run_cli: RunCli, make_bundle: MakeBundle, tmp_path: Path
) -> None:
    one, two = make_bundle(name="one"), make_bundle(name="two", seed=1)
    assert score(run_cli, one, tmp_path / "elsewhere", "--policy", two).code == 0  # keeps the pieces of both
    with small_disk(tmp_path / "disk", MEGABYTES) as disk:
        out = disk.folder / "out"
        assert score(run_cli, one, out).code == 0
        before = files(out)
        for free in (0, 8 * 1024, 48 * 1024):  # for nothing, for less than an entry, for less than the page
            disk.fill(free)
            assert_refused(score(run_cli, two, out), "cannot be written (No space left on device)")
            after = files(out)
            assert {path: after[path] for path in before} == before
            new = after.keys() - before.keys()
            assert {path.suffix for path in new} <= {".json"}
            assert all((out / "entries") in path.parents for path in new)
            assert len(read_entries(out / "entries")) == (2 if free > 8 * 1024 else 1)
        assert_refused(run_cli("board", "build", out), "cannot be written (No space left on device)")
        disk.empty()
        disk.read_only(True)
        held = files(out)
        for command in (
            ("board", "build", out),
            ("score", "--policy", two, "--explainer", "self", "--out", out),
        ):
            ran = run_cli(*command)
            assert_refused(ran, "cannot")
            assert str(out) in ran.err
        assert_refused(
            score(run_cli, two, tmp_path / "new", "--cache", disk.folder / "cache"), "(Read-only file system)"
        )
        assert not (tmp_path / "new").exists()
        disk.read_only(False)
        assert files(out) == held
        assert score(run_cli, two, out).code == 0
        assert board_without_times(out) == board_without_times(tmp_path / "elsewhere")
