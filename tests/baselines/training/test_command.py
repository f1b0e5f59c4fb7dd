"""`xmarl-train` on the command line: what it writes, prints and refuses."""

from __future__ import annotations

import shutil
import subprocess
import sys
from dataclasses import asdict, fields, replace
from pathlib import Path

import pytest
from xmarl_baselines.policies import shipped_policies
from xmarl_baselines.reference import (
    DOSE_SEEDS,
    DOSES,
    SEEDS,
    SIZES,
    dose_runs,
    finished_bundle,
    reference_runs,
    run_named,
)
from xmarl_baselines.training.command import command_of, main, train_and_save, train_missing
from xmarl_baselines.training.families import FAMILIES, Family
from xmarl_baselines.training.model_selection import weights_at
from xmarl_baselines.training.recipes import RECIPES, Recipe, recipe_for
from xmarl_baselines.training.shaping import Shaping
from xmarl_baselines.training.trainer import Run

from tests.baselines.training.small_runs import small
from xmarl_bench.errors import InputError
from xmarl_bench.parallel.workers import Workers
from xmarl_bench.policy import GraphPolicy, load_policy
from xmarl_bench.policy.card import load_card
from xmarl_bench.records.files import write_json

pytestmark = pytest.mark.usefixtures("as_a_program", "short_episodes")
RUN = "discovery-n3-residual-lambda0-seed0"


