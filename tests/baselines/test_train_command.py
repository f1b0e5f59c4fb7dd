"""`xmarl-train` as a user types it: what it writes and prints, and what it refuses."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from xmarl_baselines.policies import shipped_policies
from xmarl_baselines.reference import SEEDS, SIZES, reference_runs, run_named
from xmarl_baselines.training.command import _command, main, train_missing
from xmarl_baselines.training.recipes import RECIPES, recipe_for
from xmarl_baselines.training.trainer import Run

from tests.baselines.test_training import short_validation, small
from xmarl_bench.errors import InputError
from xmarl_bench.parallel.workers import Workers
from xmarl_bench.policy import load_policy
from xmarl_bench.policy.bundle import load_card

__all__ = ["short_validation"]  # a fixture, for every test here


def test_a_run_ends_with_a_policy_that_loads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("xmarl_baselines.training.command.recipe_for", lambda task: small(task, frames=160))
    monkeypatch.setattr("sys.argv", ["xmarl-train", "--out", str(tmp_path), "--episodes", "1"])
    sys.argv += ["--task", "blind_discovery_v0", "--frames", "320"]
    with pytest.raises(SystemExit) as done:
        main()
    assert done.value.code == 0
    _, card = load_policy(tmp_path / "discovery-n3-lambda0-seed0" / "policy")
    assert card.name == "discovery-n3-lambda0-seed0"
    assert card.training["command"].startswith("xmarl-train --task blind_discovery_v0 --agents 3")
    assert str(tmp_path) not in card.training["command"]
    assert card.training["frames"] == card.training["curve"][-1]["frames"] == 320
    assert card.performance["episodes"] == 1
    assert "xmarl-bench score --policy" in capsys.readouterr().out
    with pytest.raises(SystemExit) as again:
        main()
    said = capsys.readouterr().err
    assert (again.value.code, said.count("\n")) == (2, 1)
    assert "--resume" in said


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "either --task"),
        (("--task", "blind_passage_v0", "--reproduce", "all"), "either --task"),
        (("--reproduce", "nothing"), "choose one of"),
        (("--task", "chess"), "choose one of"),
        (("--task", "blind_passage_v0", "--agents", "6"), "1 to 5 agents"),
        (("--task", "blind_passage_v0", "--start-from", "nowhere"), "checkpoint"),
        (("--task", "blind_passage_v0", "--attention-entropy", "-1"), "equal to 0"),
        (("--task", "blind_passage_v0", "--frames", "0"), "equal to 1"),
        (("--task", "blind_passage_v0", "--attention-start", "0.7"), "start at 0.6 or before"),
        (("--reproduce", "all", "--address", "127.0.0.1:9"), "of no use to loky"),
        (("--reproduce", "all", "--seed", "0"), "leave out --seed"),
        (("--reproduce", "discovery-n3-lambda0-seed0", "--caution", "2"), "leave out --caution"),
        (("--reproduce", "discovery-n3-lambda0-seed0", "--jobs", "2"), "leave out --jobs"),
        (("--task", "blind_discovery_v0", "--backend", "ray"), "leave out --backend"),
    ],
)
def test_bad_input_is_refused(
    tmp_path: Path,
    arguments: tuple[str, ...],
    said: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("sys.argv", ["xmarl-train", "--out", str(tmp_path / "runs"), *arguments])
    with pytest.raises(SystemExit) as refused:  # any other exception would be a traceback
        main()
    assert refused.value.code == 2
    printed = capsys.readouterr()
    assert (said in printed.err, printed.out) == (True, "")
    assert not (tmp_path / "runs").exists()


def test_in_a_process_of_its_own(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "xmarl_baselines.training.command", "--out", "runs", "--task", "chess"]
    refused = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert refused.returncode == 2
    assert refused.stderr.startswith("xmarl-train: unknown task 'chess'")
    assert len(refused.stderr.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_reference_runs_have_the_names_of_their_settings() -> None:
    runs = reference_runs()
    with_the_papers_architecture = [name for name in runs if name.startswith("navigation-paper-")]
    assert len(with_the_papers_architecture) == len(SIZES)
    assert len(runs) == len(RECIPES) * len(SIZES) * len(SEEDS) * 2 + len(SIZES)
    assert all(run.name == name for name, run in runs.items())
    first = list(runs.values())[: len(RECIPES) * len(SIZES) * 2]
    assert {run.seed for run in first} == {SEEDS[0]}


def test_the_command_says_when_the_attention_term_sets_in() -> None:
    imitated, rewarded = (recipe_for(f"blind_{task}_v0") for task in ("passage", "discovery"))
    later = imitated.with_attention_start(0.5)
    assert later.imitation is not None
    assert later.imitation.attention_start == later.starts_attention == 0.5
    assert rewarded.with_attention_start(0.25).attention_start == 0.25
    assert "--attention-start 0.5" in _command(Run(later, 5, 0.02, seed=2))
    assert "--attention-start" not in _command(Run(imitated, 5, 0.02, seed=2))
    finer = rewarded.fine_tuning()
    assert "--attention-start" not in _command(Run(finer, 3, 0.1, start_from="first"))
    later = finer.with_attention_start(0.25)
    assert "--attention-start 0.25" in _command(Run(later, 3, 0.1, start_from="first"))


def test_a_shipped_policy_is_reproduced_by_the_run_that_its_card_records() -> None:
    made_by_one = 0
    for name, folder in shipped_policies().items():
        training = load_card(folder).training
        if training["start_from"] is not None or "percent" in training:
            with pytest.raises(InputError, match="cannot be made by one run"):
                run_named(name)
            continue
        run = run_named(name)
        assert run.name == name
        recorded = {key: training["recipe"][key] for key in training["recipe"]}
        assert {key: run.settings()["recipe"][key] for key in recorded} == recorded | {
            key: {**run.settings()["recipe"][key], **recorded[key]}
            for key in ("imitation", "shaping")
            if isinstance(recorded.get(key), dict)
        }
        made_by_one += 1
    assert made_by_one >= 3


def test_workers_that_wait_for_a_training_import_no_torch() -> None:
    code = (
        "import sys, xmarl_baselines.training.own_process;"
        "assert not {'torch', 'torch_geometric', 'stable_baselines3'} & sys.modules.keys()"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_reproduce_all_trains_what_is_missing_and_says_what_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    names = ["discovery-n3-lambda0-seed0", "passage-n3-lambda0-seed0"]
    monkeypatch.setattr(
        "xmarl_baselines.training.command.reference_runs", lambda: dict.fromkeys(["a", *names])
    )
    for name in names:  # one is finished, one holds another run
        (tmp_path / name / "policy").mkdir(parents=True)
    (tmp_path / names[0] / "policy" / "policy.json").write_text("{}")
    (tmp_path / names[1] / "settings.json").write_text("{}")
    assert train_missing(tmp_path, Workers(2)) == 1
    said = capfd.readouterr().err
    assert "2 of 2" in said and names[0] not in said
    assert f"{names[1]} FAILED" in said
    assert "other settings" in (tmp_path / f"{names[1]}.log").read_text()
    assert "no reference policy is called 'a'" in (tmp_path / "a.log").read_text()
