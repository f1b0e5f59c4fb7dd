"""The tiers find tampered metrics, rows, policies, seed lists and controls; the effect of a sign-off."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.bench.submission.conftest import TASK, TEAM, Pack
from tests.bench.submission.edits import edited, with_entry, with_manifest
from tests.conftest import RunCli
from tests.helpers.policies import small_policy
from xmarl_bench.entry.file import entry_text, parse_entry, read_entry
from xmarl_bench.entry.schema import Entry
from xmarl_bench.errors import InputError
from xmarl_bench.isolation.walls import SIGNED, Wall, strongest
from xmarl_bench.metrics.table import OPTIONAL
from xmarl_bench.plugins.registry import find_explainer
from xmarl_bench.policy import PolicyCard, save_policy
from xmarl_bench.rollout.cell import Cell, Sampling
from xmarl_bench.scoring.cache import Cache
from xmarl_bench.scoring.request import Request
from xmarl_bench.scoring.score import entries_of, score_requests
from xmarl_bench.submission import tolerance, verification
from xmarl_bench.submission.checking import Checked, check
from xmarl_bench.submission.recompute import Difference
from xmarl_bench.submission.tolerance import agrees, disagreeing
from xmarl_bench.submission.verdict_lines import WALLS
from xmarl_bench.submission.verification import Options, Tier, Verdict, verify

SPOT, FULL = Options(Tier.spot, episodes=7), Options(Tier.full)


def rows(value: dict[str, Any]) -> Any:
    return value["results"][0]["episodes"]


def of_bundle(path: Path, entry: Entry, options: Options) -> Verdict:
    checked = check(path)
    assert checked.findings == []
    return verify(checked, f"entries/{entry.file_name}", options)


@pytest.mark.slow
def test_an_honest_bundle_passes_every_tier_bit_for_bit(
    files: Mapping[str, bytes], entries: list[Entry], pack: Pack
) -> None:
    path = pack(files)
    for options, episodes in ((Options(Tier.recompute), 0), (Options(Tier.spot, episodes=3), 3), (FULL, 7)):
        verdict = of_bundle(path, entries[0], options)
        assert (verdict.findings, verdict.bitwise, verdict.max_abs_diff) == ((), True, 0.0)
        assert verdict.episodes == episodes


@pytest.mark.slow
def test_a_tampered_metric_is_found_by_recomputing(
    files: Mapping[str, bytes], entries: list[Entry], pack: Pack
) -> None:
    def better(value: dict[str, Any]) -> None:
        summary = value["results"][0]["metrics"]["comm_budgeted_fidelity"]
        summary.update(value=summary["value"] + 1e-6)

    findings = check(pack(with_entry(files, edited(entries[0], better)))).findings
    assert len(findings) == 1
    assert "results.0.metrics.comm_budgeted_fidelity.value is" in findings[0]


@pytest.mark.slow
def test_a_tampered_row_is_found_by_a_rerun(
    files: Mapping[str, bytes], entries: list[Entry], pack: Pack
) -> None:
    """The aggregates match it, so only a rerun can find it."""

    def better(value: dict[str, Any]) -> None:
        rows(value)[3].update(gef=rows(value)[3]["gef"] * 0.999999)

    tampered = edited(entries[0], better, aggregates=True)
    path = pack(with_entry(files, tampered))
    assert of_bundle(path, tampered, Options(Tier.recompute)).findings == ()
    spot = of_bundle(path, tampered, SPOT)
    assert [finding.split(" is ")[0] for finding in spot.findings] == ["results.0.episodes.3.gef"]
    assert spot.max_abs_diff is not None
    assert 0 < spot.max_abs_diff < 1e-5
    with pytest.raises(InputError, match="failed verification and cannot be signed"):
        spot.block("me")
    for draws_it in (True, False):  # one of seven episodes, which may not be drawn
        seeds = (
            seed for seed in range(99) if (np.random.default_rng(seed).permutation(7)[0] == 3) == draws_it
        )
        found = of_bundle(path, tampered, Options(Tier.spot, 1, next(seeds))).findings != ()
        assert found == draws_it


@pytest.mark.slow
def test_tampered_behaviour_and_controls_are_found_by_a_full_rerun(
    files: Mapping[str, bytes], entries: list[Entry], pack: Pack
) -> None:
    def both(value: dict[str, Any]) -> None:
        rows(value)[0].update(reward_on_explanation=rows(value)[0]["reward_on_explanation"] + 1.0)
        for name in ("mean_success_on_explanation", "mean_success_on_complement"):
            rows(value)[0][name] = 0.5
        rows(value)[0]["mean_behavioural_fidelity"] = 0.0
        random = value["results"][0]["controls"]["random"]["gef"]
        random.update(value=random["value"] - 1e-6)

    tampered = edited(entries[0], both, aggregates=True)
    path = pack(with_entry(files, tampered))
    assert of_bundle(path, tampered, SPOT).findings == ()  # as documented
    findings = of_bundle(path, tampered, FULL).findings
    for where in (
        "episodes.0.reward_on_explanation",
        "metrics.mean_success_on_explanation.value",
        "metrics.reward_on_explanation.value",
        "controls.random.gef",
    ):
        assert any(where in finding for finding in findings), findings


def older(value: dict[str, Any]) -> None:
    """The entry as it was before optional metrics were measured."""
    (cell,) = value["results"]
    assert cell.pop("absence_behaviour_episodes") == 5
    rows = [*cell["episodes"], cell["metrics"], *cell["controls"].values()]
    for holder in (value["protocol"]["definitions"], cell["not_measured"], *rows):
        for name in OPTIONAL:
            holder.pop(name, None)


@pytest.mark.slow
def test_an_entry_from_before_a_metric_was_measured_stays_valid(
    files: Mapping[str, bytes], entries: list[Entry], pack: Pack
) -> None:
    entry = edited(entries[0], older)
    text = entry_text(entry)
    assert not any(name.encode() in text for name in OPTIONAL)
    assert parse_entry(text) == entry
    changed = with_entry(files, entry)
    path = pack(changed)
    assert b"mean_behavioural_fidelity" not in changed[f"rows/{entry.file_name.removesuffix('.json')}.csv"]
    for options in (Options(Tier.recompute), FULL):
        verdict = of_bundle(path, entry, options)
        assert (verdict.findings, verdict.max_abs_diff) == ((), 0.0)
    undefined = edited(
        entries[0], lambda value: value["protocol"]["definitions"].pop("mean_behavioural_fidelity")
    )
    findings = check(pack(with_entry(files, undefined), "undefined")).findings
    assert any("protocol.definitions disagree with those of" in finding for finding in findings)


def swapped(files: Mapping[str, bytes], entry: Entry, tmp_path: Path) -> tuple[dict[str, bytes], Entry]:
    """Another policy under the same name with matching hashes: only its actions differ."""
    folder = tmp_path / "other"
    card: PolicyCard = save_policy(
        folder, small_policy(8, seed=1), name="small", task=TASK, n_agents=TEAM, attention_entropy=0.5,
        training_seed=0,
    )  # fmt: skip
    tampered = edited(entry, lambda value: value["policy"].update(weights_sha256=card.weights_sha256))
    changed = {
        f"policies/small/{name}": (folder / name).read_bytes()
        for name in ("policy.json", "policy.safetensors")
    }
    return {**files, **changed}, tampered


@pytest.mark.slow
def test_a_swapped_policy_is_found(
    files: Mapping[str, bytes], entries: list[Entry], pack: Pack, tmp_path: Path
) -> None:
    other, tampered = swapped(files, entries[0], tmp_path)
    found = check(pack(with_manifest(other), "a")).findings
    assert any("its weights_sha256 disagrees with" in each for each in found)
    # With the entries' hashes swapped too, only a rerun finds it.
    name = entries[1].file_name
    kept = {key: data for key, data in other.items() if name.removesuffix(".json") not in key}
    path = pack(with_entry(kept, tampered), "b.zip")
    assert any("the rerun gives" in finding for finding in of_bundle(path, tampered, SPOT).findings)


@pytest.mark.slow
def test_changed_seeds_are_found(files: Mapping[str, bytes], entries: list[Entry], pack: Pack) -> None:
    def other_list(value: dict[str, Any]) -> None:
        seeds = [seed + 10 for seed in value["protocol"]["seeds"]]
        value["protocol"].update(seeds=seeds)
        for row, seed in zip(rows(value), seeds, strict=True):
            row.update(seed=seed)

    def other_run(value: dict[str, Any]) -> None:
        value["explainer"].update(seed=5)
        seeds = [10**12 + 5 * 10**6 + k for k in range(7)]
        value["protocol"].update(seeds=seeds)
        for row, seed in zip(rows(value), seeds, strict=True):
            row.update(seed=seed)

    chosen = edited(entries[0], other_list, aggregates=True)
    assert any(
        "disagree with seed 0" in each for each in check(pack(with_entry(files, chosen), "a")).findings
    )
    # Episodes of one seed given as those of another: aggregates match, episodes do not.
    renamed = edited(entries[0], other_run, aggregates=True)
    name = entries[0].file_name
    kept = {key: data for key, data in files.items() if name.removesuffix(".json") not in key}
    path = pack(with_entry(kept, renamed), "b.zip")
    assert of_bundle(path, renamed, SPOT).findings != ()


@pytest.mark.slow
def test_a_sign_off_adds_only_its_block(
    files: Mapping[str, bytes], entries: list[Entry], pack: Pack, tmp_path: Path, run_cli: RunCli
) -> None:
    path = pack(files)
    before = path.read_bytes()
    ran = run_cli("verify", path, "--tier", "spot", "--episodes", 2, "--by", "A. Maintainer")
    assert (ran.code, "give --out" in ran.err) == (2, True)
    out = tmp_path / "board" / "entries"
    ran = run_cli("verify", path, "--tier", "spot", "--episodes", 2, "--by", "A. Maintainer", "--out", out)
    assert (ran.code, ran.err) == (0, "")
    assert ran.out.count("spot-rerun, 2 episodes again, bit for bit, largest difference 0.0") == 2
    assert path.read_bytes() == before
    signed = read_entry(out / entries[0].file_name)
    block = signed.verification
    assert (block.status, block.by, block.episodes) == ("spot-rerun", "A. Maintainer", 2)
    assert (block.bitwise, block.max_abs_diff) == (True, 0.0)
    assert block.packages is not None
    assert block.packages["torch"] == signed.provenance.packages["torch"]
    assert block.when is not None
    unsigned = signed.model_copy(update={"verification": entries[0].verification})
    assert unsigned == entries[0]
    # An entry file is signed in place; a second tier replaces the block of the first.
    file = out / entries[0].file_name
    ran = run_cli("verify", file, "--by", "B")
    assert ran.code == 0
    assert [line.split(", ")[0] for line in ran.out.splitlines()] == [
        f"{file}: a partial score (7 of the protocol's 50 episodes): valid",
        f"{file}: recomputed",
    ]
    assert (read_entry(file).verification.status, read_entry(file).verification.by) == ("recomputed", "B")


@pytest.mark.slow
def test_verify_exits_with_1_for_findings_and_2_if_it_cannot_run(
    files: Mapping[str, bytes], entries: list[Entry], pack: Pack, tmp_path: Path, run_cli: RunCli
) -> None:
    tampered = edited(entries[0], lambda value: rows(value)[3].update(gef=0.5), aggregates=True)
    path = pack(with_entry(files, tampered))
    ran = run_cli(
        "verify", path, "--tier", "spot", "--episodes", 7, "--by", "me", "--out", tmp_path / "out", "--json"
    )
    assert ran.code == 1
    assert sorted(each["passed"] for each in json.loads(ran.out)) == [False, True]
    assert [file.name for file in (tmp_path / "out").glob("*.json")] == [entries[1].file_name]
    assert run_cli("verify", path, "--tier", "deep").code == 2
    assert "memory must be finite, got inf" in run_cli("verify", path, "--memory", "inf").err
    assert run_cli("verify", tmp_path / "none.zip").code == 2
    broken = tmp_path / "broken.json"
    broken.write_text("{}")
    assert run_cli("verify", broken).code == 1


STRANGER = '''
import torch
from xmarl_bench import Explainer

def explain(policy, observations, generator):
    attention = policy.attention(observations).detach()
    return attention * torch.rand(attention.shape, generator=generator)

stranger = Explainer("stranger", explain, stochastic=True)
other = Explainer("stranger", explain, stochastic=False)
'''  # fmt: skip


@pytest.mark.slow
def test_third_party_code_runs_only_if_trusted_and_in_the_sandbox(
    files: Mapping[str, bytes], policy_folder: Path, pack: Pack, tmp_path: Path, run_cli: RunCli
) -> None:
    from xmarl_bench.policy import load_policy
    from xmarl_bench.submission.packing import as_submitted, bundle_files

    code = tmp_path / "stranger.py"
    code.write_text(STRANGER)
    policy, card = load_policy(policy_folder)
    found = find_explainer(f"{code}:stranger")
    (entry,) = entries_of(
        score_requests([Request(policy, card, found, (Cell(TASK, TEAM),), Sampling(3, 4, 8), 2)])
    )
    made = bundle_files(
        [as_submitted(entry, "me", "https://example.org")], {"small": policy_folder}, submitter="me",
        licence=files["LICENSE"],
    )  # fmt: skip
    path = pack(made)
    ran = run_cli("verify", path, "--tier", "spot")
    assert (ran.code, "read it, then add --trust-code" in ran.err) == (2, True)
    reference = ["--explainer", f"{code}:stranger"]
    ran = run_cli("verify", path, "--tier", "full", "--trust-code", *reference)
    assert (ran.code, ran.err) == (0, "")
    wall = WALLS[strongest()]
    assert f"re-executed, 3 episodes again, third-party code behind {wall}, bit for bit" in ran.out
    code.write_text(STRANGER + "# changed since\n")
    ran = run_cli("verify", path, "--tier", "spot", "--trust-code", "--explainer", f"{code}:other")
    assert ran.code == 1
    assert "explainer.stochastic is True, but False here" in ran.out
    assert "code_sha256 disagrees with the file" in ran.out


@pytest.mark.slow
def test_a_verdict_on_third_party_code_is_signed_only_behind_a_wall(entries: list[Entry]) -> None:
    def signed_behind(wall: Wall | None) -> str | None:
        return Verdict(entries[0], Tier.full, True, 7, 0.0, (), wall=wall).block("me").wall

    assert [signed_behind(wall) for wall in (None, *SIGNED)] == [None, "bubblewrap", "landlock"]
    with pytest.raises(InputError, match="ran behind no wall here and could have changed what was measured"):
        signed_behind("process")


@pytest.mark.slow
def test_a_rerun_reads_no_cache_and_leaves_no_file(
    files: Mapping[str, bytes],
    entries: list[Entry],
    pack: Pack,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A stranger could have filled them with results of its own."""

    def poisoned(*_: object, **__: object) -> bytes:
        raise AssertionError("read from a folder")

    path, temporary = pack(files), tmp_path / "temporary"
    temporary.mkdir()
    for name in ("read", "write", "prepare"):
        monkeypatch.setattr(Cache, name, poisoned)
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    monkeypatch.setattr(tempfile, "mkdtemp", poisoned)
    assert of_bundle(path, entries[0], FULL).findings == ()
    assert list(temporary.iterdir()) == []