@pytest.mark.parametrize("family", FAMILIES)
def test_a_run_ends_with_a_policy_that_loads(
    family: Family, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("xmarl_baselines.training.command.recipe_for", small)
    monkeypatch.setattr("sys.argv", ["xmarl-train", "--out", str(tmp_path), "--episodes", "1"])
    sys.argv += ["--task", "blind_discovery_v0", "--family", family, "--frames", "320", "--seed", "3"]
    with pytest.raises(SystemExit) as done:
        main()
    assert done.value.code == 0
    name = f"discovery-n3-{family}-lambda0-seed3"
    policy, card = load_policy(tmp_path / name / "policy")
    assert (card.name, card.family, card.training_seed, card.initial_seed) == (name, family, 3, 3)
    assert isinstance(policy, GraphPolicy)
    assert policy.architecture.residual is (family == "residual")
    assert card.training["command"].startswith(
        f"xmarl-train --task blind_discovery_v0 --family {family} --agents 3"
    )
    assert card.training["cpu_seconds"] > 0
    assert "seconds" not in card.training
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
        (("--task", "blind_passage_v0", "--attention-start", "0.9"), "start at 0.8 or before"),
        (("--task", "blind_passage_v0", "--family", "large"), "'residual'"),
        (("--reproduce", RUN, "--family", "paper"), "leave out --family"),
        (("--reproduce", "all", "--address", "127.0.0.1:9"), "has no effect with the backend loky"),
        (("--reproduce", "all", "--seed", "0"), "leave out --seed"),
        (("--reproduce", RUN, "--caution", "2"), "leave out --caution"),
        (("--reproduce", RUN, "--jobs", "2"), "leave out --jobs"),
        (("--task", "blind_discovery_v0", "--backend", "ray"), "leave out --backend"),
        (("--task", "blind_discovery_v0", "--caution", "2"), "leave --caution out"),
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
    with pytest.raises(SystemExit) as refused:  # another exception would print a traceback
        main()
    assert refused.value.code == 2
    printed = capsys.readouterr()
    assert (said in printed.err, printed.out) == (True, "")
    assert not (tmp_path / "runs").exists()


def test_a_refusal_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["xmarl-train", "--out", "runs", "--task", "chess"])
    with pytest.raises(SystemExit) as refused:
        main()
    assert refused.value.code == 2
    said = capsys.readouterr().err
    assert said.startswith("xmarl-train: unknown task 'chess'")
    assert len(said.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_damaged_files_of_a_run_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("xmarl_baselines.training.command.recipe_for", small)
    options = ["--task", "blind_discovery_v0", "--frames", "320", "--episodes", "1", "--seed", "3"]

    def end(*arguments: str) -> object:
        monkeypatch.setattr("sys.argv", ["xmarl-train", "--out", str(tmp_path), *options, *arguments])
        with pytest.raises(SystemExit) as done:
            main()
        return done.value.code

    assert end() == 0
    (folder,) = tmp_path.iterdir()
    progress = folder / "progress.json"
    weights = weights_at(folder, load_card(folder / "policy").training["validation"])
    for path, content in (
        (folder / "checkpoint.zip", b"x"), (folder / "settings.json", b"{"), (progress, b"[]"),
        (progress, b"\xff"), (folder / "curve.json", b"[{}]"), (weights, b"x"),
    ):  # fmt: skip
        intact = path.read_bytes()
        path.write_bytes(content)
        capsys.readouterr()
        assert end("--resume") == 2
        said = capsys.readouterr().err
        assert said.startswith(f"xmarl-train: {path} is damaged: ")
        assert said.count("\n") == 1
        path.write_bytes(intact)
    assert end("--resume") == 0


def test_reference_runs_have_the_names_of_their_settings() -> None:
    runs = reference_runs()
    cells = len(RECIPES) * len(SIZES) * 2  # with the attention-entropy term and without
    assert len(runs) == cells * len(SEEDS) * len(FAMILIES)
    assert all(run.name == name for name, run in runs.items())
    first = list(runs.values())[:cells]
    assert {(run.recipe.family, run.seed) for run in first} == {(FAMILIES[0], SEEDS[0])}


def test_a_dose_is_every_weight_with_every_seed_and_nothing_else_differs() -> None:
    runs = dose_runs()
    assert len(runs) == len(DOSES) * len(DOSE_SEEDS) and all(run.name == name for name, run in runs.items())
    assert len({replace(run, attention_entropy=0.0, seed=0) for run in runs.values()}) == 1
    both = runs.keys() & reference_runs().keys()
    assert len(both) == 2 * len(SEEDS) and all(runs[name] == reference_runs()[name] for name in both)


def test_the_command_names_what_differs_from_the_recipe() -> None:
    passage = recipe_for("blind_passage_v0", 5)
    assert command_of(Run(passage, 5)) == "xmarl-train --reproduce passage-n5-residual-lambda0-seed0"
    assert command_of(Run(passage, 5, 0.02, seed=2, caution=2.0)) == (
        "xmarl-train --task blind_passage_v0 --family residual --agents 5 --attention-entropy 0.02 --seed 2 "
        f"--frames {passage.frames} --caution 2"
    )
    later = replace(recipe_for("blind_passage_v0", 5, family="paper"), attention_start=0.5)
    assert "--family paper" in command_of(Run(later, 5, 0.02, seed=2))
    assert "--attention-start 0.5" in command_of(Run(later, 5, 0.02, seed=2))
    finer = passage.fine_tuning()
    assert "--attention-start" not in command_of(Run(finer, 5, 0.1, start_from="first"))
    later = replace(finer, attention_start=0.25)
    command = command_of(Run(later, 5, 0.1, start_from="first"))
    assert command.endswith("--attention-start 0.25 --start-from runs/first")


def test_there_is_no_command_for_a_recipe_that_options_do_not_reach() -> None:
    recipe = recipe_for("blind_passage_v0")
    assert command_of(Run(replace(recipe, n_epochs=8), 3)).startswith("none: ")
    assert command_of(Run(replace(recipe, frames=600_000), 3)).endswith("--frames 600000")


def test_a_fine_tuned_policy_does_not_claim_to_start_from_a_seed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("xmarl_baselines.training.command.recipe_for", small)
    given = ["xmarl-train", "--out", str(tmp_path), "--episodes", "1", "--task", "blind_discovery_v0"]

    def run(*more: str) -> int:
        monkeypatch.setattr("sys.argv", [*given, *more])
        with pytest.raises(SystemExit) as done:
            main()
        return int(done.value.code or 0)

    start = ("--start-from", str(tmp_path / RUN), "--attention-entropy", "0.1")
    assert run() == 0
    assert run(*start) == 0
    card = load_card(tmp_path / "discovery-n3-residual-lambda0.1-seed0" / "policy")
    assert (card.initial_seed, card.training["start_from"]) == (None, RUN)
    assert run(*start, "--family", "paper") == 2
    assert "a residual network" in (said := capsys.readouterr().err) and "a paper network" in said
    assert run(*start, "--agents", "4") == 2
    assert "3 agents" in (said := capsys.readouterr().err) and "not of blind_discovery_v0, 4" in said
    settings = tmp_path / RUN / "settings.json"
    settings.write_text(settings.read_text().replace('"critic": [', '"critic": [7, '))
    assert run(*start) == 2
    assert "a critic (7, " in capsys.readouterr().err


def test_a_shipped_policy_is_reproduced_by_the_run_that_its_card_records() -> None:
    for name, folder in shipped_policies().items():
        card = load_card(folder)
        training = card.training
        if card.family is None or training["start_from"] is not None or "percent" in training:
            with pytest.raises(InputError, match=r"cannot be made by one run|another version"):
                run_named(name)
            continue
        run = run_named(name)
        assert run.name == name
        recorded = training["recipe"]
        # What an older card lacks has its default.
        shaping = {**asdict(Shaping()), **recorded["shaping"]}
        defaults = {each.name: each.default for each in fields(Recipe)}
        recipe = {**defaults, **recorded, "shaping": shaping}
        assert run.settings().items() <= {**training, "recipe": recipe}.items()


def test_a_run_is_read_from_its_card(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not from the current recipe, which may have changed."""
    run = Run(small("blind_discovery_v0"))
    train_and_save(run, tmp_path / run.name, resume=False, start_from=None, episodes=1)
    folder = tmp_path / run.name / "policy"
    shipped = {run.name: folder, f"{run.name}-at20": folder}
    monkeypatch.setattr("xmarl_baselines.reference.shipped_policies", lambda: shipped)
    assert run_named(run.name) == run != reference_runs()[run.name]
    with pytest.raises(InputError, match="cannot be made by one run"):
        run_named(f"{run.name}-at20")


def test_a_worker_that_waits_for_a_training_does_not_import_torch() -> None:
    code = (
        "import sys, xmarl_baselines.training.own_process;"
        "assert not {'torch', 'torch_geometric', 'stable_baselines3'} & sys.modules.keys()"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_reproduce_all_trains_missing_runs_and_reports_failures(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    begun = "passage-n3-residual-lambda0-seed0"
    shutil.copytree(shipped_policies()[RUN], tmp_path / RUN / "policy")
    (tmp_path / begun).mkdir()
    write_json(tmp_path / begun / "settings.json", Run(recipe_for("blind_passage_v0"), 4).settings())
    assert train_missing([RUN, begun], tmp_path, Workers(2)) == 1
    said = capfd.readouterr().err
    assert "1 of 1" in said and RUN not in said
    assert f"{begun} FAILED" in said
    assert "other settings" in (tmp_path / f"{begun}.log").read_text()
    with pytest.raises(InputError, match="unknown reference policy 'a': choose one of"):
        train_missing(["a", begun], tmp_path, Workers(2))


def test_a_finished_run_of_the_same_name_with_other_settings_is_refused(tmp_path: Path) -> None:
    run = Run(small("blind_discovery_v0"))
    assert run.name == RUN
    train_and_save(run, tmp_path / RUN, resume=False, start_from=None, episodes=1)
    assert finished_bundle(run, tmp_path) == tmp_path / RUN / "policy"
    with pytest.raises(InputError, match=f"{RUN}/policy was trained with other settings: give another"):
        train_missing([RUN], tmp_path, Workers(2))


def test_a_card_tells_the_frames_that_were_played(tmp_path: Path) -> None:
    recipe = small("blind_discovery_v0")
    iteration = recipe.n_envs * recipe.n_steps
    run = Run(replace(recipe, frames=iteration + 1))
    card = train_and_save(run, tmp_path / "run", resume=False, start_from=None, episodes=1)
    assert card.training["frames"] == card.training["curve"][-1]["frames"] == 2 * iteration
