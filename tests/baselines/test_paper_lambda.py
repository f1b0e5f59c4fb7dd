"""The paper's schedules equal its tables, and the recorded attention is the team's."""

from __future__ import annotations

import json
import re
import runpy
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from xmarl_baselines import paper_lambda
from xmarl_baselines.paper_schedule import PAPER_LAMBDAS, PAPER_SCHEDULE, schedule_runs
from xmarl_baselines.reference import reference_runs, run_named
from xmarl_baselines.report import lambda_rows
from xmarl_baselines.training.mappo import MAPPO
from xmarl_baselines.training.model_selection import plain_actor
from xmarl_baselines.training.shaping import Shaping
from xmarl_baselines.training.trainer import Run, build
from xmarl_envs import TASKS

from xmarl_bench.errors import InputError
from xmarl_bench.policy import GraphPolicy
from xmarl_bench.rollout.cell import Sampling

# Kailas et al. (ICML 2025), appendix: learning rate, gamma, lambda of GAE, clip epsilon, normalised, epochs,
# gradient norm, minibatch, iterations, frames per batch; and the weight of the attention-entropy term.
TABLES = {
    "blind_navigation_v0": (3e-4, 0.99999, 0.9, 0.2, False, 30, 1.0, 800, 150, 18_000, 10.0),
    "blind_passage_v0": (5e-5, 0.99999, 0.9, 0.2, False, 30, 1.0, 800, 100, 60_000, 50.0),
    "blind_discovery_v0": (7e-4, 0.9999, 0.95, 0.05, True, 5, 10.0, 10_000, 1000, 10_000, 50.0),
}


@pytest.mark.parametrize("task", TASKS)
def test_the_schedule_is_the_papers_table(task: str) -> None:
    recipe = PAPER_SCHEDULE[task]
    iteration = recipe.n_envs * recipe.n_steps
    assert TABLES[task] == (
        recipe.learning_rate,
        recipe.gamma,
        recipe.gae_lambda,
        recipe.clip_range,
        recipe.normalize_advantage,
        recipe.n_epochs,
        recipe.max_grad_norm,
        recipe.batch_size,
        recipe.frames / iteration,
        iteration,
        PAPER_LAMBDAS[task],
    )
    assert (recipe.task, recipe.family, recipe.shaping) == (task, "paper", Shaping())
    assert recipe.critic == ((128, 128) if task == "blind_discovery_v0" else (32, 32))
    assert not recipe.architecture["residual"]
    for remaining in (1.0, 0.5, 0.0):
        assert recipe.learning_rate_at(remaining) == recipe.learning_rate
    model = build(Run(recipe, attention_entropy=PAPER_LAMBDAS[task]), seed=0)
    assert model.attention_weight() == PAPER_LAMBDAS[task]  # from the first step


def test_schedules_have_names_and_are_not_reference_runs() -> None:
    runs = schedule_runs()
    assert len(runs) == 12
    assert not runs.keys() & reference_runs().keys()
    for name, run in runs.items():
        assert run_named(name) == run
        assert name.split("-")[1] == "n3"
        as_in_the_paper = PAPER_SCHEDULE[run.recipe.task].normalize_advantage
        other = "-raw-" in name or "-normalised-" in name
        assert run.recipe.normalize_advantage == (as_in_the_paper != other)
    assert {run.attention_entropy for run in runs.values()} == {0.0, 10.0, 50.0}


def test_shares_of_attention_by_hand() -> None:
    alike, self_only = np.full((2, 3, 3), 1 / 3), np.broadcast_to(np.eye(3), (2, 3, 3))
    star = np.zeros((2, 3, 3))
    star[0, :, 1] = star[1, :, 2] = 1.0  # a different sender in each state
    assert paper_lambda.own_share(alike) == pytest.approx(1 / 3)
    assert paper_lambda.most_heard(alike) == pytest.approx(1 / 3)
    assert (paper_lambda.own_share(self_only), paper_lambda.most_heard(self_only)) == pytest.approx(
        (1, 1 / 3)
    )
    assert (paper_lambda.own_share(star), paper_lambda.most_heard(star)) == pytest.approx((1 / 3, 1))


@torch.no_grad()
def hears_itself_alone(policy: GraphPolicy) -> None:
    """Agents attend to the sender at their own place, the first two entries of an observation."""
    layer = policy.gat
    for parameter in (layer.lin_l.weight, layer.lin_l.bias, layer.lin_r.weight, layer.lin_r.bias, layer.att):
        parameter.zero_()
    # |x_j - x_i| + |y_j - y_i| by pairs of LeakyReLUs, with a steep minus.
    for k in range(4):
        sign, entry = (-1) ** k, k // 2
        layer.lin_l.weight[k, entry], layer.lin_r.weight[k, entry] = sign, -sign
        layer.att[..., k] = -1e4
    layer.lin_l.weight[4:] = 1.0  # messages are not 0