@pytest.mark.slow
def test_on_another_machine_there_is_a_tolerance(
    entries: list[Entry], monkeypatch: pytest.MonkeyPatch
) -> None:
    entry = entries[0]
    assert tolerance.is_same_platform(entry)
    for change in ({"cpu_capability": "NEON"}, {"packages": {**entry.provenance.packages, "torch": "3.0"}}):
        other = entry.model_copy(update={"provenance": entry.provenance.model_copy(update=change)})
        assert not tolerance.is_same_platform(other)
    near, far = Difference("x", 100.0, 100.09), Difference("x", 1.0, 1.002)
    assert [agrees(each, 1e-3) for each in (near, far)] == [True, False]
    assert not agrees(near, None)
    assert not agrees(Difference("x", None, 0.0), 1e-3)
    assert agrees(Difference("x", None, None), None)
    episodes = [[near]] * 9 + [[near, far]]
    assert disagreeing(episodes, bitwise=False) == []  # one of ten may differ by more
    assert disagreeing([[near], [far]], bitwise=False) == [far]  # none of two may
    assert len(disagreeing(episodes, bitwise=True)) == 10
    assert replace(SPOT, trust_code=True).trust_code
    assert verification.STATUS[Tier.full] == "re-executed"
    with pytest.raises(InputError, match="episodes must be at least 1"):
        Options(Tier.spot, episodes=0)
    with pytest.raises(InputError, match="the name that signs the entry is empty"):
        Verdict(entry, Tier.spot, True, 1, 0.0, ()).block(" ")
    assert Checked(Path("x.zip")).is_bundle
