"""Runs learn, repeat, resume and start from one another."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from xmarl_baselines.training.families import FAMILIES, Family
from xmarl_baselines.training.mappo import MAPPO
from xmarl_baselines.training.shaping import Shaping
from xmarl_baselines.training.team_vec_env import TeamVecEnv
from xmarl_baselines.training.trainer import Run, _Caution, build, train
from xmarl_envs import TASKS

from tests.baselines.training.small_runs import small
from xmarl_bench.errors import InputError


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("task", TASKS)
def test_every_task_has_a_recipe_that_trains(task: str, family: Family, tmp_path: Path) -> None:
    trained = train(Run(small(task, family=family)), tmp_path / "run")
    assert trained.seconds > 0
    assert trained.validation["frames"] <= 640
    weights = trained.policy.state_dict()
    assert all(torch.isfinite(tensor).all() for tensor in weights.values())


def test_the_same_seed_trains_the_same_weights_and_another_does_not(tmp_path: Path) -> None:
    def weights(seed: int, folder: str) -> torch.Tensor:
        policy = train(Run(small(), seed=seed), tmp_path / folder).policy
        return torch.cat([tensor.flatten() for tensor in policy.state_dict().values()])

    first = weights(0, "a")
    assert torch.equal(first, weights(0, "b"))
    assert not torch.equal(first, weights(1, "c"))


def test_an_interrupted_run_continues_from_its_checkpoint(tmp_path: Path) -> None:
    run, folder = Run(small()), tmp_path / "run"

    def stop_half_way(frames: int, _: dict[str, float]) -> None:
        if frames >= 320:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(run, folder, checkpoint_every=1, report=stop_half_way)
    assert json.loads((folder / "progress.json").read_text())["frames"] == 160
    with pytest.raises(InputError, match="--resume"):
        train(run, folder)
    with pytest.raises(InputError, match="other settings"):
        train(replace(run, seed=1), folder, resume=True)
    settings = json.loads((folder / "settings.json").read_text())
    del settings["recipe"]["shaping"]["search_reward"]  # as an older trainer wrote it
    (folder / "settings.json").write_text(json.dumps(settings))
    seen: list[int] = []
    train(run, folder, resume=True, report=lambda frames, _: seen.append(frames))
    assert seen[0] == 160
    assert json.loads((folder / "progress.json").read_text())["frames"] == 640


def test_caution_grows_over_the_run(tmp_path: Path) -> None:
    seen: list[float] = []

    class Watch(TeamVecEnv):
        def __setattr__(self, name: str, value: object) -> None:
            if name == "caution":
                seen.append(float(value))  # type: ignore[arg-type]
            super().__setattr__(name, value)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("xmarl_baselines.training.trainer.TeamVecEnv", Watch)
        train(Run(small(caution_growth=3.0)), tmp_path / "run")
    assert seen == pytest.approx([1.0, 1.0, 1.5, 2.0, 2.5])


def test_caution_goes_on_after_a_resume() -> None:
    caution = _Caution(3.0, 640)
    model = build(Run(small(caution_growth=3.0)), seed=0)
    model.num_timesteps = 320
    caution.init_callback(model)
    caution.on_rollout_start()
    assert isinstance(model.env, TeamVecEnv)
    assert model.env.caution == pytest.approx(2.0)


def test_a_run_can_start_from_a_finished_one(tmp_path: Path) -> None:
    first = Run(small(caution_growth=0.5, shaping=Shaping(agent_penalty=0.4)))
    train(first, tmp_path / "first")
    second = Run(
        replace(first.recipe.fine_tuning(), learning_rate=0.0), attention_entropy=0.1, start_from="first"
    )
    trained = train(second, tmp_path / "second", start_from=tmp_path / "first")
    assert second.settings()["start_from"] == "first"
    finished = MAPPO.load(tmp_path / "first" / "checkpoint.zip").policy.actor.state_dict()
    for name, tensor in trained.policy.state_dict().items():  # nothing was learned at a rate of 0
        assert torch.equal(tensor, finished[name]), name


def test_training_on_another_device_object_gives_the_same_weights(tmp_path: Path) -> None:
    """`cpu:0` is passed on wherever a GPU would be, and computes the bits of `cpu`."""
    run = Run(small("blind_discovery_v0"), n_agents=2, seed=1)
    here, there = (
        train(run, tmp_path / device.replace(":", "-"), device=device).policy for device in ("cpu", "cpu:0")
    )
    assert {each.device.type for each in there.parameters()} == {"cpu"}
    for a, b in zip(here.parameters(), there.parameters(), strict=True):
        assert torch.equal(a, b)