def test_a_team_that_hears_itself_alone_depends_on_no_message(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paper_lambda, "STATES", Sampling(episodes=2, max_cycles=5))
    model = build(Run(PAPER_SCHEDULE["blind_navigation_v0"]), seed=0)
    before = paper_lambda.listening(plain_actor(model), "blind_navigation_v0", 3)
    hears_itself_alone(model.policy.actor)
    after = paper_lambda.listening(plain_actor(model), "blind_navigation_v0", 3)
    assert before["communication_dependence"] > 1e-4
    assert after == pytest.approx(
        {"attention_entropy": 0, "own_share": 1, "most_heard": 1 / 3, "communication_dependence": 0}, abs=1e-6
    )


def test_the_commands_of_records_and_documents_name_runs_that_exist() -> None:
    root = Path(__file__).parents[2]
    documents = [path for folder in (".", "baselines", "docs") for path in (root / folder).glob("*.md")]
    text = "\n".join(path.read_text() for path in documents)
    named = re.findall(r"(?:paper_lambda|--reproduce) ([a-z]+-n\d\S*?-seed\d)", text)
    assert len(named) > 10
    for name in {*named, *(path.stem for path in paper_lambda.RECORDS.glob("*.json"))}:
        assert run_named(name).name == name


def test_an_unknown_run_is_refused_in_one_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["paper_lambda", "nobody", "--iterations", "1"])
    monkeypatch.delitem(sys.modules, "xmarl_baselines.paper_lambda")
    with pytest.raises(SystemExit) as stopped:
        runpy.run_module("xmarl_baselines.paper_lambda", run_name="__main__")
    assert stopped.value.code == 2
    assert capsys.readouterr().err.startswith("paper_lambda: unknown reference policy 'nobody': choose one")


@pytest.mark.training
def test_a_run_writes_a_record_and_a_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = "navigation-n3-schedule-lambda10-seed0"
    short = replace(schedule_runs()[name].recipe, n_envs=4, n_steps=20, batch_size=30, n_epochs=1)
    monkeypatch.setattr(paper_lambda, "run_named", lambda _: Run(short, attention_entropy=10.0))
    monkeypatch.setattr(paper_lambda, "STATES", Sampling(episodes=1))
    monkeypatch.setattr("xmarl_baselines.report.RECORDS", tmp_path)
    paper_lambda.main(name, iterations=3, episodes=1, out=tmp_path, runs=tmp_path / "runs")
    record = json.loads((tmp_path / f"{name}.json").read_text())
    assert [each["frames"] for each in record["along"]] == [0, 80, 160]
    assert record["frames"] == 240
    saved = plain_actor(MAPPO.load(tmp_path / "runs" / name / "checkpoint.zip"))
    assert paper_lambda.listening(saved, "blind_navigation_v0", 3) == record["listening"]
    (row,) = lambda_rows()
    assert (row["lambda"], row["advantages"], row["frames (M)"]) == (10.0, "raw", "0.00 of 2.7")
    start, end = record["along"][0], record["listening"]
    assert row["attention entropy"] == f"{start['attention_entropy']:.2f} -> {end['attention_entropy']:.3f}"
    assert row["command"] == f"`python -m xmarl_baselines.paper_lambda {name} --iterations 3 --episodes 1`"


def test_the_first_recorded_attention_is_of_the_untrained_team(tmp_path: Path) -> None:
    short = replace(PAPER_SCHEDULE["blind_discovery_v0"], n_envs=4, n_steps=10, batch_size=40)
    run = Run(short, attention_entropy=50.0)
    records = paper_lambda.first_iterations(run, 1, tmp_path).along
    model = build(run, seed=0)
    model.learn(1)
    fresh = build(run, seed=0).policy.actor
    seen = torch.from_numpy(model.rollout_buffer.observations).flatten(0, 1)
    attention = fresh.attention(seen).detach().numpy()
    assert records[0]["own_share"] == pytest.approx(paper_lambda.own_share(attention))


@pytest.mark.training
def test_iterations_go_on_where_they_were_interrupted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(paper_lambda, "CHECKPOINT_EVERY", 2)
    short = replace(PAPER_SCHEDULE["blind_discovery_v0"], n_envs=4, n_steps=10, batch_size=40)
    run = Run(short, attention_entropy=50.0)
    whole = paper_lambda.first_iterations(run, 6, tmp_path / "whole")

    def interrupt(*_: object, **__: object) -> None:
        if len(json.loads((folder / "attention.json").read_bytes())) == 4:
            raise KeyboardInterrupt

    folder = tmp_path / "interrupted"
    with monkeypatch.context() as patch:
        patch.setattr("builtins.print", interrupt)
        with pytest.raises(KeyboardInterrupt):
            paper_lambda.first_iterations(run, 6, folder)
    assert json.loads((folder / "progress.json").read_bytes())["frames"] == 3 * 40
    seen = json.loads((folder / "attention.json").read_bytes())
    resumed = paper_lambda.first_iterations(run, 6, folder)
    assert [each["frames"] for each in resumed.along] == [each["frames"] for each in whole.along]
    assert resumed.along[:3] == seen[:3] == whole.along[:3]
    assert len(paper_lambda.first_iterations(run, 8, folder).along) == 8
    with pytest.raises(InputError, match="holds 8 iterations of this run already"):
        paper_lambda.first_iterations(run, 7, folder)
    (folder / "attention.json").write_text("[]")
    with pytest.raises(InputError, match=r"attention\.json is damaged"):
        paper_lambda.first_iterations(run, 9, folder)
