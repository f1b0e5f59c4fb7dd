"""Verifying many entries: what is shared, signed when, and where an interrupted run goes on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from tests.bench.submission.conftest import Pack
from tests.bench.submission.edits import edited, with_entry
from tests.conftest import RunCli
from xmarl_bench.entry.file import read_entries
from xmarl_bench.entry.provenance import commit_of_harness
from xmarl_bench.entry.schema import Entry
from xmarl_bench.errors import InputError
from xmarl_bench.parallel.calls import Failure
from xmarl_bench.parallel.workers import ONE_PROCESS
from xmarl_bench.scoring.score import score_requests
from xmarl_bench.submission import batch, rerun
from xmarl_bench.submission.batch import Unit, verify_all
from xmarl_bench.submission.checking import check
from xmarl_bench.submission.verification import Options, Tier, Verdict

FULL = Options(Tier.full)


def verdicts(path: Path) -> dict[str, Verdict]:
    """By explainer."""
    checked = check(path)
    units = [Unit(checked.part(file), file) for file in checked.entries]
    found = {}
    for k, outcome in verify_all(units, FULL, ONE_PROCESS):
        assert isinstance(outcome, Verdict)
        found[units[k].entry.explainer.name] = outcome
    return found


@pytest.mark.slow
def test_entries_of_a_policy_are_scored_together_and_a_failing_explainer_stops_no_other(
    files: Mapping[str, bytes], pack: Pack, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[int] = []

    def counted(requests: Sequence[Any], **options: Any) -> Any:
        calls.append(len(requests))
        return score_requests(requests, **options)

    monkeypatch.setattr(batch, "score_requests", counted)
    path = pack(files)
    found = verdicts(path)
    assert calls == [2]
    assert [(each.findings, each.bitwise, each.max_abs_diff) for each in found.values()] == [
        ((), True, 0.0)
    ] * 2

    def refused(*_: object, **__: object) -> Any:
        raise InputError("occlusion fails")
        yield

    monkeypatch.setattr(batch, "score_requests", refused)
    assert verdicts(path).keys() == found.keys()


@pytest.mark.slow
def test_a_tampered_entry_fails_beside_others_that_pass(
    files: Mapping[str, bytes], entries: list[Entry], pack: Pack
) -> None:
    def declared(value: dict[str, Any]) -> None:
        value["explainer"].update(binary=True)

    def better(value: dict[str, Any]) -> None:
        value["results"][0]["episodes"][3].update(gef=0.5)

    for tamper, finding in ((declared, "explainer.binary is True"), (better, "episodes.3.gef is 0.5")):
        tampered = edited(entries[0], tamper, aggregates=True)
        found = verdicts(pack(with_entry(files, tampered), f"{tamper.__name__}.zip"))
        assert finding in found["attention"].findings[0]
        assert found["occlusion"].findings == ()


@pytest.mark.slow
def test_an_interrupted_run_has_signed_what_passed_and_goes_on(
    files: Mapping[str, bytes], pack: Pack, tmp_path: Path, run_cli: RunCli, monkeypatch: pytest.MonkeyPatch
) -> None:
    compared, done = rerun.compared, list[object]()

    def stopped(entry: Entry, again: Sequence[Entry]) -> Any:
        if done:
            raise KeyboardInterrupt
        done.append(entry)
        return compared(entry, again)

    out = tmp_path / "out"
    command = ["verify", pack(files), "--tier", "full", "--by", "me", "--out", out, "--resume"]
    monkeypatch.setattr(batch, "compared", stopped)
    assert run_cli(*command).code == 130
    ((path, first),) = read_entries(out)
    assert (first.verification.status, first.verification.by) == ("re-executed", "me")
    assert (first.verification.commit, first.verification.dirty) == commit_of_harness()
    before = path.read_bytes()
    monkeypatch.setattr(batch, "compared", compared)
    ran = run_cli(*command)
    assert (ran.code, ran.out.count("re-executed"), "left: 1." in ran.err) == (0, 1, True)
    assert path.read_bytes() == before
    assert [entry.verification.status for _, entry in read_entries(out)] == ["re-executed"] * 2
    assert run_cli(*[each if each != "me" else "you" for each in command]).out.count("re-executed") == 2
    assert run_cli("verify", out, "--tier", "full", "--resume").code == 2


@pytest.mark.slow
def test_an_entry_of_a_policy_that_is_not_installed_is_named(entries: list[Entry], tmp_path: Path) -> None:
    from xmarl_bench.entry.file import write_entry

    path = write_entry(tmp_path, entries[0])
    ((_, outcome),) = verify_all([Unit(check(path), path.name)], FULL, ONE_PROCESS)
    assert isinstance(outcome, Failure)
    assert "'small'" in outcome.error
