"""`xmarl-bench study` end to end, on random policies and fast explainers."""

from __future__ import annotations

import builtins
import json
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import MakeBundle, RunCli
from tests.helpers.policies import small_policy
from xmarl_bench.cli import tables
from xmarl_bench.papers.kailas2025 import plan
from xmarl_bench.policy import save_policy

pytestmark = pytest.mark.slow

SMALL = ("--episodes", 3, "--timesteps", 2, "--max-cycles", 6)


@pytest.fixture(autouse=True)
def fast(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replaces the ledgers' slow explainers by two fast ones."""
    monkeypatch.setattr(plan, "EXPLAINERS", ("attention", "attention-rowmax"))


def bundle(
    tmp_path: Path, name: str, *, attention_entropy: float, seed: int = 0, percent: int | None = None
) -> Path:
    folder = tmp_path / "policies" / name
    save_policy(
        folder,
        small_policy(6, seed + int(10 * attention_entropy)),
        name=name,
        task="blind_navigation_v0",
        n_agents=3,
        attention_entropy=attention_entropy,
        training_seed=seed,
        training={} if percent is None else {"percent": percent},
    )
    return folder


def run(run_cli: RunCli, study: str, folders: list[Path], out: Path, *more: object) -> Any:
    return run_cli("study", study, *chosen(folders), *SMALL, *more, "--out", out)


def chosen(folders: list[Path]) -> list[object]:
    """The options that choose these policies."""
    return [argument for folder in folders for argument in ("--policy", folder)]


def test_the_main_study_writes_results(run_cli: RunCli, tmp_path: Path) -> None:
    folders = [bundle(tmp_path, f"p{x}", attention_entropy=x) for x in (0.0, 0.2)]
    out = tmp_path / "study"
    ran = run(run_cli, "main", folders, out, "--no-figures")
    assert ran.code == 0, ran.err
    results = json.loads((out / "results.json").read_text())
    assert [policy["name"] for policy in results["policies"]] == ["p0.0", "p0.2"]
    improved = next(claim for claim in results["ledger"] if claim["id"] == "main-attention-fid-delta")
    assert improved["overall"][0]["n_policies"] == 1
    assert improved["overall"][0]["n_episodes"] == 3
    assert "missing: passage, N = 3, with the term" in ran.out
    assert "35 statements of the paper: " in ran.out
    assert f"look at {out / 'report.html'}." in ran.out and (out / "report.html").exists()
    before = (out / "results.json").read_bytes()
    again = run(run_cli, "main", folders, out, "--no-figures")
    assert again.code == 0, again.err
    assert again.err == ""
    assert (out / "results.json").read_bytes() == before


def test_a_study_of_which_everything_fails_names_the_first_failure(
    run_cli: RunCli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = tmp_path / "own.py"
    own.write_text("def broken(policy, observations, generator):\n    raise RuntimeError('by design')\n")
    monkeypatch.setattr(plan, "EXPLAINERS", (f"{own}:broken",))
    folders = [bundle(tmp_path, "p", attention_entropy=0.0)]
    ran = run(run_cli, "main", folders, tmp_path / "study", "--no-figures")
    assert_refused(ran, "by design")


def test_existing_entries_are_judged_alike_and_what_they_lack_is_named(
    run_cli: RunCli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Of the same weights, as checkpoints before the term begins.
    folders = [bundle(tmp_path, f"p{x}", attention_entropy=x) for x in (0.0, 0.05)]
    scored, board, judged = (tmp_path / name for name in ("scored", "leaderboard", "judged"))
    assert run(run_cli, "main", folders, scored, "--no-figures").code == 0
    explainers = [word for name in plan.EXPLAINERS for word in ("--explainer", name)]
    options = (*chosen(folders), *explainers, *SMALL, "--no-behaviour", "all")
    assert run_cli("score", *options, "--out", board).code == 0
    ran = run(run_cli, "main", folders, judged, "--no-figures", "--entries", board)
    assert ran.code == 0, ran.err
    first, second = (json.loads((out / "results.json").read_bytes()) for out in (scored, judged))
    assert (first.pop("existing"), second.pop("existing")) == (False, True)
    assert min(first.pop("core_hours"), second.pop("core_hours")) > 0.0
    assert first == second
    (empty := tmp_path / "empty").mkdir()
    none = run(run_cli, "main", folders, tmp_path / "none", "--no-figures", "--entries", empty)
    assert_refused(none, "empty is of this study: score there first")
    none = run(run_cli, "main", folders, tmp_path / "none", "--no-figures", "--entries", tmp_path / "nowhere")
    assert_refused(none, "nowhere does not exist")
    (entry,) = (board / "entries").glob("p0.05.attention.*.json")
    entry.unlink()
    ran = run(run_cli, "main", folders, judged, "--no-figures", "--entries", board)
    assert ran.code == 1
    assert "attention on p0.05: has no entry with these states" in ran.err
    for entry in (board / "entries").glob("p0.*.attention-rowmax.*.json"):
        entry.unlink()
    ran = run(run_cli, "main", folders, judged, "--no-figures", "--entries", board)
    every = "failed: attention-rowmax on p0.0, attention on p0.05, attention-rowmax on p0.05: has no entry"
    assert every in ran.err
    monkeypatch.setattr(tables, "NAMED", 1)
    ran = run(run_cli, "main", folders, judged, "--no-figures", "--entries", board)
    assert "failed: attention-rowmax on p0.0 and 2 more: has no entry" in ran.err
    copied = next((board / "entries").glob("p0.0.attention.*.json"))
    (board / "entries" / "copy.json").write_bytes(copied.read_bytes())
    ran = run(run_cli, "main", folders, judged, "--no-figures", "--entries", board)
    assert_refused(ran, "have the same policy, explainer and states")


def test_the_study_along_training_shows_finished_policies_beside_the_checkpoints(
    run_cli: RunCli, tmp_path: Path
) -> None:
    folders = [
        bundle(tmp_path, f"p{x}-at{percent}", attention_entropy=x, percent=percent)
        for percent in (20, 80)
        for x in (0.0, 0.2)
    ]
    finished = bundle(tmp_path, "finished", attention_entropy=0.0)
    out = tmp_path / "study"
    ran = run(run_cli, "training", [*folders, finished], out, "--no-figures")
    assert ran.code == 0, ran.err
    results = json.loads((out / "results.json").read_text())
    assert {(policy["name"], policy["percent"]) for policy in results["policies"]} == {
        ("p0.0-at20", 20), ("p0.2-at20", 20), ("p0.0-at80", 80), ("p0.2-at80", 80), ("finished", None),
    }  # fmt: skip
    grows = next(claim for claim in results["ledger"] if claim["id"] == "training-attention-grows")
    assert grows["counts"]["not measured"] == 0
    assert "navigation, N = 3, 50 % of training, without the term" in results["missing"]


def test_the_zero_shot_study_adds_agents(run_cli: RunCli, tmp_path: Path) -> None:
    folders = [bundle(tmp_path, f"p{x}", attention_entropy=x) for x in (0.0, 0.2)]
    out = tmp_path / "study"
    ran = run(run_cli, "zero-shot", folders, out, "--no-figures")
    assert ran.code == 0, ran.err
    results = json.loads((out / "results.json").read_text())
    assert [policy["n_tested"] for policy in results["policies"]] == [4, 5, 6] * 2
    assert "navigation, N = 3, tested with 6" in {each["cell"] for each in results["quality"]}


def test_without_matplotlib_figures_are_refused(
    run_cli: RunCli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = builtins.__import__

    def without(name: str, *rest: Any, **options: Any) -> Any:
        if name.startswith("matplotlib"):
            raise ImportError(name)
        return real(name, *rest, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    ran = run(run_cli, "main", [bundle(tmp_path, "p", attention_entropy=0.0)], tmp_path / "study")
    assert_refused(ran, "pip install 'xmarl-bench[plots]'")
    assert not (tmp_path / "study").exists()


def test_invalid_input_is_refused_with_one_sentence(
    run_cli: RunCli, make_bundle: MakeBundle, tmp_path: Path
) -> None:
    out = tmp_path / "study"
    one = bundle(tmp_path, "one", attention_entropy=0.0)
    twin = bundle(tmp_path, "twin", attention_entropy=0.0)
    assert_refused(run(run_cli, "main", [one, twin], out, "--no-figures"), "'one' and 'twin'")
    assert_refused(
        run(run_cli, "main", [one], out, "--no-figures", "--behaviour", "x"), "unknown explainer 'x'"
    )
    at_30 = bundle(tmp_path, "at-30", attention_entropy=0.0, percent=30)
    assert_refused(run(run_cli, "training", [at_30], out, "--no-figures"), "belongs to the study 'training'")
    assert_refused(run(run_cli, "main", [one], out, "--no-figures", "--explainer", "no"), "unknown explainer")
    assert run(run_cli, "other", [one], out).code == 2
    assert not out.exists()


def assert_refused(ran: Any, said: str) -> None:
    assert ran.code == 2, ran
    assert len(ran.err.splitlines()) == 1, ran.err
    assert said in ran.err


def test_every_explainer_of_the_ledgers_runs(
    run_cli: RunCli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.undo()  # the real ones
    policies = [bundle(tmp_path, f"p{x}", attention_entropy=x) for x in (0.0, 0.2)]
    out, cache = tmp_path / "study", tmp_path / "cache"
    little = ("--episodes", 1, "--timesteps", 1, "--max-cycles", 3, "--no-figures", "--cache", cache)
    ran = run_cli("study", "main", *chosen(policies), *little, "--out", out)
    assert ran.code == 0, ran.err
    results = json.loads((out / "results.json").read_bytes())
    assert len(results["explainers"]) == 6
    assert all(lens["claims"] for lens in results["lenses"])
