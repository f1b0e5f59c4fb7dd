"""A bundle packed by `submit` is valid, complete and reproducible; any edit of it is found."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from tests.bench.submission.conftest import LICENCE, Pack
from tests.bench.submission.edits import Edit, edited, with_entry, with_manifest
from tests.conftest import RunCli
from xmarl_bench.entry.file import entry_text, read_entry, write_entry
from xmarl_bench.entry.schema import Entry, Verification
from xmarl_bench.explain.control_names import INITIAL_ATTENTION, INVERTED, NEAREST
from xmarl_bench.explain.controls import CONTROLS
from xmarl_bench.policy.untrusted import WEIGHTS
from xmarl_bench.records.files import pretty_json
from xmarl_bench.submission import control_consistency
from xmarl_bench.submission.archive import MANIFEST
from xmarl_bench.submission.checking import check
from xmarl_bench.submission.schema import PUBLISHED, schema

ROOT = Path(__file__).parents[3]


def rows(value: dict[str, Any]) -> Any:
    return value["results"][0]["episodes"]


def controls(value: dict[str, Any]) -> Any:
    return value["results"][0]["controls"]


def swap(of: Any, one: Any, other: Any) -> None:
    of[one], of[other] = of[other], of[one]


@pytest.mark.slow
def test_zip_and_folder_have_the_same_content_and_are_valid(files: Mapping[str, bytes], pack: Pack) -> None:
    for name in ("bundle.zip", "bundle"):
        checked = check(pack(files, name))
        assert checked.findings == []
        assert sorted(checked.entries) == sorted(name for name in files if name.startswith("entries/"))
        assert list(checked.policies) == ["small"]
    assert pack(files, "again.zip").read_bytes() == pack(files, "more.zip").read_bytes()


@pytest.mark.slow
def test_submit_packs_a_valid_bundle_and_overwrites_nothing(
    tmp_path: Path, entries: list[Entry], policy_folder: Path, run_cli: RunCli
) -> None:
    entry = write_entry(tmp_path, entries[0])
    (tmp_path / "LICENSE").write_bytes(LICENCE)
    out = tmp_path / "mine.zip"
    arguments = ["submit", entry, "--submitter", "me", "--licence", tmp_path / "LICENSE", "--out", out,
                 "--policy", policy_folder, "--code", "https://example.org/code"]  # fmt: skip
    ran = run_cli(*arguments)
    assert (ran.code, ran.err) == (0, "")
    (packed,) = check(out).entries.values()
    assert (packed.submitter, packed.explainer.code) == ("me", "https://example.org/code")
    assert packed.results == entries[0].results
    assert run_cli("validate", out).code == 0
    before = out.read_bytes()
    again = run_cli(*arguments)
    assert again.code == 2
    assert "exists" in again.err
    assert out.read_bytes() == before


@pytest.mark.slow
def test_submit_writes_no_invalid_bundle(
    tmp_path: Path, entries: list[Entry], policy_folder: Path, run_cli: RunCli
) -> None:
    tampered = edited(entries[0], lambda value: rows(value)[0].update(length=9, timesteps=9, makespan=9.0))
    entry = write_entry(tmp_path, tampered)
    (tmp_path / "LICENSE").write_bytes(LICENCE)
    ran = run_cli("submit", entry, "--submitter", "me", "--licence", tmp_path / "LICENSE", "--out",
                  tmp_path / "x.zip", "--policy", policy_folder)  # fmt: skip
    assert ran.code == 1
    assert "length 9 is more than max_cycles 8" in ran.out
    assert not (tmp_path / "x.zip").exists()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["@me", ""])
def test_submit_refuses_a_name_that_no_manifest_holds(
    name: str, tmp_path: Path, entries: list[Entry], policy_folder: Path, run_cli: RunCli
) -> None:
    entry = write_entry(tmp_path, entries[0])
    (tmp_path / "LICENSE").write_bytes(LICENCE)
    ran = run_cli("submit", entry, "--submitter", name, "--licence", tmp_path / "LICENSE", "--out",
                  tmp_path / "x.zip", "--policy", policy_folder)  # fmt: skip
    assert (ran.code, len(ran.err.splitlines())) == (2, 1)
    assert "the bundle's submitter is invalid" in ran.err


@pytest.mark.slow
def test_validate_exits_0_1_2(tmp_path: Path, entries: list[Entry], run_cli: RunCli) -> None:
    good = write_entry(tmp_path / "good", entries[0])
    bad = tmp_path / "bad.json"
    bad.write_bytes(entry_text(entries[0]).replace(b'"somebody"', b'"somebody else"'))
    assert run_cli("validate", good, tmp_path / "good").code == 0
    ran = run_cli("validate", good, bad)
    assert ran.code == 1
    partial = "a partial score (7 of the protocol's 50 episodes): valid, but not ranked."
    assert ran.out.splitlines()[0] == f"{good}: {partial}"
    assert ran.out.splitlines()[2].startswith(f"{bad}: it was changed after it was written")
    ran = run_cli("validate", tmp_path / "none.json", good)
    assert ran.code == 2
    assert ran.err.count("\n") == 1


FOUND: list[tuple[str, Edit]] = [
    ("definitions", lambda v: v["protocol"]["definitions"].update(gef="something else")),
    ("seeds disagree with", lambda v: swap(v["protocol"]["seeds"], 0, 1)),
    ("one for each of the 7 seeds", lambda v: rows(v).pop()),
    ("one for each of the 7 seeds", lambda v: swap(rows(v), 0, 1)),
    ("explained_timesteps", lambda v: v["cost"].update(explained_timesteps=1)),
    ("a cell twice", lambda v: v["results"].append(v["results"][0])),
    ("the policy was trained for", lambda v: v["results"][0].update(task="blind_navigation_v0")),
    ("takes 1 to 5 agents", lambda v: v["results"][0].update(n_agents=9)),
    ("blind_flight_v0' is unknown", lambda v: v["results"][0].update(task="blind_flight_v0")),
    ("which is not a metric", lambda v: v["results"][0]["not_measured"].update(charm="unseen")),
    ("behaviour_episodes is 0", lambda v: v["results"][0].update(behaviour_episodes=0)),
    ("behaviour_episodes is 8", lambda v: v["results"][0].update(behaviour_episodes=8)),
    ("success_on_explanation has a value", lambda v: rows(v)[5].update(success_on_explanation=1.0)),
    ("weight_randomisation has a value", lambda v: rows(v)[6].update(weight_randomisation=0.5)),
    ("makespan", lambda v: rows(v)[2].update(makespan=7.0)),
    ("neither 0 nor 1", lambda v: rows(v)[2].update(no_agent_collision=0.5)),
    ("not a fraction of 3", lambda v: rows(v)[2].update(success_rate=0.5)),
    ("more than log 3", lambda v: rows(v)[2].update(attention_entropy=1.2)),
    ("is not fid_plus - fid_minus", lambda v: rows(v)[2].update(fid_plus=rows(v)[2]["fid_plus"] + 0.01)),
    ("not the mean of", lambda v: rows(v)[2].update(comm_topk_fid_delta=0.0)),
    ("budgeted_fidelity", lambda v: rows(v)[2].update(budgeted_fidelity=0.999)),
    ("but its absence models give", lambda v: rows(v)[2].update(smallest_message_fidelity=-0.5)),
    ("budgeted_fidelity", lambda v: rows(v)[2].update(resample_budgeted_fidelity=0.999)),
    ("budget is not for 1 to 2 edges", lambda v: swap(rows(v)[2], "budget", "comm_budget")),
    ("the rows give", lambda v: rows(v)[2].update(gef=rows(v)[2]["gef"] / 2)),
    ("the rows give", lambda v: v["results"][0]["metrics"]["gef"].update(value=0.123)),
    ("the rows give", lambda v: swap(v["results"][0]["metrics"], "gef", "comm_gef")),
    ("controls are", lambda v: controls(v).pop("zeros")),
    ("for that mask", lambda v: swap(controls(v), "zeros", "all-ones")),
    ("for that mask", lambda v: swap(controls(v), "inverted", "random")),
    ("contradicts what was measured", lambda v: controls(v)["self"].update(gef=None)),
    ("has 8 episodes", lambda v: controls(v)["self"]["gef"].update(n_nan=1)),
    ("outside its range", lambda v: controls(v)["random"]["gef"].update(value=1.5, interval=[1.0, 2.0])),
    ("not in its interval", lambda v: controls(v)["random"]["gef"].update(value=0.001, interval=[0.1, 0.2])),
    ("more than the oracle's", lambda v: controls(v)["oracle"].update(controls(v)["random"])),
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("said", "edit"), FOUND)
def test_inconsistent_numbers_are_found(
    said: str, edit: Edit, entries: list[Entry], files: Mapping[str, bytes], pack: Pack
) -> None:
    """Id, rows and checksums match, so only the inconsistency can be found."""
    tampered = edited(entries[0], edit)
    findings = check(pack(with_entry(files, tampered), "x")).findings
    assert any(said in finding for finding in findings), findings
    assert all("\n" not in finding and finding.endswith(".") for finding in findings)


@pytest.mark.slow
def test_files_of_a_bundle_must_agree(files: Mapping[str, bytes], entries: list[Entry], pack: Pack) -> None:
    name = entries[0].file_name
    csv = f"rows/{name.removesuffix('.json')}.csv"
    block = Verification(status="re-executed", by="me")
    verified = entries[0].model_copy(update={"verification": block}).model_dump(mode="json")
    cases: dict[str, dict[str, bytes]] = {
        "does not list README.md": {**files, "README.md": b"hello"},
        "which the bundle does not hold": {key: data for key, data in files.items() if key != csv},
        "differs from the file": {**files, "LICENSE": b"Nobody may use this.\n"},
        "LICENSE: it is missing": with_manifest({k: v for k, v in files.items() if k != "LICENSE"}),
        "manifest.json: it is missing": {k: v for k, v in files.items() if k != MANIFEST},
        "disagrees with the entry": with_manifest({**files, csv: files[csv].replace(b",8,", b",7,", 1)}),
        "rows/*.csv is missing": with_manifest({k: v for k, v in files.items() if k != csv}),
        "its name should be": with_manifest({**files, "entries/other.json": files[f"entries/{name}"]}),
        "it belongs to no entry": with_manifest({**files, "rows/other.csv": files[csv]}),
        "its policy is missing": with_manifest({k: v for k, v in files.items() if "policies" not in k}),
        "it holds no entry": with_manifest({k: v for k, v in files.items() if "entries" not in k}),
        "no entry is of this policy": with_manifest(
            {**files, "policies/other/policy.json": files["policies/small/policy.json"]}
        ),
        "leave it out": with_manifest({**files, f"entries/{name}": pretty_json(verified)}),
    }
    for k, (said, changed) in enumerate(cases.items()):
        findings = check(pack(changed, f"{k}.zip")).findings
        assert any(said in finding for finding in findings), (said, findings)


@pytest.mark.slow
def test_a_policy_with_another_name_is_found(files: Mapping[str, bytes], pack: Pack) -> None:
    card = files["policies/small/policy.json"].replace(b'"name": "small"', b'"name": "other"')
    findings = check(pack(with_manifest({**files, "policies/small/policy.json": card}))).findings
    assert len(findings) == 2
    assert all("policies/small: its name disagrees with policy.name of entries/" in each for each in findings)


@pytest.mark.slow
def test_validating_does_not_import_torch(
    tmp_path: Path, entries: list[Entry], files: Mapping[str, bytes], pack: Pack
) -> None:
    """The command in its own process, for every kind of path and result."""
    entry, bundle = write_entry(tmp_path, entries[0]), pack(files)
    weights = "policies/small/policy.safetensors"
    broken = pack(with_manifest({**files, weights: files[weights][:-4]}), "broken.zip")
    code = (
        "import sys; from xmarl_bench.cli.main import main\n"
        "try:\n    main()\nexcept SystemExit as stopped:\n    code = stopped.code\n"
        "waited = {'torch', 'torch_geometric', 'scipy', 'loky'} & sys.modules.keys()\n"
        "sys.exit(f'waited for {waited}' if waited else code)"
    )
    for paths, exit_code in (([entry, bundle], 0), ([broken], 1)):
        ran = subprocess.run(
            [sys.executable, "-c", code, "validate", *map(str, paths)], capture_output=True, text=True
        )
        assert (ran.returncode, ran.stderr) == (exit_code, "")
    assert f"{broken}: policies/small: {WEIGHTS} cannot be read as safetensors" in ran.stdout


def test_names_of_controls_agree() -> None:
    known = (
        control_consistency.ALWAYS_PRESENT
        | control_consistency.IF_ORACLE
        | control_consistency.IF_INITIAL_SEED
    )
    assert {*CONTROLS, NEAREST, INITIAL_ATTENTION, INVERTED} == known


def test_published_schemas_are_up_to_date() -> None:
    for name, model in PUBLISHED.items():
        published = json.loads((ROOT / "leaderboard" / name).read_text())
        assert published == schema(model), "run `python -m xmarl_bench.submission.schema leaderboard`"


@pytest.mark.slow
def test_all_entries_of_the_shipped_board_are_valid() -> None:
    paths = sorted((ROOT / "leaderboard" / "entries").glob("*.json"))
    assert paths
    for path in paths[:: max(1, len(paths) // 5)]:
        assert check(path).findings == []
        assert path.name == read_entry(path).file_name
