"""Failures around a sweep give one sentence, and existing files are kept."""

from __future__ import annotations

import json
import os
from pathlib import Path
from shutil import rmtree

import pytest

from tests.conftest import MakeBundle, Ran, RunCli
from tests.helpers.full_disk import files_of_at_most
from tests.helpers.made_entries import made_entry
from tests.helpers.measured_times import board_without_times
from xmarl_bench.entry.file import read_entries, write_entry
from xmarl_bench.records.files import locked
from xmarl_bench.scoring import sweep

SIZE = ("--episodes", 2, "--timesteps", 2, "--max-cycles", 4)
# Of a run with one explainer: episodes, those without messages, what all explainers share, explanations; and
# for the explainer and for random messages a team that acts on them, under zero and under the other models.
PIECES = 4 + 2 * 2


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "leaderboard"


def score(run_cli: RunCli, folder: Path, out: Path, *more: object) -> Ran:
    return run_cli("score", "--policy", folder, "--explainer", "attention", *SIZE, "--out", out, *more)


def assert_refused(ran: Ran, said: str) -> None:
    assert ran.code == 2, ran
    assert len(ran.err.splitlines()) == 1, ran.err
    assert said in ran.err


@pytest.mark.slow
def test_a_second_sweep_into_one_folder_is_refused(
    run_cli: RunCli, make_bundle: MakeBundle, out: Path
) -> None:
    with locked(out):
        assert_refused(score(run_cli, make_bundle(), out), f"another run is writing to {out}")
    assert score(run_cli, make_bundle(), out).code == 0
    assert not list(out.glob(".*"))


@pytest.mark.slow
@pytest.mark.parametrize("size", [100, 6_000])  # too small for a result, too small for an entry
def test_a_full_disk_gives_one_sentence_and_keeps_entries(
    size: int, run_cli: RunCli, make_bundle: MakeBundle, out: Path, tmp_path: Path
) -> None:
    folder = make_bundle()
    assert score(run_cli, folder, out).code == 0
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    board = board_without_times(out)
    with files_of_at_most(size):
        assert_refused(score(run_cli, folder, out, "--no-resume"), "cannot be written (File too large)")
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before
    assert not list((tmp_path / "cache").rglob("*.tmp"))
    assert score(run_cli, folder, out).code == 0
    assert board_without_times(out) == board


@pytest.mark.slow
def test_ctrl_c_says_what_is_kept_and_how_to_go_on(
    run_cli: RunCli, make_bundle: MakeBundle, out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[object] = []

    def interrupted(payload: sweep.Payload) -> object:
        calls.append(payload)
        if len(calls) > 5:  # the groups of the first policy: explained; two teams, under two kinds of absence
            raise KeyboardInterrupt
        return run(payload)

    run = sweep.run
    asked = ("--policy", make_bundle(name="two", seed=1), "--jobs", 1)
    with monkeypatch.context() as patch:
        patch.setattr(sweep, "run", interrupted)
        ran = score(run_cli, make_bundle(name="one"), out, *asked)
    assert ran.code == 130
    kept, stopped = ran.err.splitlines()
    assert kept == (
        f"Kept: 1 of 2 entries in {out / 'entries'}, finished pieces in {tmp_path / 'cache'}. The same "
        f"command, without --no-resume, goes on from there."
    )
    assert stopped.startswith("xmarl-bench: stopped")
    (first,) = (out / "entries").glob("*.json")
    assert first.name.startswith("one.")
    assert json.loads((out / "leaderboard.json").read_bytes())["tables"]
    assert score(run_cli, tmp_path / "policies" / "one", out, *asked).code == 0
    assert len(list((out / "entries").glob("*.json"))) == 2


def test_a_full_disk_stops_a_build_in_one_sentence_and_files_have_the_umask(
    run_cli: RunCli, out: Path
) -> None:
    write_entry(out / "entries", made_entry("p", "a", 0.5))
    mask = os.umask(0o027)
    try:
        assert run_cli("board", "build", out).code == 0
    finally:
        os.umask(mask)
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    made = [path for path in before if (out / "entries") not in path.parents]
    assert {path.stat().st_mode & 0o777 for path in made} == {0o640}
    more = write_entry(out / "entries", made_entry("p", "b", 0.4))
    with files_of_at_most(2000):
        assert_refused(run_cli("board", "build", out), "cannot be written (File too large)")
    after = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    assert {path: after[path] for path in before} == before
    assert after.keys() - before.keys() == {more}


def test_an_entry_that_cannot_be_read_is_named(run_cli: RunCli, make_bundle: MakeBundle, out: Path) -> None:
    (out / "entries").mkdir(parents=True)
    (out / "entries" / "gone.json").symlink_to(out / "nowhere.json")
    assert_refused(score(run_cli, make_bundle(), out), "gone.json cannot be read (No such file or directory)")
    assert [path.name for path in (out / "entries").glob("*.json")] == ["gone.json"]


def test_a_cache_that_cannot_be_written_is_refused(
    run_cli: RunCli, make_bundle: MakeBundle, out: Path, tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("")
    assert_refused(score(run_cli, make_bundle(), out, "--cache", tmp_path / "file"), "cannot be written")
    assert not out.exists()


@pytest.mark.slow
def test_status_before_during_and_after(run_cli: RunCli, make_bundle: MakeBundle, out: Path) -> None:
    assert_refused(run_cli("status"), "has no record of a run")
    assert score(run_cli, make_bundle(), out).code == 0
    told = run_cli("status", out)
    assert told.code == 0
    assert f"{out}: finished, {PIECES} of {PIECES} pieces, 1 of 1 entry." in told.out
    assert "xmarl-bench score --policy" in told.out
    (row,) = json.loads(run_cli("status", "--json").out)
    assert row["state"] == "finished"
    assert row["pieces"] == [PIECES, PIECES]
    for result in (out.parent / "cache").glob("*/??/*"):
        result.unlink()
    (row,) = json.loads(run_cli("status", "--json").out)
    assert row["pieces"] == [0, PIECES]
    assert row["explainers"] == {"attention": [0, 3]}  # explanations, and two ways to act on them
    assert_refused(run_cli("status", out / "elsewhere"), "has no record of a run")


@pytest.mark.slow
def test_status_shows_a_run_that_ended_before_its_first_entry(
    run_cli: RunCli, make_bundle: MakeBundle, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(payload: sweep.Payload) -> object:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(sweep, "run", interrupted)
        assert score(run_cli, make_bundle(), out, "--jobs", 1).code == 130
    assert not out.exists()
    assert f"of {PIECES} pieces, 0 of 1 entry." in run_cli("status", out).out
    assert score(run_cli, out.parent / "policies" / "small", out).code == 0
    rmtree(out)
    assert_refused(run_cli("status"), "has no record of a run")


@pytest.mark.slow
def test_cache_shows_and_clears_the_cache(
    run_cli: RunCli, make_bundle: MakeBundle, out: Path, tmp_path: Path
) -> None:
    cache = tmp_path / "cache"
    assert json.loads(run_cli("cache", "--json").out)["pieces"] == 0
    assert score(run_cli, make_bundle(), out).code == 0
    pieces = [path for path in cache.glob("*/??/*") if path.is_file()]
    size = sum(path.stat().st_size for path in pieces)
    assert (
        run_cli("cache").out == f"{cache}: {PIECES} pieces, {size / 1e6:.1f} MB, {PIECES} of this version.\n"
    )
    (version,) = [path for path in cache.iterdir() if len(path.name) == 16]
    version.rename(cache / ("0" * 16))
    seen = json.loads(run_cli("cache", "--json").out)
    assert seen == {"folder": str(cache), "pieces": PIECES, "size": size, "of_version": 0}
    (cache / "mine.txt").write_text("")
    assert run_cli("cache", "clear").out.startswith(f"{cache}: {PIECES} pieces deleted")
    assert [path.name for path in cache.iterdir()] == ["mine.txt"]
    (out / "ab").mkdir()
    assert run_cli("cache", "clear", "--cache", out).code == 0
    assert (out / "ab").exists()  # not a cache, despite the names of its folders


@pytest.mark.slow
def test_a_module_beside_an_explainers_file_is_read_again(
    run_cli: RunCli, make_bundle: MakeBundle, out: Path, tmp_path: Path
) -> None:
    own, helper = tmp_path / "own.py", tmp_path / "helper.py"
    own.write_text(
        "from helper import scaled\n\n\ndef own(observations, policy):\n"
        "    return scaled(policy.attention(observations))\n"
    )
    folder, fid_plus = make_bundle(), []
    for scale in ("0.25", "0.75", "0.25"):
        helper.write_text(f"def scaled(x):\n    return {scale} * x\n")
        ran = run_cli(
            "score", "--policy", folder, "--explainer", f"{own}:own", *SIZE, "--no-behaviour", "all",
            "--out", out,
        )  # fmt: skip
        assert ran.code == 0, ran.err
        (entry,) = (entry for _, entry in read_entries(out / "entries"))
        fid_plus.append(entry.results[0].metrics.fid_plus)
        pieces = json.loads(run_cli("cache", "--json").out)["pieces"]
    assert fid_plus[0] == fid_plus[2] != fid_plus[1]
    assert pieces == 5  # two rollouts, shared measures, and two versions of the explainer
